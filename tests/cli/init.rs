//! `--init`: what a run begins with.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::{mhsplat, scratch_dataset, stderr, stdout, text};
use mhsplat::Plan;
use mhsplat::TrainConfig;
use mhsplat::capture::{Dataset, LoadOptions, load, point_cloud};
use mhsplat::config::Init;
use mhsplat::lab::synth::SynthLayout;
use mhsplat::run::initial_gaussians;
use mhsplat::scene::{Gaussians, Plane};

const SH_0: f64 = 0.282_094_791_773_878_14;

/// Three points in the dataset's frame, in both forms, with and without colours.
const POINTS: [[f64; 3]; 3] = [[0.5, -0.25, 1.0], [1.5, 0.0, -2.0], [-1.0, 0.75, 0.125]];
const COLORS: [[u8; 3]; 3] = [[255, 0, 51], [10, 20, 30], [128, 64, 32]];

fn write_points(file: &Path, ascii: bool, colored: bool) {
    let form = if ascii {
        "ascii"
    } else {
        "binary_little_endian"
    };
    let channels = if colored {
        "property uchar red\nproperty uchar green\nproperty uchar blue\n"
    } else {
        ""
    };
    let mut out = format!(
        "ply\nformat {form} 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n{channels}end_header\n"
    )
    .into_bytes();
    for (p, c) in POINTS.iter().zip(COLORS) {
        if ascii {
            let words = p.iter().map(f64::to_string);
            let colors = c.iter().map(u8::to_string).filter(|_| colored);
            let line: Vec<String> = words.chain(colors).collect();
            out.extend((line.join(" ") + "\n").bytes());
        } else {
            out.extend(p.iter().flat_map(|v| (*v as f32).to_le_bytes()));
            out.extend(c.iter().filter(|_| colored));
        }
    }
    fs::write(file, out).unwrap();
}

fn first(data: &Dataset, file: &Path, more: impl FnOnce(&mut TrainConfig)) -> Gaussians {
    let mut config = TrainConfig {
        init: Init::File(file.to_path_buf()),
        ..TrainConfig::default()
    };
    config.work.morton_order = false;
    more(&mut config);
    initial_gaussians(data, &Plan::new(data, &config).unwrap()).unwrap()
}

#[test]
fn a_point_cloud_of_any_form_gives_its_points() {
    let dir = tempfile::tempdir().unwrap();
    let data = scratch_dataset(dir.path(), SynthLayout::Colmap);
    let data = load(&data, &LoadOptions::default()).unwrap();
    let file = dir.path().join("cloud.ply");
    for (ascii, colored) in [(true, true), (true, false), (false, true), (false, false)] {
        write_points(&file, ascii, colored);
        let splats = first(&data, &file, |_| {});
        assert_eq!((splats.len(), splats.sh_degree()), (3, 0));
        for (i, (p, c)) in POINTS.iter().zip(COLORS).enumerate() {
            let local = data.frame.to_local((*p).into()).as_vec3().to_array();
            assert_eq!(splats.gather::<3>(Plane::POSITION, i), local);
            let shown = if colored { c } else { [128; 3] };
            for (k, v) in shown.into_iter().enumerate() {
                let got = 0.5 + SH_0 * f64::from(splats.planes()[Plane::SH + k][i]);
                assert!((got - f64::from(v) / 255.0).abs() < 1e-6, "{got} {v}");
            }
        }
        let fewer = first(&data, &file, |c| c.max_gaussians = Some(2));
        assert_eq!(fewer.len(), 2);
    }
    // The dataset's own points, written and read, are the same start as the dataset's.
    point_cloud::write(&file, &data.points, &data.frame).unwrap();
    let own =
        initial_gaussians(&data, &Plan::new(&data, &TrainConfig::default()).unwrap()).unwrap();
    let read = first(&data, &file, |c| c.work.morton_order = true);
    assert_eq!(own.len(), read.len());
    let pairs = own
        .planes()
        .iter()
        .flatten()
        .zip(read.planes().iter().flatten());
    let off = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(off < 1e-4, "{off}");
}

/// Trains a few iterations from `init`.
fn train(dataset: &Path, run: &Path, init: &str) -> std::process::Output {
    let args = [
        "train",
        text(dataset),
        "-o",
        text(run),
        "--json",
        "--iterations",
        "4",
        "--sampler",
        "none",
        "--init",
        init,
    ];
    mhsplat(&args)
}

fn gaussians(output: &std::process::Output) -> u64 {
    assert_eq!(output.status.code(), Some(0), "{}", stderr(output));
    let record: Value = serde_json::from_str(&stdout(output)).unwrap();
    record["gaussians"].as_u64().unwrap()
}

#[test]
fn runs_begin_with_what_they_are_told() {
    let dir = tempfile::tempdir().unwrap();
    let data = scratch_dataset(dir.path(), SynthLayout::Colmap);
    let run = |name: &str| dir.path().join(name);
    let by_points = gaussians(&train(&data, &run("points"), "points"));
    assert!((100..=200).contains(&by_points), "{by_points}");
    assert!(gaussians(&train(&data, &run("random"), "random")) > 1000);
    let cloud = dir.path().join("cloud.PLY");
    write_points(&cloud, true, true);
    assert!(gaussians(&train(&data, &run("cloud"), text(&cloud))) <= 3);
    let scene = run("points").join("scene.ply");
    let on = gaussians(&train(&data, &run("on"), text(&scene)));
    assert!(on <= by_points && on > by_points / 2, "{on} {by_points}");
}

#[test]
fn files_that_are_no_start_are_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let data = scratch_dataset(dir.path(), SynthLayout::Colmap);
    let file = |name: &str, text: &str| -> PathBuf {
        let file = dir.path().join(name);
        fs::write(&file, text).unwrap();
        file
    };
    let header = |count: &str, more: &str| {
        format!("ply\nformat ascii 1.0\nelement vertex {count}\n{more}end_header\n")
    };
    let xyz = "property float x\nproperty float y\nproperty float z\n";
    let cases: [(PathBuf, &[&str]); 7] = [
        (dir.path().join("none.ply"), &["none.ply", "No such file"]),
        (file("text.ply", "hello\n"), &["text.ply", "'ply'"]),
        (
            file("points.obj", "v 1 2 3\n"),
            &["--init", "points.obj", ".ply"],
        ),
        (
            file("empty.ply", &header("0", xyz)),
            &["empty.ply", "no vertex"],
        ),
        (
            file(
                "flat.ply",
                &(header("1", "property float x\nproperty float y\n") + "1 2\n"),
            ),
            &["flat.ply", "z"],
        ),
        (
            file("nan.ply", &(header("1", xyz) + "1 nan 2\n")),
            &["nan.ply", "vertex 0"],
        ),
        (
            file(
                "half.ply",
                &(header("1", &format!("{xyz}property float opacity\n")) + "1 2 3 4\n"),
            ),
            &["half.ply", "missing"],
        ),
    ];
    for (path, words) in cases {
        let run = dir.path().join("run");
        let output = train(&data, &run, text(&path));
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{message}");
        for word in words {
            assert!(message.contains(word), "{word:?} is not in: {message}");
        }
        assert!(!run.exists() && !message.contains("panicked"), "{message}");
    }
}
