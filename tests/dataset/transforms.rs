//! transforms.json: round trip, conventions, refusals.

use std::fs;
use std::path::Path;

use glam::DVec3;
use serde_json::{Value, json};

use super::{assert_refused, assert_ring, load_every, ring, write_images};
use mhsplat::capture::transforms::write_transforms;
use mhsplat::capture::{Alpha, Frame, Layout, Points, point_cloud};

fn scene(count: usize, middle: DVec3) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let views = ring(count, middle);
    write_images(dir.path(), &views);
    write_transforms(&dir.path().join("transforms.json"), &views, None).unwrap();
    dir
}

/// Rewrites `name` through `change`.
fn edit(dir: &Path, name: &str, change: impl FnOnce(&mut Value)) {
    let text = fs::read(dir.join("transforms.json")).unwrap();
    let mut value = serde_json::from_slice(&text).unwrap();
    change(&mut value);
    fs::write(dir.join(name), value.to_string()).unwrap();
}

#[test]
fn cameras_survive_the_round_trip() {
    for middle in [DVec3::ONE, DVec3::new(5e6, -4e5, 1e3)] {
        let dir = scene(9, middle);
        let d = load_every(dir.path(), 8).unwrap();
        assert_eq!(d.layout, Layout::Transforms);
        assert_eq!((d.train.len(), d.test.len()), (7, 2));
        assert_ring(&d, 9, middle, 1e-8);
        assert!(d.points.positions.is_empty());
    }
}

#[test]
fn blender_convention() {
    let dir = tempfile::tempdir().unwrap();
    fs::create_dir(dir.path().join("train")).unwrap();
    let photo = image::RgbaImage::from_pixel(8, 6, image::Rgba([200, 100, 50, 128]));
    photo.save(dir.path().join("train/r_0.png")).unwrap();
    // The identity looks along −z with y up: OpenCV's y and z are the negated axes.
    let pose = json!([[1, 0, 0, 1.0], [0, 1, 0, 2.0], [0, 0, 1, 3.0], [0, 0, 0, 1]]);
    let angle = 2.0 * (0.5_f64).atan();
    let frame = json!({"file_path": "./train/r_0", "rotation": 0.01, "transform_matrix": pose});
    let file = json!({"camera_angle_x": angle, "frames": [frame]});
    fs::write(dir.path().join("transforms_train.json"), file.to_string()).unwrap();
    let d = load_every(dir.path(), 0).unwrap();
    let view = &d.train[0];
    assert_eq!(view.name, "train/r_0");
    assert!((view.camera.fx - 8.0).abs() < 1e-12 && (view.camera.fy - 8.0).abs() < 1e-12);
    assert_eq!((view.camera.cx, view.camera.cy), (4.0, 3.0));
    // A point in front of the camera, right of and above its axis.
    let p = d.frame.to_local(DVec3::new(1.5, 2.25, 2.0));
    let q = (view.camera.rotation * p + view.camera.translation) * d.frame.scale;
    assert!((q - DVec3::new(0.5, -0.25, 1.0)).length() < 1e-12, "{q}");
    assert_eq!(d.alpha(), Alpha::Transparency);
    assert_eq!(
        view.photo.load().unwrap().rgb_over([0.0; 3])[..3],
        [100, 50, 25]
    );
}

#[test]
fn a_named_split_wins() {
    let dir = scene(9, DVec3::ZERO);
    edit(dir.path(), "transforms_train.json", |v| {
        v["frames"].as_array_mut().unwrap().truncate(6);
    });
    edit(dir.path(), "transforms_test.json", |v| {
        v["frames"].as_array_mut().unwrap().drain(..6);
    });
    edit(dir.path(), "transforms_val.json", |v| {
        v["frames"] = json!("ignored")
    });
    let d = load_every(dir.path(), 2).unwrap();
    assert_eq!((d.train.len(), d.test.len()), (6, 3));
    fs::remove_file(dir.path().join("transforms_test.json")).unwrap();
    let d = load_every(dir.path(), 2).unwrap();
    assert_eq!((d.train.len(), d.test.len()), (3, 3));
    edit(dir.path(), "transforms_test.json", |_| {});
    assert_refused(load_every(dir.path(), 2), &["given twice"]);
}

#[test]
fn frames_override_the_file_and_defaults_fill_in() {
    let dir = scene(2, DVec3::ZERO);
    edit(dir.path(), "transforms.json", |v| {
        v["fl_x"] = json!(40);
        v["cx"] = json!(7);
        v["k1"] = json!(0.0);
        for key in ["fl_y", "cx", "cy", "w", "h"] {
            v["frames"][0].as_object_mut().unwrap().remove(key);
        }
        for key in ["fl_x", "fl_y", "cx", "cy"] {
            v["frames"][1].as_object_mut().unwrap().remove(key);
        }
    });
    let d = load_every(dir.path(), 0).unwrap();
    let lens = |i: usize| {
        let c = &d.train[i].camera;
        [c.fx, c.fy, c.cx, c.cy]
    };
    assert_eq!(lens(0), [21.5, 21.5, 7.0, 6.0]);
    assert_eq!(lens(1), [40.0, 40.0, 7.0, 6.0]);
}

/// Some programs on Windows write `\` between folders.
#[test]
fn either_sign_between_folders_is_read() {
    let dir = scene(3, DVec3::ZERO);
    let below = dir.path().join("photos/left");
    fs::create_dir_all(&below).unwrap();
    let points = Points {
        positions: vec![[1.0, 2.0, 3.0]],
        colors: vec![[1, 2, 3]],
    };
    point_cloud::write(&below.join("sparse.ply"), &points, &Frame::IDENTITY).unwrap();
    edit(dir.path(), "transforms.json", |v| {
        v["ply_file_path"] = json!(r"photos\left\sparse.ply");
        for frame in v["frames"].as_array_mut().unwrap() {
            let name = frame["file_path"].as_str().unwrap();
            let file = name.trim_start_matches("./");
            fs::rename(dir.path().join(file), below.join(file)).unwrap();
            frame["file_path"] = json!(format!(r".\photos\left\{file}"));
        }
    });
    let d = load_every(dir.path(), 0).unwrap();
    assert_eq!((d.train.len(), d.points.colors.len()), (3, 1));
    assert!(
        d.train[0].name.starts_with("photos/left/"),
        "{}",
        d.train[0].name
    );
}

#[test]
fn points_come_with_ply_file_path() {
    let dir = scene(3, DVec3::ZERO);
    let points = Points {
        positions: vec![[0.5, -0.25, 8.0], [1.0, 2.0, 3.0]],
        colors: vec![[1, 2, 3], [255, 0, 7]],
    };
    point_cloud::write(&dir.path().join("sparse.ply"), &points, &Frame::IDENTITY).unwrap();
    edit(dir.path(), "transforms.json", |v| {
        v["ply_file_path"] = json!("sparse.ply")
    });
    let d = load_every(dir.path(), 0).unwrap();
    assert_eq!(d.points.colors, points.colors);
    let p = d.points.positions[0].map(f64::from);
    let back = d.frame.to_dataset(DVec3::from_array(p));
    assert!((back - DVec3::new(0.5, -0.25, 8.0)).length() < 1e-5);
    edit(dir.path(), "transforms.json", |v| {
        v["ply_file_path"] = json!("../x.ply")
    });
    assert_refused(load_every(dir.path(), 0), &["not below this folder"]);
}

#[test]
fn what_cannot_be_used_is_refused() {
    type Change = fn(&mut Value);
    let cases: [(Change, &[&str]); 14] = [
        (|v| v["k4"] = json!(0.05), &["k4", "undistort"]),
        (|v| v["frames"][1]["p4"] = json!(1e-4), &["p4", "undistort"]),
        (|v| v["k1"] = json!("much"), &["k1", "number"]),
        (
            |v| v["camera_model"] = json!("EQUIRECTANGULAR"),
            &["fl_x", "whole panorama", "EQUIRECTANGULAR"],
        ),
        (
            |v| v["camera_model"] = json!("VR180_L"),
            &["VR180_L", "undistort"],
        ),
        (|v| v["frames"][0]["fl_x"] = json!(-3.0), &["focal"]),
        (|v| v["frames"][0]["w"] = json!(16.5), &["w = 16.5"]),
        (
            |v| v["frames"][0]["h"] = json!(13),
            &["16×12", "16×13", "shape"],
        ),
        (
            |v| v["frames"][0]["transform_matrix"] = json!([[1, 2], [3, 4]]),
            &["4×4"],
        ),
        (
            |v| {
                let m = json!([[1, 0, 0, 0], [1, 0.1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]);
                v["frames"][0]["transform_matrix"] = m;
            },
            &["no rigid pose"],
        ),
        (
            |v| v["frames"][0]["file_path"] = json!("../a.png"),
            &["not below"],
        ),
        (
            |v| {
                v["frames"][0]["file_path"] = json!("b.png");
                v["frames"][1]["file_path"] = json!("c.png");
            },
            &["none", "2 are missing", "b.png"],
        ),
        (|v| v["frames"] = json!([]), &["transforms.json", "no view"]),
        (|v| v["frames"] = json!(3), &["frames"]),
    ];
    for (change, words) in cases {
        let dir = scene(2, DVec3::ZERO);
        edit(dir.path(), "transforms.json", change);
        assert_refused(load_every(dir.path(), 0), words);
    }
    let dir = scene(2, DVec3::ZERO);
    fs::write(dir.path().join("transforms.json"), "{\"frames\": [NaN]}").unwrap();
    assert_refused(load_every(dir.path(), 0), &["transforms.json", "line 1"]);
}

#[test]
fn a_mirrored_pose_is_refused() {
    let dir = scene(2, DVec3::ZERO);
    edit(dir.path(), "transforms.json", |v| {
        for row in v["frames"][0]["transform_matrix"].as_array_mut().unwrap() {
            row[0] = json!(-row[0].as_f64().unwrap());
        }
    });
    assert_refused(load_every(dir.path(), 0), &["no rigid pose"]);
}

/// What looks far away may be all that there is to train on.
#[test]
fn the_only_training_view_is_never_astray() {
    let dir = scene(25, DVec3::ZERO);
    edit(dir.path(), "transforms_train.json", |v| {
        let frames = v["frames"].as_array_mut().unwrap();
        frames.truncate(1);
        for row in frames[0]["transform_matrix"]
            .as_array_mut()
            .unwrap()
            .iter_mut()
            .take(3)
        {
            row[3] = json!(1e5);
        }
    });
    edit(dir.path(), "transforms_test.json", |v| {
        v["frames"].as_array_mut().unwrap().remove(0);
    });
    let d = load_every(dir.path(), 8).unwrap();
    assert_eq!((d.train.len(), d.test.len()), (1, 24));
    assert!(d.outliers.is_empty());
}
