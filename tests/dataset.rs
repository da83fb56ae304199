//! Tests: dataset readers, split, frame, photos, initialisation.

mod colmap;
mod copies;
pub mod exports;
mod formats;
mod frames;
mod images;
mod init;
mod lens;
pub mod masks;
mod morton;
mod open_exports;
mod panoramas;
mod photo;
mod places;
mod real;
mod rigs;
mod several;
mod transforms;

pub use real::data;

use std::path::Path;

use glam::{DMat3, DQuat, DVec3};

use mhsplat::base::error::Error;
use mhsplat::capture::colmap::{ColmapModel, ColmapPoint};
use mhsplat::capture::{Camera, Dataset, LoadOptions, load};
use mhsplat::lab::synth::SynthLayout;

/// Cameras on a ring around `middle`, radius 3, each turned its own way; images named so that the order given is not the
/// sorted one.
pub fn ring(count: usize, middle: DVec3) -> Vec<(String, Camera)> {
    (0..count)
        .map(|i| {
            let angle = i as f64 * 0.7;
            let center = middle + 3.0 * DVec3::new(angle.cos(), 0.1 * i as f64, angle.sin());
            let axis = DVec3::new(0.3, 1.0, -0.2).normalize();
            let rotation = DMat3::from_quat(DQuat::from_axis_angle(axis, 0.4 + angle));
            let camera = Camera {
                rotation,
                translation: -(rotation * center),
                fx: 21.5,
                fy: 20.25,
                cx: 8.5,
                cy: 5.75,
                width: 16,
                height: 12,
            };
            (format!("v {:02}.png", (i * 7) % count), camera)
        })
        .collect()
}

/// Three points about `middle`.
pub fn three_points(middle: DVec3) -> Vec<ColmapPoint> {
    (0_u8..3)
        .map(|i| ColmapPoint {
            id: u64::from(i) + 1,
            position: (middle + DVec3::new(f64::from(i), 0.5, -0.25)).to_array(),
            color: [i, 100 + i, 255 - i],
            error: 0.5,
        })
        .collect()
}

/// One grey-ramp PNG per view below `folder`.
pub fn write_images(folder: &Path, views: &[(String, Camera)]) {
    for (name, camera) in views {
        let ramp = |x: u32, y: u32| image::Rgb([(10 * x) as u8, (20 * y) as u8, (x + y) as u8]);
        let file = folder.join(name);
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        image::RgbImage::from_fn(camera.width, camera.height, ramp)
            .save(file)
            .unwrap();
    }
}

/// A COLMAP dataset of [`ring`] views on disk.
pub fn colmap_scene(count: usize, middle: DVec3, binary: bool) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let views = ring(count, middle);
    let model = ColmapModel::from_views(&views, three_points(middle));
    model.write(&dir.path().join("sparse/0"), binary).unwrap();
    write_images(&dir.path().join("images"), &views);
    dir
}

/// Some programs on Windows begin text with a byte-order mark.
#[test]
fn text_may_begin_with_a_byte_order_mark() {
    let colmap = colmap_scene(9, DVec3::ZERO, false);
    let synth = tempfile::tempdir().unwrap();
    let transforms = crate::cli::scratch_dataset(synth.path(), SynthLayout::Transforms);
    for (path, file) in [
        (colmap.path(), "sparse/0/cameras.txt"),
        (colmap.path(), "sparse/0/images.txt"),
        (&transforms, "transforms_train.json"),
    ] {
        let before = load_every(path, 8).unwrap().train.len();
        let file = path.join(file);
        let text = std::fs::read_to_string(&file).unwrap();
        std::fs::write(&file, format!("\u{feff}{text}")).unwrap();
        assert_eq!(load_every(path, 8).unwrap().train.len(), before);
    }
}

/// Loads with a split.
pub fn load_every(path: &Path, test_every: u32) -> Result<Dataset, Error> {
    let options = LoadOptions {
        test_every,
        ..LoadOptions::default()
    };
    load(path, &options)
}

/// Asserts that `result` is an [`Error::Input`] whose message holds every one of `words`.
#[track_caller]
pub fn assert_refused<T>(result: Result<T, Error>, words: &[&str]) {
    match result {
        Ok(_) => panic!("accepted; an error with {words:?} expected"),
        Err(e @ Error::Input { .. }) => {
            let text = e.to_string();
            for word in words {
                assert!(text.contains(word), "'{text}' does not name '{word}'");
            }
        }
        Err(other) => panic!("{other:?}: Error::Input with {words:?} expected"),
    }
}

/// Largest difference between two cameras' poses (local units) and intrinsics (pixels).
pub fn camera_difference(a: &Camera, b: &Camera) -> f64 {
    let rotation = (a.rotation - b.rotation).to_cols_array();
    let pose = (a.translation - b.translation).to_array();
    let lens = [a.fx - b.fx, a.fy - b.fy, a.cx - b.cx, a.cy - b.cy];
    let all = rotation.iter().chain(&pose).chain(&lens);
    let size = if (a.width, a.height) == (b.width, b.height) {
        0.0
    } else {
        f64::INFINITY
    };
    all.fold(size, |m, v| {
        assert!(!v.is_nan());
        m.max(v.abs())
    })
}

/// Asserts that a dataset holds exactly [`ring`]'s cameras about `middle`, moved to the local frame.
#[track_caller]
pub fn assert_ring(dataset: &Dataset, count: usize, middle: DVec3, tolerance: f64) {
    let views = ring(count, middle);
    assert_eq!(dataset.train.len() + dataset.test.len(), count);
    let frame = dataset.frame;
    for view in dataset.train.iter().chain(&dataset.test) {
        let (_, camera) = views.iter().find(|(n, _)| *n == view.name).unwrap();
        let mut expected = *camera;
        expected.translation = -(camera.rotation * frame.to_local(camera.center()));
        let off = camera_difference(&view.camera, &expected);
        assert!(off <= tolerance, "{} is off by {off:e}", view.name);
    }
}

#[test]
fn camera_difference_notices_a_moved_camera() {
    let a = ring(1, DVec3::ZERO)[0].1;
    let mut b = a;
    b.translation.y += 1e-6;
    assert!(camera_difference(&a, &b) > 5e-7);
    b = a;
    b.width += 1;
    assert!(camera_difference(&a, &b) > 1.0);
}

#[test]
fn split_holds_out_every_nth_by_name() {
    let dir = colmap_scene(10, DVec3::ZERO, true);
    let names = |views: &[mhsplat::capture::View]| -> Vec<String> {
        views.iter().map(|v| v.name.clone()).collect()
    };
    let d = load_every(dir.path(), 4).unwrap();
    assert_eq!(names(&d.test), ["v 00.png", "v 04.png", "v 08.png"]);
    let rest = [1, 2, 3, 5, 6, 7, 9].map(|i| format!("v {i:02}.png"));
    assert_eq!(names(&d.train), rest);
    let d = load_every(dir.path(), 0).unwrap();
    assert_eq!((d.train.len(), d.test.len()), (10, 0));
    assert_refused(load_every(dir.path(), 1), &["none is left to train on"]);
}

#[test]
fn frame_makes_the_extent_one() {
    let middle = DVec3::new(5e6, -4e5, 1e3);
    for binary in [true, false] {
        let dir = colmap_scene(9, middle, binary);
        let d = load_every(dir.path(), 8).unwrap();
        let views = d.train.iter().chain(&d.test);
        let centers: Vec<DVec3> = views.map(|v| v.camera.center()).collect();
        let mean = centers.iter().sum::<DVec3>() / centers.len() as f64;
        let largest = centers.iter().map(|c| c.length()).fold(0.0, f64::max);
        // f64 poses at 5e6 m resolve 1e-9 m; the scene is 3 m wide.
        assert!(mean.length() < 1e-8, "mean centre {mean}");
        assert!((largest * 1.1 - 1.0).abs() < 1e-8, "extent {largest}");
        assert_ring(&d, 9, middle, 1e-8);
        assert_eq!(d.points.positions.len(), 3);
        for (p, expected) in d.points.positions.iter().zip(three_points(middle)) {
            let back = d.frame.to_dataset(DVec3::from_array(p.map(f64::from)));
            let off = back.distance(DVec3::from_array(expected.position));
            assert!(off < 1e-6, "point off by {off} m");
        }
        assert_eq!(d.points.colors[2], [2, 102, 253]);
    }
}

#[test]
fn frame_of_one_camera_takes_its_scale_from_the_points() {
    let dir = colmap_scene(1, DVec3::ZERO, true);
    let d = load_every(dir.path(), 0).unwrap();
    let center = ring(1, DVec3::ZERO)[0].1.center();
    let distances = three_points(DVec3::ZERO).into_iter();
    let mut distances: Vec<f64> = distances
        .map(|p| DVec3::from_array(p.position).distance(center))
        .collect();
    distances.sort_by(f64::total_cmp);
    assert!((d.frame.scale - distances[1]).abs() < 1e-9);
}

#[test]
fn unknown_folders_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    assert_refused(
        load_every(dir.path(), 8),
        &["cameras.bin", "transforms.json"],
    );
    assert_refused(load_every(&dir.path().join("no"), 8), &["no such folder"]);
    let options = LoadOptions {
        max_size: 0,
        ..LoadOptions::default()
    };
    assert!(matches!(
        load(dir.path(), &options),
        Err(Error::Config { .. })
    ));
}
