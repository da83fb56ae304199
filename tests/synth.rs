//! Synthetic scenes: same bytes every time, cameras that agree with the pictures, and shading that is what it claims to be.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use glam::{DMat3, DQuat, DVec3};

use mhsplat::base::error::Error;
use mhsplat::lab::synth::{CHROME_SPHERE, SynthLayout, SynthOptions, generate};

/// Every file below `root`: path relative to it → bytes.
fn files(root: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut open = vec![root.to_path_buf()];
    while let Some(folder) = open.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else {
                let name = path.strip_prefix(root).unwrap().to_path_buf();
                found.insert(name, fs::read(path).unwrap());
            }
        }
    }
    found
}

/// The names of files that are not the same on both sides.
fn differences(a: &Path, b: &Path) -> Vec<PathBuf> {
    let (a, b) = (files(a), files(b));
    let names: std::collections::BTreeSet<_> = a.keys().chain(b.keys()).cloned().collect();
    names.into_iter().filter(|n| a.get(n) != b.get(n)).collect()
}

fn small(layout: SynthLayout) -> SynthOptions {
    SynthOptions {
        layout,
        views: 9,
        width: 48,
        height: 40,
        points: 60,
        seed: 3,
        samples: 4,
    }
}

#[test]
fn same_arguments_same_bytes_whatever_the_thread_count() {
    let dir = tempfile::tempdir().unwrap();
    for (name, layout) in [
        ("room", SynthLayout::Colmap),
        ("room", SynthLayout::ColmapTxt),
        ("object", SynthLayout::Transforms),
    ] {
        let options = small(layout);
        let places = ["a", "b", "c"].map(|x| dir.path().join(format!("{name}-{layout:?}-{x}")));
        for (place, threads) in places.iter().zip([1, 3]) {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            pool.install(|| generate(name, place, &options)).unwrap();
        }
        assert_eq!(differences(&places[0], &places[1]), Vec::<PathBuf>::new());
        // The comparison notices another seed, in every picture and the points.
        let other = SynthOptions { seed: 4, ..options };
        generate(name, &places[2], &other).unwrap();
        assert!(differences(&places[0], &places[2]).len() >= 10);
    }
}

/// A camera of `images.txt`: name, rotation, translation.
fn poses(root: &Path) -> Vec<(String, DMat3, DVec3)> {
    let text = fs::read_to_string(root.join("sparse/0/images.txt")).unwrap();
    text.lines()
        .filter(|l| !l.starts_with('#') && !l.is_empty())
        .map(|l| {
            let words: Vec<&str> = l.split(' ').collect();
            let n: Vec<f64> = words[1..8].iter().map(|w| w.parse().unwrap()).collect();
            let r = DMat3::from_quat(DQuat::from_xyzw(n[1], n[2], n[3], n[0]));
            (words[9].to_owned(), r, DVec3::new(n[4], n[5], n[6]))
        })
        .collect()
}

/// Numbers on the lines of a COLMAP text file, comments and words left out.
fn numbers(path: &Path) -> Vec<Vec<f64>> {
    let text = fs::read_to_string(path).unwrap();
    text.lines()
        .filter(|l| !l.starts_with('#'))
        .map(|l| l.split(' ').filter_map(|w| w.parse().ok()).collect())
        .collect()
}

/// For each point: the least difference (mean over channels, of 255) between its colour and the pixel it lands on, over all views,
/// and the number of views it lands in. Points may be hidden in some views, but each was seen in one. `shift` moves the cameras
/// sideways, in pixels.
fn best_differences(root: &Path, shift: f64) -> Vec<f64> {
    let k = numbers(&root.join("sparse/0/cameras.txt")).remove(0);
    let (width, height) = (k[1], k[2]);
    let (fx, fy, cx, cy) = (k[3], k[4], k[5] + shift, k[6]);
    let views: Vec<_> = poses(root)
        .into_iter()
        .map(|(name, r, t)| {
            (
                image::open(root.join("images").join(name))
                    .unwrap()
                    .to_rgb8(),
                r,
                t,
            )
        })
        .collect();
    let points = numbers(&root.join("sparse/0/points3D.txt"));
    points
        .iter()
        .map(|p| {
            let at = DVec3::new(p[1], p[2], p[3]);
            let mut best = f64::INFINITY;
            for (photo, r, t) in &views {
                let q = *r * at + *t;
                let (x, y) = (fx * q.x / q.z + cx, fy * q.y / q.z + cy);
                if q.z > 0.0 && (0.0..width).contains(&x) && (0.0..height).contains(&y) {
                    let pixel = photo.get_pixel(x as u32, y as u32).0;
                    let d = (0..3)
                        .map(|c| (f64::from(pixel[c]) - p[4 + c]).abs())
                        .sum::<f64>()
                        / 3.0;
                    best = best.min(d);
                }
            }
            best
        })
        .collect()
}

#[test]
fn points_land_on_their_colour() {
    let dir = tempfile::tempdir().unwrap();
    let options = SynthOptions {
        views: 6,
        width: 320,
        height: 240,
        points: 1500,
        samples: 4,
        ..small(SynthLayout::ColmapTxt)
    };
    generate("room", dir.path(), &options).unwrap();
    // A pixel is a mean over its area, so points next to an edge differ; nine in ten do not, and agree to 8 of 255.
    let close = |differences: &[f64]| {
        let near = differences.iter().filter(|d| **d < 8.0).count();
        near as f64 / differences.len() as f64
    };
    let right = close(&best_differences(dir.path(), 0.0));
    let wrong = close(&best_differences(dir.path(), 20.0));
    println!("share of points on their colour: {right:.3}, with cameras 20 pixels off: {wrong:.3}");
    assert!(right > 0.9, "{right}");
    assert!(
        wrong < right - 0.4,
        "{wrong} against {right}: the test would not notice wrong cameras"
    );
}

/// Cameras of `transforms_train.json`: file, camera-to-world rotation in OpenCV's axes, centre; and the focal length.
fn frames(root: &Path) -> (Vec<(PathBuf, DMat3, DVec3)>, f64) {
    let text = fs::read_to_string(root.join("transforms_train.json")).unwrap();
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(json["ply_file_path"], "points3d.ply");
    let frames = json["frames"].as_array().unwrap().iter().map(|f| {
        let m = |i: usize, j: usize| f["transform_matrix"][i][j].as_f64().unwrap();
        let column = |j: usize| DVec3::new(m(0, j), m(1, j), m(2, j));
        let file = root.join(f["file_path"].as_str().unwrap());
        (
            file,
            DMat3::from_cols(column(0), -column(1), -column(2)),
            column(3),
        )
    });
    (
        frames.collect(),
        json["frames"][0]["fl_x"].as_f64().unwrap(),
    )
}

#[test]
fn chrome_changes_with_the_view_and_matt_paint_does_not() {
    let dir = tempfile::tempdir().unwrap();
    let options = SynthOptions {
        views: 24,
        width: 200,
        height: 200,
        samples: 9,
        ..small(SynthLayout::Transforms)
    };
    let report = generate("object", dir.path(), &options).unwrap();
    assert_eq!((report.train_views, report.test_views), (21, 3));
    let (frames, focal) = frames(dir.path());
    assert_eq!(frames.len(), 21);
    // The top of the chrome sphere, and that of the red box, which no other part hides from above.
    let (middle, radius) = CHROME_SPHERE;
    let top = DVec3::from(middle) + DVec3::Z * radius;
    let spreads = [top, DVec3::new(0.78, -0.25, 0.24)].map(|at| {
        let (mut low, mut high, mut seen) = ([255.0f64; 3], [0.0f64; 3], 0);
        for (file, rotation, center) in &frames {
            // From steep views only, so that nothing stands in the way.
            if center.z < 2.6 {
                continue;
            }
            let q = rotation.transpose() * (at - *center);
            let photo = image::open(file).unwrap().to_rgba8();
            let (x, y) = (focal * q.x / q.z + 100.0, focal * q.y / q.z + 100.0);
            let pixel = photo.get_pixel(x as u32, y as u32).0;
            assert_eq!(pixel[3], 255, "the object is opaque here");
            seen += 1;
            for c in 0..3 {
                low[c] = low[c].min(f64::from(pixel[c]));
                high[c] = high[c].max(f64::from(pixel[c]));
            }
        }
        assert!(seen >= 6, "{seen} views");
        (0..3).map(|c| high[c] - low[c]).sum::<f64>() / 3.0
    });
    println!(
        "spread over views: chrome {:.1}, matt {:.1}",
        spreads[0], spreads[1]
    );
    assert!(spreads[0] > 80.0, "chrome {}", spreads[0]);
    assert!(spreads[1] < 3.0, "matt {}", spreads[1]);
    // The background is transparent.
    let corner = image::open(&frames[0].0)
        .unwrap()
        .to_rgba8()
        .get_pixel(0, 0)
        .0;
    assert_eq!(corner, [0, 0, 0, 0]);
}

#[test]
fn refuses_what_it_cannot_do() {
    let dir = tempfile::tempdir().unwrap();
    let options = small(SynthLayout::Colmap);
    fs::write(dir.path().join("precious.txt"), "mine").unwrap();
    let refused = generate("room", dir.path(), &options);
    assert!(matches!(refused, Err(Error::Input { .. })), "{refused:?}");
    assert_eq!(files(dir.path()).len(), 1, "nothing was written");
    let file = dir.path().join("precious.txt");
    assert!(matches!(
        generate("room", &file, &options),
        Err(Error::Input { .. })
    ));
    let fresh = dir.path().join("fresh");
    let unknown = generate("kitchen", &fresh, &options)
        .unwrap_err()
        .to_string();
    assert!(
        unknown.contains("room") && unknown.contains("object"),
        "{unknown}"
    );
    for wrong in [
        SynthOptions {
            views: 1,
            ..options.clone()
        },
        SynthOptions {
            width: 0,
            ..options.clone()
        },
        SynthOptions {
            samples: 5000,
            ..options.clone()
        },
    ] {
        assert!(matches!(
            generate("room", &fresh, &wrong),
            Err(Error::Config { .. })
        ));
    }
    assert!(!fresh.exists());
}
