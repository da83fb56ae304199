//! Tests: export.

use std::fs;
use std::path::Path;

use glam::DVec3;

use crate::dataset::{assert_refused, data};
use mhsplat::base::error::{Error, Result};
use mhsplat::base::rng::Philox;
use mhsplat::capture::{Frame, Points, point_cloud};
use mhsplat::scene::formats::{self, Contents, read_either};
use mhsplat::scene::{Gaussians, Plane, ply};

fn splats(n: usize, sh_degree: u32) -> Gaussians {
    let planes = (0..Plane::count(sh_degree) as u64)
        .map(|p| {
            let value = |i: u64| (Philox::uniform(9, p, i)[0] * 8.0 - 4.0) as f32;
            (0..n as u64).map(value).collect()
        })
        .collect();
    Gaussians::new(sh_degree, planes).unwrap()
}

/// The points of a file that holds no Gaussians.
fn cloud(path: &Path, frame: &Frame) -> Result<Points> {
    match read_either(path, frame)? {
        Contents::Points(points) => Ok(points),
        Contents::Scene(_) => panic!("{} holds Gaussians", path.display()),
    }
}

fn property_values(path: &Path, names: &[&str], row: usize) -> Vec<f32> {
    let bytes = fs::read(path).unwrap();
    let marker = b"end_header\n";
    let at = bytes
        .windows(marker.len())
        .position(|w| w == marker)
        .unwrap()
        + marker.len();
    let header = String::from_utf8(bytes[..at].to_vec()).unwrap();
    let properties: Vec<&str> = header
        .lines()
        .filter_map(|l| l.strip_prefix("property float "))
        .collect();
    let value = |name: &&str| {
        let k = properties.iter().position(|p| p == name).unwrap();
        let start = at + 4 * (row * properties.len() + k);
        f32::from_le_bytes(bytes[start..start + 4].try_into().unwrap())
    };
    names.iter().map(value).collect()
}

#[test]
fn round_trip_keeps_every_bit() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("scene.ply");
    for degree in 0..=3 {
        let scene = splats(17, degree);
        ply::write(&file, &scene, &Frame::IDENTITY).unwrap();
        assert_eq!(
            formats::read(&file, &Frame::IDENTITY).unwrap().splats,
            scene
        );
        let again = dir.path().join("again.ply");
        ply::write(&again, &scene, &Frame::IDENTITY).unwrap();
        assert_eq!(fs::read(&file).unwrap(), fs::read(&again).unwrap());
    }
    assert_ne!(
        formats::read(&file, &Frame::IDENTITY).unwrap().splats,
        splats(18, 3)
    );
    ply::write(&file, &Gaussians::zeros(1, 0), &Frame::IDENTITY).unwrap();
    assert!(
        formats::read(&file, &Frame::IDENTITY)
            .unwrap()
            .splats
            .is_empty()
    );
    let names: Vec<_> = fs::read_dir(dir.path()).unwrap().collect();
    assert_eq!(names.len(), 2, "temporary files are left behind");
}

#[test]
fn order_is_inrias_and_sh_goes_by_channel() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("scene.ply");
    let scene = splats(3, 3);
    ply::write(&file, &scene, &Frame::IDENTITY).unwrap();
    let text = String::from_utf8_lossy(&fs::read(&file).unwrap()).into_owned();
    let names: Vec<&str> = text
        .lines()
        .take_while(|l| *l != "end_header")
        .filter_map(|l| l.strip_prefix("property float "))
        .collect();
    assert_eq!(names.len(), 62);
    assert_eq!(
        names[..10],
        [
            "x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "f_rest_0"
        ]
    );
    assert_eq!(
        names[53..],
        [
            "f_rest_44",
            "opacity",
            "scale_0",
            "scale_1",
            "scale_2",
            "rot_0",
            "rot_1",
            "rot_2",
            "rot_3"
        ]
    );
    let at = |k: usize, c: usize| scene.planes()[Plane::SH + 3 * k + c][2];
    let found = property_values(
        &file,
        &["f_rest_0", "f_rest_14", "f_rest_15", "f_rest_44", "nx"],
        2,
    );
    assert_eq!(found, [at(1, 0), at(15, 0), at(1, 1), at(15, 2), 0.0]);
}

#[test]
fn frames_move_positions_and_scales() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("scene.ply");
    let frame = Frame {
        center: DVec3::new(10.0, -20.0, 0.5),
        scale: 8.0,
    };
    let scene = splats(5, 1);
    ply::write(&file, &scene, &frame).unwrap();
    let [x, y, _]: [f32; 3] = scene.gather(Plane::POSITION, 4);
    let [s]: [f32; 1] = scene.gather(Plane::LOG_SCALE, 4);
    let found = property_values(&file, &["x", "y", "scale_0"], 4);
    assert_eq!(
        found,
        [
            x * 8.0 + 10.0,
            y * 8.0 - 20.0,
            (f64::from(s) + 8_f64.ln()) as f32
        ]
    );
    let back = formats::read(&file, &frame).unwrap().splats;
    for (p, (a, b)) in back.planes().iter().zip(scene.planes()).enumerate() {
        for (a, b) in a.iter().zip(b) {
            // Positions of up to 52 are rounded to 2e-6 in the file, an eighth of that here.
            assert!((a - b).abs() <= 1e-6, "plane {p}: {a} {b}");
        }
    }
}

#[test]
fn non_finite_is_never_written() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("scene.ply");
    fs::write(&file, "old").unwrap();
    let mut scene = splats(5, 0);
    scene.plane_mut(Plane::OPACITY)[3] = f32::NAN;
    let error = ply::write(&file, &scene, &Frame::IDENTITY).unwrap_err();
    assert!(
        error.to_string().contains("opacity of Gaussian 3"),
        "{error}"
    );
    assert_eq!(fs::read(&file).unwrap(), b"old");
    let huge = Frame {
        center: DVec3::ZERO,
        scale: 1e39,
    };
    assert!(ply::write(&file, &splats(5, 0), &huge).is_err());
    let nowhere = dir.path().join("no/scene.ply");
    assert!(matches!(
        ply::write(&nowhere, &splats(1, 0), &Frame::IDENTITY),
        Err(Error::Io { .. })
    ));
}

const ASCII: &str = "ply\r\nformat ascii 1.0\r\ncomment any order, any type\r\nelement camera 1\r\nproperty list uchar int a\r\nelement vertex 2\r\n\
property double opacity\r\nproperty float x\r\nproperty float y\r\nproperty int z\r\n\
property float rot_3\r\nproperty float rot_2\r\nproperty float rot_1\r\nproperty char rot_0\r\n\
property float scale_0\r\nproperty float scale_1\r\nproperty float scale_2\r\n\
property float f_dc_2\r\nproperty float f_dc_1\r\nproperty float f_dc_0\r\nend_header\r\n\
2 1 1\r\n0.5 1 2 3 0.3 0.2 0.1 1 -1 -2 -3 9 8 7\r\n-0.5 -1 -2 -3 0 0 0 2 0 0 0 1 1e-3 0\r\n";

fn with(dir: &Path, text: &[u8]) -> std::path::PathBuf {
    let file = dir.join("a.ply");
    fs::write(&file, text).unwrap();
    file
}

#[test]
fn ascii_in_any_order() {
    let dir = tempfile::tempdir().unwrap();
    let file = with(dir.path(), ASCII.as_bytes());
    let scene = formats::read(&file, &Frame::IDENTITY).unwrap().splats;
    assert_eq!((scene.len(), scene.sh_degree()), (2, 0));
    let all: [f32; 14] = scene.gather(0, 0);
    let expected = [
        1.0, 2.0, 3.0, -1.0, -2.0, -3.0, 1.0, 0.1, 0.2, 0.3, 0.5, 7.0, 8.0, 9.0,
    ];
    assert_eq!(all, expected);
    for (from, to, words) in [
        ("0.5 1 2", "nan 1 2", ["opacity", "vertex 0"]),
        ("-1 -2 -3 0", "-1 -inf -3 0", ["y", "vertex 1"]),
        ("1e-3 0", "1e-3", ["f_dc_0", "vertex 1"]),
        ("1e-3 0", "1e-3 x", ["f_dc_0", "'x'"]),
        ("1e-3 0", "1e-3 1e39", ["f_dc_0", "single precision"]),
        ("vertex 2", "vertex 3", ["opacity", "vertex 2"]),
        (
            "vertex 2",
            "vertex 99999999999999",
            ["99999999999999", "bytes"],
        ),
        ("vertex 2", "vertex -2", ["vertex", "-2"]),
        ("float f_dc_0", "float f_dc_1", ["f_dc_1", "twice"]),
        ("float f_dc_0", "float f_rest_0", ["1 properties", "f_rest"]),
        ("float f_dc_0", "half f_dc_0", ["f_dc_0", "half"]),
        ("int z", "int q", ["z is missing", "scene PLY of 3DGS"]),
        (
            "float scale_2",
            "float radius",
            ["scale_2 is missing", "export the Gaussians"],
        ),
        (
            "format ascii",
            "format binary_big_endian",
            ["binary_big_endian", "little"],
        ),
        ("ply\r\n", "plop\r\n", ["first line", "ply"]),
    ] {
        assert!(ASCII.contains(from), "{from}");
        let text = ASCII.replacen(from, to, 1);
        assert_refused(
            formats::read(&with(dir.path(), text.as_bytes()), &Frame::IDENTITY),
            &words,
        );
    }
}

/// Formats of 8 bits have opacities of exactly 0 and 1, whose logits are infinite.
#[test]
fn infinite_opacity_logits_are_read_as_nearly_that() {
    let dir = tempfile::tempdir().unwrap();
    let text = ASCII
        .replacen("0.5 1 2", "inf 1 2", 1)
        .replacen("-0.5 -1", "-inf -1", 1);
    let file = with(dir.path(), text.as_bytes());
    let scene = formats::read(&file, &Frame::IDENTITY).unwrap();
    assert_eq!(scene.saturated, 2);
    let opacity = |i| f64::from(scene.splats.gather::<1>(Plane::OPACITY, i)[0]);
    let sigmoid = |l: f64| 1.0 / (1.0 + (-l).exp());
    assert!(sigmoid(opacity(0)) > 1.0 - 1e-6 && sigmoid(opacity(1)) < 1e-6);
}

#[test]
fn truncated_files_are_errors_at_every_length() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("scene.ply");
    ply::write(&file, &splats(3, 0), &Frame::IDENTITY).unwrap();
    let whole = fs::read(&file).unwrap();
    for length in 0..whole.len() {
        let cut = with(dir.path(), &whole[..length]);
        assert_refused(formats::read(&cut, &Frame::IDENTITY), &["a.ply"]);
    }
    let end = whole.len();
    let mut nan = whole;
    nan[end - 4..].copy_from_slice(&f32::NAN.to_le_bytes());
    let file = with(dir.path(), &nan);
    assert_refused(
        formats::read(&file, &Frame::IDENTITY),
        &["rot_3", "vertex 2"],
    );
}

#[test]
fn point_clouds() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("points.ply");
    let points = Points {
        positions: vec![[1.0, -2.0, 0.5], [0.0, 0.25, 3.0]],
        colors: vec![[1, 2, 3], [255, 128, 0]],
    };
    let frame = Frame {
        center: DVec3::new(5e6, -4e5, 100.0),
        scale: 2.0,
    };
    point_cloud::write(&file, &points, &frame).unwrap();
    let back = cloud(&file, &frame).unwrap();
    assert_eq!(
        (&back.positions, &back.colors),
        (&points.positions, &points.colors)
    );
    assert_refused(
        formats::read(&file, &frame),
        &["point cloud", "scene PLY of 3DGS", "export the Gaussians"],
    );
    let text = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
        property float red\nproperty float green\nproperty float blue\nend_header\n1 2 3 1 0.5 0\n";
    let back = cloud(&with(dir.path(), text.as_bytes()), &Frame::IDENTITY).unwrap();
    assert_eq!(back.colors, [[255, 128, 0]]);
    let neither = text.replace("float x", "float u");
    let neither = with(dir.path(), neither.as_bytes());
    let words = ["x is missing", "point cloud (x y z", "scene PLY of 3DGS"];
    assert_refused(read_either(&neither, &Frame::IDENTITY), &words);
    assert_refused(formats::read(&neither, &Frame::IDENTITY), &words[2..]);
    let text = text.replace("1 2 3", "1 NaN 3");
    let file = with(dir.path(), text.as_bytes());
    assert_refused(cloud(&file, &Frame::IDENTITY), &["y of vertex 0"]);
}

#[test]
fn files_of_other_programs() {
    let Some(folder) = data("formats") else {
        return;
    };
    let frame = Frame::IDENTITY;
    let scene = formats::read(&folder.join("epfl_pc_short.ply"), &frame)
        .unwrap()
        .splats;
    assert_eq!((scene.len(), scene.sh_degree()), (100, 3));
    let scene = formats::read(&folder.join("kacytran_iter7000.ply"), &frame)
        .unwrap()
        .splats;
    assert_eq!((scene.len(), scene.sh_degree()), (9080, 3));
    let points = cloud(&folder.join("brush_init.ply"), &frame).unwrap();
    assert_eq!(points.positions.len(), 100);
}

#[test]
fn corrupt_bytes_never_panic() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("scene.ply");
    ply::write(&file, &splats(2, 0), &Frame::IDENTITY).unwrap();
    for whole in [fs::read(&file).unwrap(), ASCII.as_bytes().to_vec()] {
        let mut refused = 0;
        for at in 0..whole.len() {
            for flip in [0xff, 0x80, 0x01, 0x12] {
                let mut bytes = whole.clone();
                bytes[at] ^= flip;
                let corrupt = with(dir.path(), &bytes);
                refused += u32::from(formats::read(&corrupt, &Frame::IDENTITY).is_err());
            }
        }
        assert!(refused > 100, "{refused} corruptions noticed");
    }
}
