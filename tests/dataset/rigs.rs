//! COLMAP models with rigs and frames (COLMAP 3.12 and later). `tests/dataset/rig` was written by pycolmap 4.2.1 from made-up
//! numbers: a rig of two cameras of different sizes, four frames of which the last is not registered, twelve points.

use std::fs;
use std::path::{Path, PathBuf};

use glam::{DMat3, DQuat, DVec3};
use tempfile::TempDir;

use super::{load_every, write_images};
use mhsplat::capture::Layout;
use mhsplat::capture::camera::Camera;
use mhsplat::capture::colmap::ColmapModel;

fn stored(form: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/dataset/rig")
        .join(form)
}

/// The records of a text file, in words.
fn records(name: &str) -> Vec<Vec<String>> {
    let text = fs::read_to_string(stored("txt").join(name)).unwrap();
    let lines = text.lines().filter(|l| !l.starts_with('#'));
    let words = |l: &str| l.split_whitespace().map(str::to_owned).collect();
    lines.map(words).collect()
}

/// A rotation and a translation from seven words.
fn rigid(words: &[String]) -> (DMat3, DVec3) {
    let v: Vec<f64> = words[..7].iter().map(|w| w.parse().unwrap()).collect();
    let rotation = DQuat::from_xyzw(v[1], v[2], v[3], v[0]).normalize();
    (DMat3::from_quat(rotation), DVec3::new(v[4], v[5], v[6]))
}

/// World-to-camera poses by image identifier, composed of what `rigs.txt` and `frames.txt` hold: sensor_from_rig ∘
/// rig_from_world.
fn composed() -> Vec<(u32, DMat3, DVec3)> {
    let rig = &records("rigs.txt")[0];
    assert_eq!(rig[1..7].join(" "), "2 CAMERA 1 CAMERA 2 1");
    let sensors = [(DMat3::IDENTITY, DVec3::ZERO), rigid(&rig[7..])];
    let mut poses = Vec::new();
    for frame in records("frames.txt") {
        let (rotation, translation) = rigid(&frame[2..]);
        for (data, (r, t)) in frame[10..].chunks_exact(3).zip(sensors) {
            let image = data[2].parse().unwrap();
            poses.push((image, r * rotation, r * translation + t));
        }
    }
    poses
}

/// The stored model as a dataset, with photos of the frame that is not registered, too.
fn dataset(form: &str) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    let sparse = dir.path().join("sparse/0");
    fs::create_dir_all(&sparse).unwrap();
    for entry in fs::read_dir(stored(form)).unwrap() {
        let file = entry.unwrap().path();
        fs::copy(&file, sparse.join(file.file_name().unwrap())).unwrap();
    }
    let camera = |width, height| Camera {
        rotation: DMat3::IDENTITY,
        translation: DVec3::ZERO,
        fx: 1.0,
        fy: 1.0,
        cx: 0.0,
        cy: 0.0,
        width,
        height,
    };
    let views: Vec<(String, Camera)> = (1..=4)
        .flat_map(|k| {
            [
                (format!("left/{k:02}.png"), camera(32, 24)),
                (format!("right/{k:02}.png"), camera(20, 30)),
            ]
        })
        .collect();
    write_images(&dir.path().join("images"), &views);
    dir
}

#[test]
fn images_of_a_rig_carry_their_whole_poses() {
    let models = [
        ColmapModel::read(&stored("bin"), true).unwrap(),
        ColmapModel::read(&stored("txt"), false).unwrap(),
    ];
    assert_eq!(models[0], models[1]);
    let poses = composed();
    assert_eq!((models[0].images.len(), poses.len()), (6, 6));
    for image in &models[0].images {
        let (_, rotation, translation) = poses.iter().find(|(id, ..)| *id == image.id).unwrap();
        let [w, x, y, z] = image.rotation;
        let read = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
        let off = (read - *rotation).to_cols_array();
        assert!(
            off.iter().all(|v| v.abs() < 1e-14),
            "{}: {off:?}",
            image.name
        );
        let off = DVec3::from_array(image.translation).distance(*translation);
        assert!(off < 1e-14, "{}: {off:e}", image.name);
    }
    // The second sensor is not where the first one is, so that a pose of the rig alone would be noticed.
    assert!(poses[0].2.distance(poses[1].2) > 0.5);
}

#[test]
fn a_dataset_with_rigs_has_the_registered_frames_alone() {
    for (form, layout) in [("bin", Layout::ColmapBin), ("txt", Layout::ColmapTxt)] {
        let dir = dataset(form);
        let data = load_every(dir.path(), 0).unwrap();
        assert_eq!((data.layout, data.missing.len()), (layout, 0));
        let names: Vec<&str> = data.train.iter().map(|v| v.name.as_str()).collect();
        let expected = [
            "left/01.png",
            "left/02.png",
            "left/03.png",
            "right/01.png",
            "right/02.png",
            "right/03.png",
        ];
        assert_eq!(names, expected);
        let lens = |k: usize| {
            let c = &data.train[k].camera;
            ([c.fx, c.fy, c.cx, c.cy], [c.width, c.height])
        };
        assert_eq!(lens(0), ([40.0, 41.0, 16.0, 12.0], [32, 24]));
        assert_eq!(lens(5), ([30.0, 30.0, 9.25, 15.5], [20, 30]));
        assert_eq!(data.points.positions.len(), 12);
    }
}
