//! The places in which a model and its photos are found, and what a path that is no dataset is told.

use std::fs;
use std::path::Path;
use std::process::Command;

use glam::DVec3;
use serde_json::json;

use super::{assert_refused, colmap_scene, load_every, ring, three_points, write_images};
use mhsplat::capture::Layout;
use mhsplat::capture::colmap::ColmapModel;

/// Writes a model of the first `count` of six views, and the photos of all of them, below `root`.
fn model(root: &Path, place: &str, photos: &str, count: usize) {
    let views = ring(6, DVec3::ZERO);
    let model = ColmapModel::from_views(&views[..count], three_points(DVec3::ZERO));
    model
        .write(&root.join(place), place.len().is_multiple_of(2))
        .unwrap();
    write_images(&root.join(photos), &views);
}

#[test]
fn a_model_is_found_where_programs_leave_it() {
    for (place, photos) in [
        ("sparse/0", "images"),
        ("sparse", "images"),
        ("", "images"),
        ("colmap/sparse/0", "images"),
        ("colmap/sparse", "colmap/images"),
        ("distorted/sparse/0", "input"),
        ("sparse/12", "images"),
    ] {
        let dir = tempfile::tempdir().unwrap();
        model(dir.path(), place, photos, 6);
        let data = load_every(dir.path(), 0).unwrap();
        assert_eq!(data.train.len(), 6, "{place}");
        assert!(data.remarks.is_empty(), "{place}: {:?}", data.remarks);
    }
    // Photos that the model was not made for are not taken in their place.
    let dir = tempfile::tempdir().unwrap();
    model(dir.path(), "distorted/sparse/0", "images", 6);
    assert_refused(load_every(dir.path(), 0), &["no camera poses"]);
}

#[test]
fn the_largest_of_several_models_is_taken_and_the_others_are_named() {
    let dir = tempfile::tempdir().unwrap();
    model(dir.path(), "sparse/0", "images", 2);
    model(dir.path(), "sparse/1", "images", 5);
    model(dir.path(), "distorted/sparse/1", "input", 5);
    let data = load_every(dir.path(), 0).unwrap();
    assert_eq!(data.train.len(), 5);
    let [share, others] = &data.remarks[..] else {
        panic!("{:?}", data.remarks);
    };
    assert_eq!(share, "5 of the 6 photos in images have a pose in sparse/1");
    assert!(others.contains("sparse/1 is used (5 photos)"), "{others}");
    assert!(others.contains("sparse/0 (2 photos)"), "{others}");
    assert!(others.contains("distorted/sparse/1 (5 photos)"), "{others}");
}

/// nerfstudio leaves COLMAP's model beside the transforms file that it makes of it.
#[test]
fn a_transforms_file_comes_before_a_model_beside_it() {
    let frame = |name: &str, x: f64| {
        json!({"file_path": format!("images/{name}"), "transform_matrix":
            [[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 3.0], [0.0, 0.0, 0.0, 1.0]]})
    };
    let views = ring(6, DVec3::ZERO);
    let [w, h] = [views[0].1.width, views[0].1.height];
    let names = views[..2].iter().map(|(name, _)| name);
    let frames: Vec<_> = names
        .zip([0.0, 1.0])
        .map(|(name, x)| frame(name, x))
        .collect();
    let file = json!({"fl_x": 20.0, "fl_y": 20.0, "w": w, "h": h, "frames": frames});
    for (place, layout, count) in [
        ("colmap/sparse/0", Layout::Transforms, 2),
        ("", Layout::Transforms, 2),
        ("sparse/0", Layout::ColmapBin, 6),
    ] {
        let dir = tempfile::tempdir().unwrap();
        model(dir.path(), place, "images", 6);
        fs::write(dir.path().join("transforms.json"), file.to_string()).unwrap();
        let data = load_every(dir.path(), 0).unwrap();
        assert_eq!((data.layout, data.train.len()), (layout, count), "{place}");
    }
}

#[test]
fn a_model_of_few_photos_is_a_warning() {
    let dir = tempfile::tempdir().unwrap();
    model(dir.path(), "sparse/0", "images", 2);
    let data = load_every(dir.path(), 0).unwrap();
    assert_eq!(data.remarks.len(), 1);
    assert!(data.remarks[0].starts_with("warning: only 2 of the 6 photos in images"));
}

#[test]
fn a_path_that_is_no_dataset_is_told_the_way_on() {
    let scene = colmap_scene(6, DVec3::ZERO, true);
    let root = scene.path();
    let whole = root.to_str().unwrap();
    for part in ["images", "sparse", "sparse/0"] {
        let words = ["a part of a dataset", whole];
        assert_refused(load_every(&root.join(part), 0), &words);
    }
    let archive = root.join("photos.zip");
    fs::write(&archive, "PK").unwrap();
    assert_refused(load_every(&archive, 0), &["photos.zip", "no zip archive"]);
    let file = root.join("images/v 00.png");
    assert_refused(
        load_every(&file, 0),
        &["a folder or a zip archive expected"],
    );
    assert_refused(load_every(&root.join("nowhere"), 0), &["no such folder"]);
    let photos = tempfile::tempdir().unwrap();
    write_images(photos.path(), &ring(2, DVec3::ZERO));
    assert_refused(load_every(photos.path(), 0), &["no camera poses", "COLMAP"]);
}

/// A pipe that nobody writes to would be read for ever.
#[cfg(unix)]
#[test]
fn pipes_are_no_files() {
    let with_pipe = |name: &str| {
        let scene = colmap_scene(6, DVec3::ZERO, true);
        let pipe = scene.path().join(name);
        fs::remove_file(&pipe).unwrap();
        let made = Command::new("mkfifo").arg(&pipe).status().unwrap();
        assert!(made.success());
        load_every(scene.path(), 0)
    };
    assert_refused(
        with_pipe("sparse/0/images.bin"),
        &["images.bin", "no regular file"],
    );
    // Photos and points may be missing.
    assert_eq!(with_pipe("images/v 00.png").unwrap().missing, ["v 00.png"]);
    let points = with_pipe("sparse/0/points3D.bin").unwrap().points;
    assert!(points.positions.is_empty());
}
