//! Panoramas: a room traced on the sphere, in all layouts that have them, against the same room in pinhole views.

use std::f64::consts::PI;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use glam::{DMat3, DQuat, DVec3};
use serde_json::{Value, json};
use tempfile::TempDir;

use super::{assert_refused, load_every};
use crate::cli::{done, text};
use crate::learning::psnr;
use mhsplat::TrainConfig;
use mhsplat::capture::panorama::{Side, angles};
use mhsplat::capture::{Dataset, Frame, Lens, LoadOptions, PhotoSource, View, load};
use mhsplat::config::MhConfig;

/// Height of the panoramas, pixels; they are twice as wide, and their sides half as high.
const HEIGHT: u32 = 64;
/// Panoramas of a dataset.
const COUNT: usize = 8;
/// Half of the room's width.
const WALL: f64 = 2.0;

fn name(i: usize) -> String {
    format!("pano {i}.png")
}

/// Rotation from the world to the axes of a panorama, turned its own way, and its centre.
fn pose(i: usize) -> (DMat3, DVec3) {
    let k = i as f64;
    let axis = DVec3::new(0.3, 1.0, -0.2 + 0.1 * k).normalize();
    let turn = DQuat::from_axis_angle(axis, 0.4 + 0.9 * k);
    let center = 0.7 * DVec3::new((2.0 * k).cos(), (1.3 * k).sin(), 0.2 * k - 0.7);
    (DMat3::from_quat(turn), center)
}

/// The point of the walls that a ray hits.
fn hit(center: DVec3, ray: DVec3) -> DVec3 {
    let far = |k: usize| (WALL * ray[k].signum() - center[k]) / ray[k];
    let far = (0..3).map(far).filter(|t| t.is_finite());
    center + ray * far.fold(f64::INFINITY, f64::min)
}

/// Colour of a point of the walls, smooth, and the same at no two places.
fn color(p: DVec3) -> [f64; 3] {
    let waves = [0.9 * p.x + 0.4, 0.8 * p.y - 0.3, 0.7 * p.z + 0.5 * p.x];
    waves.map(|w| 128.0 + 90.0 * w.sin())
}

/// A panorama by COLMAP's formulas (`EquirectangularCameraModel`), with a function of its pixels' centres, longitudes and latitudes.
fn panorama(i: usize, value: impl Fn(DVec3, DVec3) -> [f64; 3]) -> image::RgbImage {
    let (rotation, center) = pose(i);
    image::RgbImage::from_fn(2 * HEIGHT, HEIGHT, |x, y| {
        let theta = 2.0 * PI * ((f64::from(x) + 0.5) / f64::from(2 * HEIGHT) - 0.5);
        let phi = PI * (0.5 - (f64::from(y) + 0.5) / f64::from(HEIGHT));
        let ray = DVec3::new(phi.cos() * theta.sin(), -phi.sin(), phi.cos() * theta.cos());
        image::Rgb(value(center, rotation.transpose() * ray).map(|v| v.round() as u8))
    })
}

/// A folder with the photos.
fn photos() -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    fs::create_dir(dir.path().join("images")).unwrap();
    for i in 0..COUNT {
        let photo = panorama(i, |center, ray| color(hit(center, ray)));
        photo.save(dir.path().join("images").join(name(i))).unwrap();
    }
    dir
}

/// COLMAP's model of the panoramas, in text, with points on the walls.
fn colmap(dir: &Path) {
    let model = dir.join("sparse/0");
    fs::create_dir_all(&model).unwrap();
    let (w, h) = (2 * HEIGHT, HEIGHT);
    let cameras = format!("7 EQUIRECTANGULAR {w} {h} {w} {h}\n");
    fs::write(model.join("cameras.txt"), cameras).unwrap();
    let (mut images, mut points) = (String::new(), String::new());
    for i in 0..COUNT {
        let (rotation, center) = pose(i);
        let (q, t) = (DQuat::from_mat3(&rotation), -(rotation * center));
        let [id, name] = [(i + 1).to_string(), name(i)];
        let (q, t) = ([q.w, q.x, q.y, q.z], t.to_array());
        let numbers = q.iter().chain(&t).map(|v| v.to_string());
        let numbers = numbers.collect::<Vec<_>>().join(" ");
        let _ = writeln!(images, "{id} {numbers} 7 {name}\n");
    }
    for k in 0..400 {
        let (a, b) = (f64::from(k) * 2.4, 1.0 - (f64::from(k) + 0.5) / 200.0);
        let ring = (1.0 - b * b).sqrt();
        let p = hit(DVec3::ZERO, DVec3::new(ring * a.cos(), b, ring * a.sin()));
        let [r, g, b] = color(p).map(|v| v as u8);
        let _ = writeln!(points, "{} {} {} {} {r} {g} {b} 0.5", k + 1, p.x, p.y, p.z);
    }
    fs::write(model.join("images.txt"), images).unwrap();
    fs::write(model.join("points3D.txt"), points).unwrap();
}

/// The same model's cameras and images in binary.
fn colmap_binary(dir: &Path) {
    let model = dir.join("sparse/0");
    fs::create_dir_all(&model).unwrap();
    let (w, h) = (u64::from(2 * HEIGHT), u64::from(HEIGHT));
    let mut cameras = 1_u64.to_le_bytes().to_vec();
    cameras.extend([7_i32, 17].map(i32::to_le_bytes).concat());
    cameras.extend([w, h].map(u64::to_le_bytes).concat());
    cameras.extend([w, h].map(|v| (v as f64).to_le_bytes()).concat());
    let mut images = (COUNT as u64).to_le_bytes().to_vec();
    for i in 0..COUNT {
        let (rotation, center) = pose(i);
        let (q, t) = (DQuat::from_mat3(&rotation), -(rotation * center));
        images.extend((i as u32).to_le_bytes());
        images.extend([q.w, q.x, q.y, q.z].map(f64::to_le_bytes).concat());
        images.extend(t.to_array().map(f64::to_le_bytes).concat());
        images.extend(7_u32.to_le_bytes());
        images.extend(name(i).bytes());
        images.extend([0; 9]);
    }
    fs::write(model.join("cameras.bin"), cameras).unwrap();
    fs::write(model.join("images.bin"), images).unwrap();
}

/// A transforms file as nerfstudio's, in OpenGL axes.
fn transforms() -> Value {
    let frame = |i: usize| {
        let (rotation, c) = pose(i);
        let [x, y, z] = [0, 1, 2].map(|k| rotation.row(k));
        let row = |k: usize| json!([x[k], -y[k], -z[k], c[k]]);
        json!({
            "file_path": format!("images/{}", name(i)),
            "transform_matrix": [row(0), row(1), row(2), [0, 0, 0, 1]],
        })
    };
    let frames: Vec<Value> = (0..COUNT).map(frame).collect();
    let (w, h) = (2 * HEIGHT, HEIGHT);
    json!({
        "camera_model": "EQUIRECTANGULAR", "w": w, "h": h,
        "fl_x": h, "fl_y": h, "cx": w / 2, "cy": h / 2, "k1": 0.0, "frames": frames,
    })
}

/// Metashape's export of cameras with a spherical sensor, which has no calibration.
fn metashape() -> String {
    let mut cameras = String::new();
    for i in 0..COUNT {
        let (rotation, c) = pose(i);
        let [x, y, z] = [0, 1, 2].map(|k| rotation.row(k));
        let row = |k: usize| format!("{} {} {} {}", x[k], y[k], z[k], c[k]);
        let label = name(i).replace(".png", "");
        let _ = write!(
            cameras,
            "<camera id=\"{i}\" sensor_id=\"0\" label=\"{label}\"><transform>{} {} {} 0 0 0 1</transform></camera>",
            row(0),
            row(1),
            row(2)
        );
    }
    format!(
        "<document><chunk><sensors><sensor id=\"0\" label=\"unknown\" type=\"spherical\"><resolution width=\"{}\" height=\"{HEIGHT}\"/></sensor></sensors>\
         <cameras>{cameras}</cameras></chunk></document>",
        2 * HEIGHT
    )
}

/// Largest and mean difference in 8-bit levels between a view's photo and the room in the directions of its pixels.
fn difference(view: &View, frame: &Frame) -> [f64; 2] {
    let (c, photo) = (&view.camera, view.photo.load().unwrap());
    let center = frame.to_dataset(c.center());
    let pixels = (c.width * c.height) as usize;
    let [mut largest, mut sum] = [0.0_f64; 2];
    for i in 0..pixels {
        let at = [i % c.width as usize, i / c.width as usize].map(|k| k as f64 + 0.5);
        let ray = DVec3::new((at[0] - c.cx) / c.fx, (at[1] - c.cy) / c.fy, 1.0);
        let truth = color(hit(center, c.rotation.transpose() * ray));
        for (k, truth) in truth.iter().enumerate() {
            let off = (f64::from(photo.data[k * pixels + i]) - truth).abs();
            (largest, sum) = (largest.max(off), sum + off);
        }
    }
    [largest, sum / (3 * pixels) as f64]
}

/// Asserts that the views of a dataset are the sides of the panoramas, and that their photos show what their cameras say.
fn assert_shows_the_room(data: &Dataset) {
    assert_eq!(data.views().count(), 6 * COUNT);
    assert_eq!(data.undistorted, 0);
    let remark = "panoramas cut into views (front, right, back, left, up, down): 8 into 48";
    assert_eq!(data.remarks, [remark]);
    for view in data.views() {
        let c = &view.camera;
        assert_eq!([c.width, c.height], [HEIGHT / 2; 2]);
        // 90° wide and high: the sides adjoin.
        assert_eq!([c.fx, c.fy, c.cx, c.cy], [f64::from(HEIGHT) / 4.0; 4]);
        assert_eq!(view.lens, Lens::Equirectangular);
        let [largest, mean] = difference(view, &data.frame);
        // The room's edges are sharp; anywhere else the error is what interpolation leaves.
        assert!(
            largest < 8.0 && mean < 0.8,
            "{}: {largest} {mean}",
            view.name
        );
    }
}

#[test]
fn panoramas_of_all_layouts_become_the_sides_of_a_cube() {
    let dir = photos();
    let file = dir.path().join("cameras.xml");
    fs::write(&file, metashape()).unwrap();
    assert_shows_the_room(&load_every(dir.path(), 0).unwrap());
    fs::remove_file(&file).unwrap();
    let file = dir.path().join("transforms.json");
    let whole = transforms();
    fs::write(&file, whole.to_string()).unwrap();
    assert_shows_the_room(&load_every(dir.path(), 0).unwrap());
    let mut short = whole.clone();
    for key in ["w", "h", "fl_x", "fl_y", "cx", "cy"] {
        short.as_object_mut().unwrap().remove(key);
    }
    fs::write(&file, short.to_string()).unwrap();
    assert_shows_the_room(&load_every(dir.path(), 0).unwrap());
    fs::remove_file(&file).unwrap();
    colmap_binary(dir.path());
    assert_shows_the_room(&load_every(dir.path(), 0).unwrap());
    fs::remove_dir_all(dir.path().join("sparse")).unwrap();
    colmap(dir.path());
    assert_shows_the_room(&load_every(dir.path(), 0).unwrap());
}

/// The bounds of the test above hold for no other axes: a panorama that is mirrored, upside down or turned by a quarter is told.
#[test]
fn other_axes_are_seen() {
    let dir = photos();
    colmap(dir.path());
    let file = dir.path().join("images").join(name(0));
    let right = image::open(&file).unwrap().into_rgb8();
    let mut quarter = right.clone();
    for (x, y, pixel) in right.enumerate_pixels() {
        quarter.put_pixel((x + HEIGHT / 2) % (2 * HEIGHT), y, *pixel);
    }
    for wrong in [
        image::imageops::flip_horizontal(&right),
        image::imageops::flip_vertical(&right),
        quarter,
    ] {
        wrong.save(&file).unwrap();
        let data = load_every(dir.path(), 0).unwrap();
        let sides = data.train.iter().filter(|v| v.name.starts_with("pano 0"));
        let mean = sides.map(|v| difference(v, &data.frame)[1]).sum::<f64>() / 6.0;
        assert!(mean > 10.0, "{mean}");
    }
}

#[test]
fn longitudes_and_latitudes_of_rays() {
    let cases = [
        (DVec3::Z, [0.0, 0.0]),
        (DVec3::X, [PI / 2.0, 0.0]),
        (DVec3::NEG_X, [-PI / 2.0, 0.0]),
        (DVec3::Y, [0.0, PI / 2.0]),
        (DVec3::new(0.0, -1.0, -1.0), [PI, -PI / 4.0]),
    ];
    for (ray, expected) in cases {
        assert_eq!(angles(ray), expected, "{ray}");
    }
    // The image points of the lens are those of the panorama in front.
    let ray = [0.7, -0.4];
    let expected = angles(DVec3::new(ray[0], ray[1], 1.0));
    assert_eq!(Lens::Equirectangular.distort(ray), expected);
    let back = Lens::Equirectangular.undistort(expected, Lens::Equirectangular.fold());
    let back = back.unwrap();
    assert!((back[0] - ray[0]).abs() < 1e-9 && (back[1] - ray[1]).abs() < 1e-9);
    for side in Side::ALL {
        assert_eq!(side.rotation().determinant(), 1.0, "{side:?}");
    }
}

#[test]
fn all_sides_of_a_panorama_are_on_one_side_of_the_split() {
    let dir = photos();
    colmap(dir.path());
    let data = load_every(dir.path(), 4).unwrap();
    let names: Vec<&str> = data.test.iter().map(|v| v.name.as_str()).collect();
    let sides = ["back", "down", "front", "left", "right", "up"];
    let expected = [0, 4].map(|i| sides.map(|side| format!("pano {i}_{side}.png")));
    assert_eq!(names, expected.concat());
    assert_eq!(data.train.len(), 36);
    // Up is what it is for the panoramas, whichever way their sides look.
    let up: DVec3 = (0..COUNT).map(|i| -pose(i).0.row(1)).sum();
    assert!(data.up().unwrap().dot(up.normalize()) > 0.9);
    let file = dir.path().join("images/pano 0_front.png");
    fs::copy(dir.path().join("images").join(name(1)), file).unwrap();
    let file = dir.path().join("sparse/0/images.txt");
    let images = fs::read_to_string(&file).unwrap();
    fs::write(&file, images.replace("pano 1.png", "pano 0_front.png")).unwrap();
    load_every(dir.path(), 0).unwrap();
}

/// Left of the viewing axis everything is white, right of it black: the back has the panorama's edge in its middle.
#[test]
fn sides_go_on_across_the_edge_of_a_panorama() {
    let dir = photos();
    colmap(dir.path());
    let half = |x: u32, _| image::Rgb([if x < HEIGHT { 255 } else { 0 }; 3]);
    let photo = image::RgbImage::from_fn(2 * HEIGHT, HEIGHT, half);
    photo.save(dir.path().join("images").join(name(0))).unwrap();
    let data = load_every(dir.path(), 0).unwrap();
    let side = |of: &str| {
        let wanted = format!("pano 0_{of}.png");
        let view = data.train.iter().find(|v| v.name == wanted).unwrap();
        view.photo.load().unwrap()
    };
    let n = HEIGHT as usize / 2;
    for (of, [left, right]) in [
        ("front", [255, 0]),
        ("back", [0, 255]),
        ("left", [255; 2]),
        ("right", [0; 2]),
        ("up", [255, 0]),
        ("down", [255, 0]),
    ] {
        let photo = side(of);
        for (i, v) in photo.data[..n * n].iter().enumerate() {
            let (x, y) = (i % n, i / n);
            // At the edge of the two, and around a pole, both have a share.
            let pole = matches!(of, "up" | "down") && y.abs_diff(n / 2) <= 2;
            if x.abs_diff(n / 2) > 2 || !(pole || matches!(of, "front" | "back" | "up" | "down")) {
                let expected = if x < n / 2 { left } else { right };
                assert_eq!(*v, expected, "{of} {x} {y}");
            }
        }
        let middle = |x: usize| f64::from(photo.data[n * (n / 2) + x]);
        let (a, b) = (middle(n / 2 - 1), middle(n / 2));
        assert!(
            (a + b - f64::from(left) - f64::from(right)).abs() <= 2.0,
            "{of}: {a} {b}"
        );
    }
}

#[test]
fn shrunken_sides_are_averages() {
    let dir = photos();
    colmap(dir.path());
    // Columns of the panorama are black and white in turn.
    let stripes = |x: u32, _| image::Rgb([255 * (x % 2) as u8; 3]);
    let photo = image::RgbImage::from_fn(2 * HEIGHT, HEIGHT, stripes);
    photo.save(dir.path().join("images").join(name(0))).unwrap();
    let options = LoadOptions {
        max_size: 8,
        test_every: 0,
        ..LoadOptions::default()
    };
    let data = load(dir.path(), &options).unwrap();
    for view in &data.train {
        assert_eq!([view.camera.width, view.camera.height], [8; 2]);
        assert_eq!(view.camera.fx, 4.0);
        let photo = view.photo.load().unwrap();
        if view.name.starts_with("pano 0_") {
            let grey = |v: &u8| v.abs_diff(128) <= 1;
            assert!(
                photo.data.iter().all(grey),
                "{}: {:?}",
                view.name,
                photo.data
            );
        } else {
            assert!(difference(view, &data.frame)[1] < 4.0);
        }
    }
    // Decoded on demand they are the same.
    let on_demand = LoadOptions {
        image_budget: Some(1000),
        ..options
    };
    let later = load(dir.path(), &on_demand).unwrap();
    assert!(later.photos_on_demand() && !data.photos_on_demand());
    assert_eq!(later.fingerprint(), data.fingerprint());
    for (a, b) in data.train.iter().zip(&later.train) {
        assert!(matches!(b.photo, PhotoSource::File(_)));
        assert_eq!(a.photo.load().unwrap(), b.photo.load().unwrap());
    }
}

#[test]
fn masks_are_cut_with_the_panoramas() {
    let dir = photos();
    colmap(dir.path());
    fs::create_dir(dir.path().join("masks")).unwrap();
    // Nothing counts from some 30° below the horizon on.
    let rows = 2 * HEIGHT / 3;
    let below = |_, y| image::Luma([if y < rows { 255 } else { 0_u8 }]);
    let mask = image::GrayImage::from_fn(2 * HEIGHT, HEIGHT, below);
    mask.save(dir.path().join("masks").join(name(3))).unwrap();
    let options = LoadOptions {
        test_every: 0,
        digests: true,
        ..LoadOptions::default()
    };
    let data = load(dir.path(), &options).unwrap();
    // Each file once, not for each side.
    assert_eq!(data.digests.unwrap().files.len(), COUNT + 1);
    assert_eq!(data.masked_out, ["pano 3_down.png"]);
    assert_eq!(data.train.len(), 6 * COUNT - 1);
    for view in &data.train {
        let photo = view.photo.load().unwrap();
        let counts = photo.counts();
        let n = HEIGHT as usize / 2;
        let whole = counts.iter().all(|m| *m == 1.0);
        assert_eq!(
            whole,
            !view.name.starts_with("pano 3") || view.name.contains("up"),
            "{}",
            view.name
        );
        if view.name.contains("3_front") {
            let latitude = PI * (f64::from(rows) / f64::from(HEIGHT) - 0.5);
            let column: Vec<f32> = counts.iter().copied().skip(n / 2).step_by(n).collect();
            let edge = f64::from(column.iter().sum::<f32>());
            let expected = n as f64 * (0.5 + 0.5 * latitude.tan());
            assert!((edge - expected).abs() < 0.2, "{edge} {expected}");
        }
    }
}

#[test]
fn panoramas_that_do_not_show_the_sphere_are_refused() {
    let dir = photos();
    let file = dir.path().join("transforms.json");
    let whole = transforms();
    let mut changed = whole.clone();
    changed["fl_x"] = json!(20.0);
    fs::write(&file, changed.to_string()).unwrap();
    let words = ["transforms.json", "fl_x = 20; 64 expected", "remove"];
    assert_refused(load_every(dir.path(), 0), &words);
    let mut changed = whole.clone();
    changed["k2"] = json!(0.1);
    fs::write(&file, changed.to_string()).unwrap();
    assert_refused(load_every(dir.path(), 0), &["k2", "no place"]);
    // Photos that are cropped above and below.
    let mut changed = whole;
    changed["h"] = json!(50);
    changed["fl_y"] = json!(64);
    changed["cy"] = json!(25);
    fs::write(&file, changed.to_string()).unwrap();
    for i in 0..COUNT {
        let photo = image::RgbImage::new(2 * HEIGHT, 50);
        photo.save(dir.path().join("images").join(name(i))).unwrap();
    }
    let words = ["pano ", "128×50", "twice as wide", "mask"];
    assert_refused(load_every(dir.path(), 0), &words);
    fs::remove_file(&file).unwrap();
    let file = dir.path().join("cameras.xml");
    let size = format!("<resolution width=\"128\" height=\"{HEIGHT}\"/>");
    let without = metashape().replace(&size, "");
    fs::write(&file, without).unwrap();
    assert_refused(load_every(dir.path(), 0), &["pano 0", "without resolution"]);
    let bent = metashape().replace(
        &size,
        &format!("{size}<calibration><k1>0.1</k1></calibration>"),
    );
    fs::write(&file, bent).unwrap();
    assert_refused(load_every(dir.path(), 0), &["spherical and has k1"]);
}

#[test]
fn a_room_is_learned_from_panoramas() {
    let dir = photos();
    colmap(dir.path());
    let data = load_every(dir.path(), 4).unwrap();
    let config = TrainConfig {
        iterations: 400,
        mh: MhConfig {
            // Exact pictures of 32 by 32 pixels: there is nothing to overfit.
            pair_pixels: 0.0,
            ..MhConfig::default()
        },
        ..TrainConfig::default()
    };
    let [before, after] = psnr(&data, &config);
    println!("panoramas, held out: {before:.2} dB before, {after:.2} dB after");
    assert!(after > before + 10.0 && after > 26.0, "{after}");
}

#[test]
fn runs_on_panoramas_are_described_resumed_scored_and_rendered() {
    let dir = photos();
    colmap(dir.path());
    let dataset = text(dir.path());
    let out = done(&["info", dataset]);
    assert!(
        out.contains("48 of 32x32") && out.contains("48 of panoramas"),
        "{out}"
    );
    let run = dir.path().join("run");
    let train = ["train", dataset, "-o", text(&run), "--iterations", "10"];
    done(&train);
    done(&["train", "--resume", text(&run), "--extend", "1s"]);
    done(&["eval", text(&run)]);
    let pictures = dir.path().join("pictures");
    done(&["render", text(&run), "--held-out", "-o", text(&pictures)]);
    let mut names: Vec<String> = fs::read_dir(&pictures)
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    let sides = ["back", "down", "front", "left", "right", "up"];
    assert_eq!(names, sides.map(|side| format!("pano_0_{side}.png")));
}
