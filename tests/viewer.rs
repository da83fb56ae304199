//! `scene.html`: what is in it, and that it stands alone.

pub mod browser;
pub mod pages;

use std::fs;

use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;
use glam::DVec3;
use serde_json::Value;

use mhsplat::base::constants::{ALPHA_MAX, ALPHA_MIN, COLOR_MAX, NEAR, blur};
use mhsplat::base::error::Error;
use mhsplat::capture::up_axis;
use mhsplat::run::viewer::{MAX_BYTES, photo_uri, scene_views};
use mhsplat::run::{ScenePage, write_scene_page};
use mhsplat::scene::{Gaussians, Plane, morton};
use mhsplat::{LoadOptions, load_dataset};
use pages::{element, looking, meta, page, scene, views, written};

/// Gaussians that share a range in the page.
const CHUNK: usize = 256;

/// Values of every plane in the page, as the script unpacks them, with the largest error that rounding to levels leaves.
fn unpacked(html: &str) -> Vec<Vec<(f64, f64)>> {
    let text = element(html, "data").trim();
    let bytes = base64::engine::general_purpose::STANDARD
        .decode(text)
        .unwrap();
    let packed = &meta(html)["packed"];
    assert_eq!(packed["chunk"], CHUNK);
    let count = packed["count"].as_u64().unwrap() as usize;
    let widths = packed["widths"].as_array().unwrap();
    let widths: Vec<usize> = widths
        .iter()
        .map(|w| w.as_u64().unwrap() as usize)
        .collect();
    let chunks = count.div_ceil(CHUNK);
    let float = |k: usize| {
        let four = bytes[4 * k..4 * k + 4].try_into().unwrap();
        f64::from(f32::from_le_bytes(four))
    };
    let mut at = 8 * chunks * widths.len();
    let mut planes = Vec::new();
    for (p, &width) in widths.iter().enumerate() {
        let values = (0..count).map(|i| {
            let [low, high] = [0, 1].map(|k| float(2 * (p * chunks + i / CHUNK) + k));
            let level = (0..width).fold(0, |sum, k| sum | u64::from(bytes[at + k]) << (8 * k));
            at += width;
            let step = (high - low) / ((1u64 << (8 * width)) - 1) as f64;
            (low + step * level as f64, 0.5 * step)
        });
        planes.push(values.collect());
    }
    assert_eq!(at, bytes.len());
    planes
}

/// Number of values of a scene in Morton order that the page holds with more than its rounding.
fn beyond(splats: &Gaussians, planes: &[Vec<(f64, f64)>]) -> usize {
    let axis = |k: usize| splats.planes()[k].as_slice();
    let order = morton::order([axis(0), axis(1), axis(2)], morton::NO_UP);
    let mut wrong = 0;
    for (p, plane) in planes.iter().enumerate() {
        for (&i, (found, bound)) in order.iter().zip(plane) {
            let i = i as usize;
            let q = splats.gather::<4>(Plane::ROTATION, i).map(f64::from);
            let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
            let own = f64::from(splats.planes()[p][i]);
            let rotation = (Plane::ROTATION..Plane::ROTATION + 4).contains(&p);
            let expected = if rotation { own / norm } else { own };
            // Values and ranges are single precision.
            let slack = 2e-7 * (1.0 + expected.abs());
            wrong += usize::from((found - expected).abs() > 1.001 * bound + slack);
        }
    }
    wrong
}

#[test]
fn the_page_holds_every_gaussian_within_its_rounding() {
    for degree in 0..=3 {
        let splats = scene(700, degree);
        let html = page(&splats, false, &views());
        assert_eq!(meta(&html)["packed"]["degree"], degree);
        let mut planes = unpacked(&html);
        assert_eq!(planes.len(), Plane::count(degree));
        assert_eq!(beyond(&splats, &planes), 0);
        // Positions stay good where a chunk holds Gaussians 100 scene extents away, colours and shapes have 16 bits.
        let finest = |p: usize| planes[p].iter().map(|v| v.1).fold(0.0, f64::max);
        assert!(finest(0) < 1e-5 && finest(Plane::SH) < 1e-4);
        let (value, bound) = planes[5][300];
        planes[5][300].0 = value + 2.0 * bound + 1e-5;
        assert_eq!(
            beyond(&splats, &planes),
            1,
            "the bound must be able to fail"
        );
    }
}

#[test]
fn what_does_not_fit_is_left_out_and_said() {
    let splats = scene(600, 3);
    let all = views();
    let with = |max_bytes| {
        let page = ScenePage {
            title: "a",
            splats: &splats,
            anti_aliased: false,
            background: [0.0; 3],
            views: &all,
            remarks: &["mine".to_owned()],
            max_bytes,
        };
        let (html, remarks) = written(&page);
        let inside = meta(&html);
        assert_eq!(inside["remarks"], serde_json::json!(remarks));
        assert_eq!(remarks[0], "mine");
        let bytes = element(&html, "data").trim().len() / 4 * 3;
        assert!(bytes <= max_bytes + 2, "{bytes} of {max_bytes}");
        (inside["packed"].clone(), remarks, html)
    };
    let (packed, remarks, _) = with(MAX_BYTES);
    assert_eq!((&packed["degree"], remarks.len()), (&Value::from(3), 1));
    let (packed, remarks, _) = with(40_000);
    assert_eq!(packed["count"], 600);
    assert!(packed["degree"].as_u64() < Some(3));
    assert!(remarks[1].contains("SH degree"), "{remarks:?}");
    let (packed, remarks, html) = with(12_000);
    let count = packed["count"].as_u64().unwrap() as usize;
    assert!((300..380).contains(&count), "{count}");
    assert_eq!(packed["degree"], 0);
    assert!(
        remarks[2].contains(&format!("{count} of 600 Gaussians")),
        "{remarks:?}"
    );
    // The opaque and large ones are there: the mean logit has risen.
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    let kept: Vec<f64> = unpacked(&html)[Plane::OPACITY]
        .iter()
        .map(|v| v.0)
        .collect();
    let before: Vec<f64> = splats.planes()[Plane::OPACITY]
        .iter()
        .map(|v| f64::from(*v))
        .collect();
    assert!(mean(&kept) > mean(&before) + 0.2);
    let (packed, ..) = with(0);
    assert_eq!(packed["count"], 0);
}

#[test]
fn cameras_up_and_constants_are_those_of_the_library() {
    let all = views();
    let inside = meta(&page(&scene(10, 1), true, &all));
    let cameras = inside["cameras"].as_array().unwrap();
    assert_eq!(cameras.len(), all.len());
    let numbers = |v: &Value| -> Vec<f64> {
        let list = v.as_array().unwrap().iter();
        list.map(|v| v.as_f64().unwrap()).collect()
    };
    for (found, view) in cameras.iter().zip(&all) {
        let c = &view.camera;
        assert_eq!(found["name"], view.name);
        assert_eq!(found["held_out"], view.held_out);
        assert_eq!(found["size"], serde_json::json!([c.width, c.height]));
        let rows = c.rotation.transpose().to_cols_array();
        for (name, expected) in [
            ("rotation", &rows[..]),
            ("center", &c.center().to_array()),
            ("lens", &[c.fx, c.fy, c.cx, c.cy]),
        ] {
            let found = numbers(&found[name]);
            assert_eq!(found.len(), expected.len());
            for (a, b) in found.iter().zip(expected) {
                assert!((a - b).abs() <= 1e-6 * (1.0 + b.abs()), "{name}: {a} {b}");
            }
        }
    }
    assert_eq!(cameras[0]["psnr"], 31.5);
    assert!(cameras[2]["psnr"].is_null());
    // Held-out views come first; the page begins at a training view.
    assert_eq!((&inside["start"], all[0].held_out), (&Value::from(2), true));
    let up = DVec3::from_slice(&numbers(&inside["up"]));
    assert!(up.dot(DVec3::Z) > 0.9999, "{up}");
    let constants = &inside["constants"];
    for (name, value) in [
        ("near", NEAR),
        ("blur", blur(true)),
        ("alpha_max", ALPHA_MAX),
        ("alpha_min", ALPHA_MIN),
        ("color_max", COLOR_MAX),
    ] {
        assert_eq!(constants[name], value, "{name}");
    }
}

#[test]
fn up_is_what_the_photographers_call_so() {
    let close = |cameras: &[_], up: DVec3, degrees: f64| {
        let found = up_axis(cameras);
        let angle = found.angle_between(up).to_degrees();
        assert!(angle < degrees, "{found}: {angle} degrees from {up}");
    };
    let ring = |from: f64, to: f64| -> Vec<_> {
        let eye = |k: usize| {
            let a = (from + (to - from) * k as f64 / 11.0).to_radians();
            DVec3::new(2.0 * a.cos(), 2.0 * a.sin(), 2.0)
        };
        (0..12)
            .map(|k| looking(eye(k), DVec3::ZERO, DVec3::Z))
            .collect()
    };
    close(&ring(0.0, 330.0), DVec3::Z, 0.01);
    // From one side only and from above: the mean of the upward directions alone is 40 degrees off.
    close(&ring(0.0, 90.0), DVec3::Z, 3.0);
    // Along a wall, where the x axes say nothing.
    let along = |k: i32| {
        let eye = DVec3::new(f64::from(k), 0.0, 0.0);
        looking(eye, eye + DVec3::Y, DVec3::Z)
    };
    close(&(0..5).map(along).collect::<Vec<_>>(), DVec3::Z, 0.01);
    close(&[along(0)], DVec3::Z, 0.01);
    close(&[], DVec3::NEG_Y, 1e-9);
}

#[test]
fn the_page_stands_alone() {
    let mut all = views();
    let evil = "</script><script>alert(1)</script>\u{2028}\"'<!--";
    all[0].name = evil.into();
    all[0].photo = Some(photo_uri("p", &[90; 12], 2, 2).unwrap());
    let page = ScenePage {
        title: evil,
        splats: &scene(300, 2),
        anti_aliased: true,
        background: [1.0; 3],
        views: &all,
        remarks: &[evil.to_owned()],
        max_bytes: MAX_BYTES,
    };
    let (html, _) = written(&page);
    for part in [
        "http:", "https:", "src=", "import ", "import(", "url(", "<link", "fetch(", "XMLHttp",
    ] {
        assert!(!html.contains(part), "{part}");
    }
    // The page's content policy lets this style and this script in, and no others.
    let hash = |before: &str, after: &str| {
        let rest = html.split_once(before).unwrap().1;
        let text = rest.split_once(after).unwrap().0;
        BASE64.encode(hmac_sha256::Hash::hash(text.as_bytes()))
    };
    let (style, script) = (hash("<style>", "</style>"), hash("<script>", "</script>"));
    let policy = format!(
        "content=\"default-src 'none';style-src 'sha256-{style}';script-src 'sha256-{script}';img-src data:;worker-src blob:\""
    );
    assert!(html.contains(&policy), "{policy}");
    // Four shaders, two blocks of data, the script; each ends once.
    assert_eq!(html.matches("<script").count(), 7);
    assert_eq!(html.matches("</script>").count(), 7);
    assert!(!html.contains("alert(1)<") && html.contains("&lt;/script&gt;"));
    let inside = meta(&html);
    assert_eq!(inside["cameras"][0]["name"], evil);
    let photo = inside["cameras"][0]["photo"].as_str().unwrap();
    assert!(photo.starts_with("data:image/jpeg;base64,"));
    let data = element(&html, "data").len() + element(&html, "meta").len();
    assert!(
        html.len() - data < 60_000,
        "{} bytes of source",
        html.len() - data
    );
}

#[test]
fn a_page_that_cannot_be_written_leaves_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("scene.html");
    let (splats, mut all) = (scene(3, 0), views());
    let write = |views: &[_]| {
        let page = ScenePage {
            title: "t",
            splats: &splats,
            anti_aliased: false,
            background: [0.0; 3],
            views,
            remarks: &[],
            max_bytes: MAX_BYTES,
        };
        write_scene_page(&file, &page)
    };
    assert!(matches!(write(&[]), Err(Error::Numerics { .. })));
    all[1].camera.fx = f64::NAN;
    assert!(matches!(write(&all), Err(Error::Numerics { .. })));
    all[1].camera.fx = 90.0;
    all[1].scores = Some([f64::INFINITY, 0.5]);
    assert!(matches!(write(&all), Err(Error::Numerics { .. })));
    assert!(photo_uri("p", &[0; 11], 2, 2).is_err());
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
    assert!(write(&views()).unwrap().is_empty());
}

#[test]
fn views_of_a_dataset_are_held_out_ones_first() {
    let room = format!("{}/data/room-tiny", env!("CARGO_MANIFEST_DIR"));
    let dataset = load_dataset(room.as_ref(), &LoadOptions::default()).unwrap();
    let (all, remark) = scene_views(&dataset);
    assert_eq!((all.len(), remark), (40, None));
    let (held_out, training) = all.split_at(5);
    assert!(held_out.iter().all(|v| v.held_out) && training.iter().all(|v| !v.held_out));
    let many = mhsplat::Dataset {
        train: dataset.train.iter().cycle().take(2500).cloned().collect(),
        ..dataset
    };
    let (all, remark) = scene_views(&many);
    assert_eq!(all.len(), 1005);
    assert_eq!(remark.unwrap(), "1000 of 2500 training cameras are listed.");
}
