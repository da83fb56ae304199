//! A scene's background as a shell of Gaussians, for programs that know of none.

use std::fs;

use super::{LOSSY, scene, through};
use glam::{DMat3, DVec3};
use mhsplat::base::rng::Philox;
use mhsplat::capture::{Camera, Frame};
use mhsplat::config::SceneFormat;
use mhsplat::device::{CameraArg, Defines, Device};
use mhsplat::pipeline::buffers::GaussianBuffers;
use mhsplat::pipeline::forward::{RenderOptions, Renderer};
use mhsplat::scene::formats::{self, SceneFile, Sphere};
use mhsplat::scene::{Gaussians, Plane, ply};

const COLOR: [f32; 3] = [0.75, 0.25, 0.5];

/// A scene over a colour, with two Gaussians far away.
fn over_color(n: usize) -> SceneFile {
    let mut given = SceneFile {
        background: Some(COLOR),
        cameras: Some(Sphere {
            center: DVec3::ZERO,
            radius: 1.0,
        }),
        ..scene(n, 1)
    };
    given.splats.scatter(Plane::POSITION, 0, [40.0, 0.0, 0.0]);
    given.splats.scatter(Plane::POSITION, 1, [0.0, -3.0, 90.0]);
    given
}

/// Cameras within the unit sphere, which look about.
fn cameras() -> Vec<Camera> {
    let camera = |i: u64| {
        let u = Philox::uniform(3, 1, i);
        let turn = DMat3::from_rotation_y(6.2 * u[0]) * DMat3::from_rotation_x(3.0 * u[1] - 1.5);
        let v = Philox::uniform(3, 2, i);
        let center = DVec3::new(v[0] - 0.5, v[1] - 0.5, v[2] - 0.5);
        Camera::new([70.0, 70.0, 48.0, 48.0], [96, 96], (turn, -(turn * center)))
    };
    (0..12).map(camera).collect()
}

/// Pixels of what cameras see of Gaussians over a colour.
fn seen(splats: &Gaussians, background: [f32; 3]) -> Vec<f32> {
    let device = Device::open(None).unwrap();
    let defines = Defines::new(device.tuning());
    let mut renderer = Renderer::new(&device, defines, splats.sh_degree(), false).unwrap();
    let scene = GaussianBuffers::upload(&device, splats, 0).unwrap();
    let options = RenderOptions {
        sh_degree: splats.sh_degree(),
        background,
        ..RenderOptions::default()
    };
    let image = |camera: &Camera| {
        let camera = CameraArg::<f32>::new(camera, device.tuning().tile);
        renderer.render(&scene, &camera, &options).unwrap();
        renderer.read_image().unwrap().rgb
    };
    cameras().iter().flat_map(image).collect()
}

/// Largest difference of two pictures, and how many pixels differ by a hundredth.
fn difference(a: &[f32], b: &[f32]) -> (f32, usize) {
    assert_eq!(a.len(), b.len());
    let off = || a.iter().zip(b).map(|(a, b)| (a - b).abs());
    (
        off().fold(0.0, f32::max),
        off().filter(|d| *d > 0.01).count(),
    )
}

#[test]
fn other_programs_see_the_background() {
    let mut given = over_color(30);
    // Small and faint, so that most is background.
    given.splats.plane_mut(Plane::OPACITY).fill(0.0);
    for plane in Plane::LOG_SCALE..Plane::ROTATION {
        given.splats.plane_mut(plane).fill(-2.0);
    }
    let (glb, _) = through(&given, SceneFormat::Glb);
    let others = glb.splats.clone().after(2048);
    assert_eq!(others.len(), 30);
    let expected = seen(&others, COLOR);
    let (most, _) = difference(&expected, &seen(&glb.splats, [0.0; 3]));
    println!("largest difference over black: {most}");
    assert!(most < 0.01, "{most}");
    let (_, wrong) = difference(&expected, &seen(&others, [0.0; 3]));
    assert!(wrong > 100_000, "without it: {wrong}");
    // One with gaps.
    let mut thin = glb.splats.clone();
    for plane in Plane::LOG_SCALE..Plane::ROTATION {
        thin.plane_mut(plane).iter_mut().for_each(|v| *v -= 0.7);
    }
    let (gaps, _) = difference(&expected, &seen(&thin, [0.0; 3]));
    assert!(gaps > 0.1, "{gaps}");
}

#[test]
fn nothing_lies_behind_a_shell() {
    for (given, n) in [(over_color(30), 30), (over_color(0x200), 0x200)] {
        for format in [SceneFormat::Glb, SceneFormat::Splat] {
            let (back, _) = through(&given, format);
            let radius = |i: usize| {
                let place: [f32; 3] = back.splats.gather(Plane::POSITION, i);
                DVec3::from(place.map(f64::from)).length()
            };
            let all: Vec<f64> = (0..back.splats.len()).map(radius).collect();
            let (shell, others) = all.split_at(all.len() - n);
            let least = shell.iter().copied().fold(f64::INFINITY, f64::min);
            assert!(others.iter().all(|r| *r < 0.7 * least), "{format:?}");
        }
    }
    let empty = SceneFile {
        background: Some(COLOR),
        ..scene(0, 0)
    };
    let (back, _) = through(&empty, SceneFormat::Ply);
    assert_eq!((back.splats.len(), back.background), (0, Some(COLOR)));
}

#[test]
fn a_file_of_ours_gives_the_background_back() {
    let given = over_color(300);
    for format in [&[SceneFormat::Ply][..], &LOSSY].concat() {
        let (back, _) = through(&given, format);
        let told = [SceneFormat::Ply, SceneFormat::CompressedPly].contains(&format);
        assert_eq!(back.background, told.then_some(COLOR), "{format:?}");
        let shell = if told { 0 } else { 2048 };
        assert_eq!(back.splats.len(), 300 + shell, "{format:?}");
        if format == SceneFormat::Ply {
            assert!(back.splats == given.splats);
        }
    }
    // A shell beside them does not coarsen the steps of the others.
    let alone = SceneFile {
        background: None,
        ..given.clone()
    };
    let [with, without] = [&given, &alone].map(|s| through(s, SceneFormat::CompressedPly).0);
    assert!(with.splats == without.splats);
}

/// SPZ has 24 bits for a coordinate and a largest scale.
#[test]
fn a_shell_costs_no_precision_of_spz() {
    let written = |far: [f32; 3]| {
        let mut given = over_color(300);
        given.splats.scatter(Plane::POSITION, 0, far);
        let alone = SceneFile {
            background: None,
            ..given.clone()
        };
        let [(with, lost), (without, same)] = [given, alone].map(|s| through(&s, SceneFormat::Spz));
        let shell = with.splats.len() - without.splats.len();
        let with = with.splats.after(shell);
        let (positions, others) = with.planes().split_at(Plane::LOG_SCALE);
        let (exact, same_others) = without.splats.planes().split_at(Plane::LOG_SCALE);
        assert!(others == same_others && with.len() == 300, "{far:?}");
        let planes = positions.iter().zip(exact);
        let off = planes.map(|(a, b)| a.iter().zip(b).map(|(a, b)| (a - b).abs()));
        let off = off.flatten().fold(0.0, f32::max);
        let more = lost.len() - same.len();
        (shell, more, off, lost.join("\n"))
    };
    // Below 2048 units twelve bits are left behind the point.
    let fine = 1.0 / 4096.0;
    for far in [
        [6.0, 6.0, 6.0],
        [50.0, 0.0, 0.0],
        [700.0, 700.0, 700.0],
        [1900.0, 0.0, 0.0],
        [3000.0, 0.0, 0.0],
    ] {
        let (shell, more, off, _) = written(far);
        assert_eq!((shell, more), (2048, 0), "{far:?}");
        assert!(off <= fine, "{far:?}: {off}");
    }
    for far in [2040.0, 4000.0, 6000.0, 1e5] {
        let (shell, more, off, said) = written([far, 0.0, 0.0]);
        assert_eq!((shell, more, off), (0, 1, 0.0), "{far}: {said}");
        assert!(said.contains("the background is left out"), "{said}");
    }
}

#[test]
fn a_comment_whose_shell_is_gone_takes_none_away() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("scene.ply");
    for kept in [300, 3000] {
        ply::write(&file, &scene(kept, 1).splats, &Frame::IDENTITY).unwrap();
        let text = fs::read(&file).unwrap();
        let header = b"format binary_little_endian 1.0\n";
        let at = text.windows(header.len()).position(|w| w == header);
        let at = at.unwrap() + header.len();
        let comment = b"comment mhsplat background: 0.75 0.25 0.5, the first 2048 vertices\n";
        fs::write(&file, [&text[..at], comment, &text[at..]].concat()).unwrap();
        let back = formats::read(&file, &Frame::IDENTITY).unwrap();
        assert_eq!((back.splats.len(), back.background), (kept, None));
    }
}

#[test]
fn a_comment_on_other_gaussians_takes_none_away() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("scene.ply");
    ply::write_scene(&file, &over_color(300), &Frame::IDENTITY).unwrap();
    let bytes = fs::read(&file).unwrap();
    let header = bytes.windows(10).position(|w| w == b"end_header").unwrap();
    let text = String::from_utf8(bytes[..header].to_vec()).unwrap();
    let said = ["2048 vertices", "0.75 0.25 0.5", "mhsplat background:"];
    assert!(said.iter().all(|words| text.contains(words)), "{text}");
    let changed = |from: &str, to: &str| {
        let text = text.replace(from, to);
        fs::write(&file, [text.as_bytes(), &bytes[header..]].concat()).unwrap();
        let scene = formats::read(&file, &Frame::IDENTITY).unwrap();
        (scene.splats.len(), scene.background.is_some())
    };
    assert_eq!(changed("", ""), (300, true));
    for (from, to) in [
        ("first 2048", "first 2049"),
        ("first 2048", "first 4000000000"),
        ("first 2048", "first -1"),
        // Too few to tell.
        ("first 2048", "first 0"),
        ("first 2048", "first 1"),
        // Another colour than theirs.
        ("0.75 0.25", "0.75 0.5"),
        ("0.75 0.25", "1.75 0.25"),
        ("0.75 0.25", "nan 0.25"),
        ("0.75 0.25", "0.25"),
    ] {
        assert_eq!(changed(from, to), (2348, false), "{to}");
    }
}
