//! Scene files of other formats: bounded errors, extremes, damaged files, files of other programs.

mod damaged;
mod glb;
mod shell;
mod sog;

use std::fs;
use std::path::Path;

use crate::dataset::{assert_refused, data};
use glam::DVec3;
use mhsplat::base::rng::Philox;
use mhsplat::capture::Frame;
use mhsplat::config::SceneFormat;
use mhsplat::scene::formats::{self, SceneFile, Sphere};
use mhsplat::scene::{Gaussians, Plane, morton};

pub const LOSSY: [SceneFormat; 5] = [
    SceneFormat::Spz,
    SceneFormat::SpzV4,
    SceneFormat::CompressedPly,
    SceneFormat::Splat,
    SceneFormat::Glb,
];

/// Gaussians within the range of every format.
pub fn scene(n: usize, sh_degree: u32) -> SceneFile {
    let range = |plane: usize| match plane {
        0..3 => (-3.0, 3.0),
        3..6 => (-8.0, 1.0),
        6..10 => (-1.0, 1.0),
        10 => (-6.0, 6.0),
        11..14 => (-1.7, 1.7),
        _ => (-0.9, 0.9),
    };
    let plane = |p: usize| {
        let (least, most) = range(p);
        let value = |i: usize| {
            let u = Philox::uniform(5, p as u64, i as u64)[0];
            (least + u * (most - least)) as f32
        };
        (0..n).map(value).collect()
    };
    let planes = (0..Plane::count(sh_degree)).map(plane).collect();
    SceneFile::new(Gaussians::new(sh_degree, planes).unwrap())
}

/// Writes a scene and reads it back.
fn through(scene: &SceneFile, format: SceneFormat) -> (SceneFile, Vec<String>) {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join(format!("scene{}", formats::ending(format)));
    let lost = formats::write(&file, format, scene, &Frame::IDENTITY).unwrap();
    (formats::read(&file, &Frame::IDENTITY).unwrap(), lost)
}

/// Largest errors of attributes: position, log-scale, rotation angle (radians), opacity, colour (0 to 1), SH of degree 1, of higher
/// degrees; infinite for another number of Gaussians.
fn errors(a: &Gaussians, b: &Gaussians) -> [f64; 7] {
    if a.len() != b.len() {
        return [f64::INFINITY; 7];
    }
    let degree = a.sh_degree().min(b.sh_degree());
    let sigmoid = |v: f32| 1.0 / (1.0 + (-f64::from(v)).exp());
    let mut most = [0.0_f64; 7];
    for i in 0..a.len() {
        let of = |g: &Gaussians, p: usize| f64::from(g.planes()[p][i]);
        let mut take = |k: usize, v: f64| {
            assert!(!v.is_nan());
            most[k] = most[k].max(v);
        };
        for k in 0..3 {
            take(0, (of(a, k) - of(b, k)).abs());
            take(1, (of(a, 3 + k) - of(b, 3 + k)).abs());
            let sh = Plane::SH + k;
            take(4, 0.282_094_791_773_878 * (of(a, sh) - of(b, sh)).abs());
        }
        let [p, q] = [a, b].map(|g| g.gather::<4>(Plane::ROTATION, i).map(f64::from));
        let dot = |p: [f64; 4], q: [f64; 4]| p.iter().zip(q).map(|(a, b)| a * b).sum::<f64>();
        let cosine = dot(p, q).abs() / (dot(p, p) * dot(q, q)).sqrt();
        take(2, 2.0 * cosine.min(1.0).acos());
        take(
            3,
            (sigmoid(a.planes()[10][i]) - sigmoid(b.planes()[10][i])).abs(),
        );
        for p in Plane::SH + 3..Plane::count(degree) {
            take(
                if p < Plane::count(1) { 5 } else { 6 },
                (of(a, p) - of(b, p)).abs(),
            );
        }
    }
    most
}

const ATTRIBUTES: [&str; 7] = [
    "position",
    "log-scale",
    "rotation",
    "opacity",
    "colour",
    "SH 1",
    "SH 2 and 3",
];

/// Widest range of a plane within 256 Gaussians that follow each other.
fn widest(splats: &Gaussians, planes: std::ops::Range<usize>) -> f64 {
    let chunks = planes.flat_map(|p| splats.planes()[p].chunks(256));
    let width = |c: &[f32]| {
        let [least, most] = [f32::min, f32::max].map(|f| c.iter().copied().reduce(f).unwrap());
        f64::from(most) - f64::from(least)
    };
    chunks.map(width).fold(0.0, f64::max)
}

/// The bounds of docs/guide/viewing.md: the reason of each is in its format.
fn bounds(format: SceneFormat, splats: &Gaussians) -> [f64; 7] {
    // An 8-bit opacity or colour is rounded by half of 1/255.
    let half = 0.5 / 255.0 + 1e-6;
    match format {
        // 24 bits with 20 behind the point, for positions of up to 8; 16 steps per unit; 9 bits and a sign to √½; 0.15 · 255 steps per
        // unit of the constant coefficient; 64 and 32 buckets.
        SceneFormat::Spz | SceneFormat::SpzV4 => [
            0.5 / f64::from(1 << 20) + 1e-7,
            1.0 / 32.0 + 1e-6,
            0.3_f64.to_radians(),
            half,
            0.282_095 * 0.5 / (0.15 * 255.0) + 1e-6,
            2.0 / 128.0 + 1e-6,
            4.0 / 128.0 + 1e-6,
        ],
        // 10 bits, of the y axis, and 11 of the chunk's range; 10 bits to ±√½; 8 of its range of colours; 256 steps from -4 to 4.
        SceneFormat::CompressedPly => [
            0.5 / 1023.0 * widest(splats, 0..3) + 1e-6,
            0.5 / 1023.0 * widest(splats, 3..6) + 1e-6,
            0.3_f64.to_radians(),
            half,
            0.282_095 * half * widest(splats, 11..14) + 1e-6,
            1.0 / 64.0 + 1e-6,
            1.0 / 64.0 + 1e-6,
        ],
        // Everything is f32; scales and opacities are stored as such, not as logarithms and logits.
        SceneFormat::Glb => [1e-9, 2e-6, 1e-3, 1e-6, 1e-9, 1e-9, 1e-9],
        // Positions and scales are f32; rotations have 128 steps per unit.
        _ => [1e-9, 1e-5, 1.0_f64.to_radians(), half, half, 0.0, 0.0],
    }
}

/// The name of the first attribute beyond its bound.
fn beyond(errors: [f64; 7], bounds: [f64; 7]) -> Option<String> {
    let mut all = ATTRIBUTES.iter().zip(errors.iter().zip(bounds));
    let found = all.find(|(_, (e, b))| *e > b)?;
    Some(format!("{} {:.3e} > {:.3e}", found.0, found.1.0, found.1.1))
}

#[test]
fn errors_are_bounded() {
    for degree in 0..=3 {
        for format in LOSSY {
            let mut given = scene(1000, degree);
            if format == SceneFormat::CompressedPly {
                given.splats = given.splats.in_morton_order(morton::NO_UP);
            }
            let (back, lost) = through(&given, format);
            let kept = if format == SceneFormat::Splat {
                0
            } else {
                degree
            };
            assert_eq!(back.splats.sh_degree(), kept, "{format:?}");
            let found = errors(&given.splats, &back.splats);
            let bounds = bounds(format, &given.splats);
            println!("{format:?} degree {degree}: {found:?} within {bounds:?}");
            assert_eq!(beyond(found, bounds), None, "{format:?} {degree}");
            let clamped = lost.iter().any(|l| l.contains("clamped"));
            assert!(!clamped, "{format:?}: {lost:?}");
            assert_eq!(lost.is_empty(), format != SceneFormat::Splat || degree == 0);
            // No bound is so wide that it would not notice a wrong axis, order or step.
            for plane in 0..Plane::count(kept) {
                let mut wrong = back.splats.clone();
                wrong
                    .plane_mut(plane)
                    .iter_mut()
                    .for_each(|v| *v = 0.3 - *v);
                assert!(
                    beyond(errors(&given.splats, &wrong), bounds).is_some(),
                    "{plane}"
                );
            }
        }
    }
}

/// SPZ has axes of its own: half a turn about x. What is written must look the same from everywhere.
#[test]
fn spherical_harmonics_turn_with_the_axes() {
    use mhsplat::scene::sh::basis;
    let given = scene(1, 3);
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("a.spz");
    formats::write(&file, SceneFormat::Spz, &given, &Frame::IDENTITY).unwrap();
    let mut packed = Vec::new();
    let stream = fs::read(&file).unwrap();
    std::io::Read::read_to_end(&mut flate2::read::GzDecoder::new(&stream[..]), &mut packed)
        .unwrap();
    // One Gaussian: a header of 16 bytes, 20 bytes of other attributes, 45 of SH.
    assert_eq!(packed.len(), 16 + 20 + 45);
    let stored = |k: usize| (f64::from(packed[36 + 3 * (k - 1)]) - 128.0) / 128.0;
    let own = |k: usize| f64::from(given.splats.planes()[Plane::SH + 3 * k][0]);
    let mut unturned = 0.0_f64;
    for direction in [[0.6, 0.0, 0.8], [0.36, 0.48, -0.8], [-0.8, 0.36, 0.48]] {
        let [x, y, z] = direction;
        let sum = |value: &dyn Fn(usize) -> f64, d: [f64; 3]| {
            (1..16).map(|k| value(k) * basis(d)[k]).sum::<f64>()
        };
        let (a, b) = (sum(&own, direction), sum(&stored, [x, -y, -z]));
        assert!((a - b).abs() < 0.2, "{a} {b}");
        unturned = unturned.max((a - sum(&stored, direction)).abs());
    }
    assert!(unturned > 0.2, "{unturned}");
}

#[test]
fn frames_and_marks_are_kept() {
    let frame = Frame {
        center: glam::DVec3::new(10.0, -20.0, 0.5),
        scale: 0.25,
    };
    let dir = tempfile::tempdir().unwrap();
    let sphere = Sphere {
        center: DVec3::new(1.5, -2.0, 0.125),
        radius: 3.5,
    };
    for format in [&[SceneFormat::Ply][..], &LOSSY].concat() {
        for anti_aliased in [false, true] {
            let given = SceneFile {
                anti_aliased,
                up: Some([0.0, -1.0, 0.25]),
                cameras: Some(sphere),
                ..scene(40, 1)
            };
            // The name does not say what a file is, but for .splat.
            let ending = match format {
                SceneFormat::Splat => ".splat",
                _ => ".ply",
            };
            let file = dir.path().join(format!("scene{ending}"));
            let lost = formats::write(&file, format, &given, &frame).unwrap();
            let back = formats::read(&file, &frame).unwrap();
            let mut marked = anti_aliased;
            if format == SceneFormat::Splat {
                marked = false;
                assert_eq!(
                    lost.iter().any(|l| l.contains("anti-aliasing")),
                    anti_aliased
                );
            }
            assert_eq!(back.anti_aliased, marked, "{format:?}");
            assert_eq!(formats::is_anti_aliased(&file), marked, "{format:?}");
            let plain = [SceneFormat::Spz, SceneFormat::SpzV4, SceneFormat::Splat];
            let comments = !plain.contains(&format);
            // A direction: of length 1, to five decimals.
            assert_eq!(back.up.is_some(), comments);
            let lines = [SceneFormat::Ply, SceneFormat::CompressedPly].contains(&format);
            assert_eq!(back.cameras, lines.then_some(sphere), "{format:?}");
            if format == SceneFormat::Ply {
                let own = formats::read(&file, &Frame::IDENTITY).unwrap().cameras;
                let center = DVec3::new(10.375, -20.5, 0.53125);
                let radius = 0.875;
                assert_eq!(
                    own,
                    Some(Sphere { center, radius }),
                    "in the dataset's frame"
                );
            }
            let off = back.up.map_or(0.0, |up| {
                DVec3::from(up).distance(DVec3::new(0.0, -1.0, 0.25).normalize())
            });
            assert!(off < 1e-5, "{off}");
            let order = |g: &Gaussians| g.clone().in_morton_order(morton::NO_UP);
            let expected = match format {
                SceneFormat::CompressedPly => order(&given.splats),
                _ => given.splats.clone(),
            };
            let found = errors(&expected, &back.splats);
            assert!(found[0] < 0.01 && found[1] < 0.04, "{format:?} {found:?}");
        }
    }
    assert!(!formats::is_anti_aliased(&dir.path().join("none.spz")));
}

/// Marks of other programs on PLY files.
#[test]
fn marks_of_others_are_read() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("a.ply");
    formats::write(&file, SceneFormat::Ply, &scene(2, 0), &Frame::IDENTITY).unwrap();
    let plain = fs::read(&file).unwrap();
    let start = b"ply\nformat binary_little_endian 1.0\n".len();
    let read = |comments: &str| {
        let comment = format!("comment {comments}\n");
        fs::write(
            &file,
            [&plain[..start], comment.as_bytes(), &plain[start..]].concat(),
        )
        .unwrap();
        formats::read(&file, &Frame::IDENTITY).unwrap()
    };
    for wrong in [
        "1 2 3",
        "1 2 3 0",
        "1 2 3 -1",
        "1 2 nan 4",
        "1 2 3 4 5",
        "here",
    ] {
        assert_eq!(
            read(&format!("mhsplat cameras within: {wrong}")).cameras,
            None
        );
    }
    let up = Some([0.0, 0.0, 1.0]);
    for (comments, anti_aliased, axis) in [
        ("SplatRenderMode: mip", true, None),
        ("SplatRenderMode: default", false, None),
        ("antialiased 1", true, None),
        ("Vertical axis: 0 0 1", false, up),
        ("Vertical axis: y", false, None),
        ("Vertical axis: 0 nan 1", false, None),
        (
            "Exported from Brush\ncomment Vertical axis: 0 0 1\ncomment SplatRenderMode: mip",
            true,
            up,
        ),
    ] {
        let read = read(comments);
        assert_eq!(
            (read.anti_aliased, read.up),
            (anti_aliased, axis),
            "{comments}"
        );
        assert_eq!(formats::is_anti_aliased(&file), anti_aliased, "{comments}");
    }
}

/// Mip-Splatting leaves each Gaussian's filter beside it, 3DGS the colour transforms of photos beside the scene.
#[test]
fn filters_and_exposures_of_others_are_seen() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("point_cloud/iteration_30000");
    fs::create_dir_all(&folder).unwrap();
    let file = folder.join("point_cloud.ply");
    let names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3 filter_3D";
    let mut text = "ply\nformat ascii 1.0\nelement vertex 1\n".to_owned();
    for name in names.split(' ') {
        text += &format!("property float {name}\n");
    }
    let [scale, filter, frame] = [0.3_f64, 0.4, 2.0];
    let ln = scale.ln();
    text += &format!("end_header\n0 0 0 0 0 0 0 {ln} {ln} {ln} 1 0 0 0 {filter}\n");
    fs::write(&file, text).unwrap();
    let local = Frame {
        scale: frame,
        ..Frame::IDENTITY
    };
    let read = formats::read(&file, &local).unwrap();
    assert!(read.anti_aliased);
    assert!(
        read.changes()[0].contains("filter_3D"),
        "{:?}",
        read.changes()
    );
    // Scales √(s² + σ²), and the opacity times s/s' for each axis.
    let wanted = (scale.hypot(filter) / frame).ln();
    let found = f64::from(read.splats.planes()[Plane::LOG_SCALE][0]);
    assert!((found - wanted).abs() < 1e-6, "{found} {wanted}");
    let opacity = 0.5 * (scale / scale.hypot(filter)).powi(3);
    let found = f64::from(read.splats.planes()[Plane::OPACITY][0]);
    let wanted = (opacity / (1.0 - opacity)).ln();
    assert!((found - wanted).abs() < 1e-5, "{found} {wanted}");
    assert_eq!(read.changes().len(), 1);
    // Of a scene that was trained without them, or of another program: nothing to be said.
    let exposure = dir.path().join("exposure.json");
    let plain = "{\"a.png\": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]}";
    for text in [plain, "{}", "[1, 2]"] {
        fs::write(&exposure, text).unwrap();
        assert_eq!(formats::read(&file, &local).unwrap().changes().len(), 1);
    }
    fs::write(&exposure, plain.replace("[0, 1,", "[0, 1.1,")).unwrap();
    let changes = formats::read(&file, &local).unwrap().changes();
    assert!(changes[0].contains("colour transform"), "{changes:?}");
}

#[test]
fn extremes() {
    for format in LOSSY {
        let (back, lost) = through(&scene(0, 2), format);
        assert!(back.splats.is_empty() && !back.anti_aliased, "{format:?}");
        assert!(lost.iter().all(|l| !l.contains("clamped")), "{lost:?}");
        // What no format can hold is clamped and counted; nothing that is not finite is read back.
        let mut wild = scene(300, 1);
        for (plane, value) in [(3, -40.0), (4, 60.0), (11, 40.0), (15, -9.0), (10, 80.0)] {
            wild.splats.plane_mut(plane)[7] = value;
        }
        for plane in 6..10 {
            wild.splats.plane_mut(plane)[9] = 0.0;
            wild.splats.plane_mut(plane)[11] = 3e38;
        }
        let (back, lost) = through(&wild, format);
        let opacities = &back.splats.planes()[Plane::OPACITY];
        assert!(opacities.iter().all(|o| o.abs() <= 15.0), "{format:?}");
        let counted = |n: &str| lost.iter().any(|l| l.contains("clamped") && l.contains(n));
        let expected = match format {
            SceneFormat::Spz | SceneFormat::SpzV4 => ["2 scales", "1 colours", "1 view-dependent"],
            SceneFormat::Splat => ["2 scales", "1 colours", ""],
            SceneFormat::Glb => ["2 scales", "", ""],
            _ => ["1 view-dependent", "", ""],
        };
        assert!(expected.into_iter().all(counted), "{format:?}: {lost:?}");
    }
}

/// 24 bits hold what they can: the farthest Gaussian decides on the precision of all.
#[test]
fn far_positions_cost_precision_or_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("far.spz");
    let far = |distance: f32| {
        let mut given = scene(50, 0);
        given.splats.plane_mut(1)[3] = distance;
        given
    };
    for (distance, most) in [(100.0, 1e-5), (3e4, 2e-3), (8e6, 0.5)] {
        let given = far(distance);
        let (back, lost) = through(&given, SceneFormat::Spz);
        let found = errors(&given.splats, &back.splats)[0];
        assert!(found <= most, "{distance}: {found}");
        assert_eq!(!lost.is_empty(), distance > 2048.0, "{lost:?}");
    }
    let wrote = formats::write(&file, SceneFormat::Spz, &far(-9e6), &Frame::IDENTITY);
    assert_refused(wrote, &["far.spz", "9000000", "8388607", "--crop"]);
    assert!(!file.exists());
}

#[test]
fn names_say_what_is_written() {
    let of = |name: &str| formats::of_name(Path::new(name));
    assert_eq!(of("a.compressed.ply").unwrap(), SceneFormat::CompressedPly);
    assert_eq!(of("b/A.PLY").unwrap(), SceneFormat::Ply);
    assert_eq!(of("a.spz").unwrap(), SceneFormat::Spz);
    assert_eq!(of("a.v4.spz").unwrap(), SceneFormat::SpzV4);
    assert_eq!(of("a.splat").unwrap(), SceneFormat::Splat);
    for name in ["a.sog", "a", "ply", "a.ply.zip"] {
        assert_refused(of(name), &[name, ".compressed.ply", ".spz"]);
    }
}

/// One scene in two formats by another program: PLY and SPZ have different axes.
#[test]
fn files_of_other_programs() {
    let Some(folder) = data("formats") else {
        return;
    };
    let read = |name: &str| {
        formats::read(&folder.join(name), &Frame::IDENTITY)
            .unwrap()
            .splats
    };
    let [spz, mut ply] = ["playcanvas_biker.spz", "playcanvas_biker.compressed.ply"].map(read);
    // SPZ has no smaller scales than e^-10.
    for plane in Plane::LOG_SCALE..Plane::ROTATION {
        ply.plane_mut(plane)
            .iter_mut()
            .for_each(|v| *v = v.max(-10.0));
    }
    assert_eq!((spz.len(), ply.len()), (152_746, 152_746));
    // Two roundings, and chunks that are wide where the scene is thin.
    let found = errors(&spz, &ply);
    let most = [0.01, 0.1, 1.0_f64.to_radians(), 0.01, 0.05, 0.0, 0.0];
    assert_eq!(beyond(found, most), None, "{found:?}");
    assert_eq!(read("playcanvas_guitar.compressed.ply").len(), 90_854);
    for (name, z) in [
        ("v2.spz", 1.0),
        ("raw.spz", 1.0),
        ("v3.spz", -1.0),
        ("v4.spz", -1.0),
    ] {
        let splats = read(&format!("pcst_minimal-{name}"));
        assert_eq!(splats.len(), 4, "{name}");
        assert_eq!(splats.gather::<3>(0, 0), [-1.0, 0.0, z], "{name}");
        let [opacity] = splats.gather::<1>(Plane::OPACITY, 0);
        assert!((opacity - 2.219).abs() < 0.01, "{name}: {opacity}");
    }
    assert_eq!(
        read("pcst_minimal.splat").gather::<3>(0, 0),
        [-1.0, 0.0, -1.0]
    );
    for name in ["pcst_minimal.ksplat", "gsplat_test_garden.npz"] {
        assert_refused(formats::read(&folder.join(name), &Frame::IDENTITY), &[name]);
    }
}
