//! `mhsplat bench`: what may be said of samples, how work is counted, and what is printed.

mod trained;

use std::sync::LazyLock;

use super::cli;
use mhsplat::chart::axis::decades;
use mhsplat::device::tuning::Tuning;
use mhsplat::device::{Array, CameraArg, Defines, Device};
use mhsplat::lab::bench;
use mhsplat::lab::bench::record::{BenchRecord, Case, Failure, Iteration, Outcome};
use mhsplat::lab::bench::work::{Load, TileWork};
use mhsplat::lab::bench::{Options, STAGES, scene};
use mhsplat::lab::stats::{Spread, exponent, ratio};
use mhsplat::pipeline::buffers::GaussianBuffers;
use mhsplat::pipeline::forward::{RenderOptions, Renderer};

fn spread(samples: &[f64]) -> Spread {
    Spread::of(samples).unwrap()
}

#[test]
fn a_ratio_of_too_few_samples_is_refused() {
    let (three, two) = (spread(&[2.0, 4.0, 3.0]), spread(&[1.0, 1.0]));
    assert_eq!((three.median, three.min, three.max), (3.0, 2.0, 4.0));
    assert!(ratio(&three, &two).is_none());
    assert!(ratio(&two, &three).is_none());
    assert!(ratio(&spread(&[1.0]), &spread(&[1.0])).is_none());
    assert!(ratio(&three, &spread(&[0.0, 1.0, 2.0])).is_none());
    let r = ratio(&three, &spread(&[1.0, 2.0, 1.5])).unwrap();
    assert_eq!((r.median, r.low, r.high), (2.0, 1.0, 4.0));
    assert!(Spread::of(&[]).is_none());
    assert!(Spread::of(&[1.0, f64::NAN, 2.0]).is_none());
}

#[test]
fn exponents_of_exact_data() {
    let exact = |x: f64| (x, spread(&[3.0 * x.powf(1.5); 3]));
    let points: Vec<_> = [1e4, 1e5, 5e5, 1e6].map(exact).to_vec();
    let found = exponent(&points).unwrap();
    for p in [found.median, found.low, found.high] {
        assert!((p - 1.5).abs() < 1e-12, "{p}");
    }
    // Two points, a decade apart, known within a factor of two: 1 ± 2·log10(2) at the very ends.
    let wide = |x: f64| (x, spread(&[0.5 * x, x, 2.0 * x]));
    let found = exponent(&[wide(10.0), wide(100.0)]).unwrap();
    let slack = 2.0 * 2f64.log10();
    assert!((found.median - 1.0).abs() < 1e-12);
    assert!((found.low - 1.0 + slack).abs() < 1e-12 && (found.high - 1.0 - slack).abs() < 1e-12);
    assert!(exponent(&points[..1]).is_none());
    assert!(exponent(&[exact(5.0), exact(5.0)]).is_none());
    assert!(exponent(&[exact(5.0), (6.0, spread(&[1.0, 2.0]))]).is_none());
}

fn case(gaussians: usize, size: u32, ms: f64) -> Case {
    Case {
        scene: "synthetic".into(),
        gaussians,
        width: size,
        height: size,
        tuning: Tuning::CPU,
        pairs: 1,
        stages: Vec::new(),
        iteration: Iteration {
            ms: spread(&[ms; 5]),
            cpu_ms: spread(&[ms; 5]),
            cores_busy: spread(&[1.0; 5]),
            iterations: 8,
            visible: 1,
            used_pairs: 1,
            lanes: 1,
            device_bytes: 1000 * gaussians as u64,
            bytes_per_gaussian: 1000.0,
        },
    }
}

#[test]
fn growth_is_told_from_a_hundred_thousand_on() {
    let cases = [
        case(10_000, 800, 1.0),
        case(100_000, 800, 10.0),
        case(1_000_000, 800, 100.0),
        case(100_000, 1600, 20.0),
        Case {
            scene: "other.ply".into(),
            ..case(5, 800, 1e9)
        },
    ];
    let laws = bench::growth(&cases);
    let names: Vec<&str> = laws.iter().map(|g| g.what.as_str()).collect();
    assert_eq!(
        names,
        [
            "time with Gaussians, 800 × 800 px",
            "memory with Gaussians, 800 × 800 px",
            "time with pixels, 100000 Gaussians",
            "memory with pixels, 100000 Gaussians",
        ]
    );
    assert!((laws[0].exponent.median - 1.0).abs() < 1e-12);
    assert_eq!(laws[0].between, [1e5, 1e6]);
    assert_eq!(laws[0].ratio.median, 10.0);
    assert!((laws[2].exponent.median - 0.5).abs() < 1e-12);
    assert!(laws[3].exponent.median.abs() < 1e-12);
}

/// Lanes counted the slow way: every block of every pair's tile that holds a pixel within the Gaussian's bounds.
fn brute_force(work: &TileWork, tuning: &Tuning) -> u64 {
    let (tile, w) = (tuning.tile as usize, tuning.block_width as usize);
    let h = (tuning.vector_width / tuning.block_width) as usize;
    let inside = |b: u32, p: usize| (b & 0xffff) as usize <= p && p <= (b >> 16) as usize;
    let mut lanes = 0;
    for (t, list) in work.tiles.iter().enumerate() {
        let corner = [t % work.tiles_x * tile, t / work.tiles_x * tile];
        for g in list {
            let [bx, by] = work.bounds[*g as usize];
            for block in 0..tile * tile / (w * h) {
                let at = [block % (tile / w) * w, block / (tile / w) * h];
                let reached = (0..w * h).any(|l| {
                    inside(bx, corner[0] + at[0] + l % w) && inside(by, corner[1] + at[1] + l / w)
                });
                lanes += if reached { (w * h) as u64 } else { 0 };
            }
        }
    }
    lanes
}

#[test]
fn lanes_are_those_of_a_brute_force_count() {
    let device = Device::open(None).unwrap();
    let splats = scene::cloud(300);
    let camera = scene::circle(75)[1];
    let eight = Tuning {
        vector_width: 8,
        ..Tuning::CPU
    };
    for tuning in [Tuning::CPU, eight, Tuning::GPU] {
        let mut renderer =
            Renderer::<f32>::new(&device, Defines::new(tuning), scene::SH_DEGREE, false).unwrap();
        let on_device = GaussianBuffers::upload(&device, &splats, 0).unwrap();
        let arg = CameraArg::<f32>::new(&camera, tuning.tile);
        renderer
            .render(&on_device, &arg, &RenderOptions::default())
            .unwrap();
        let work = TileWork::read(&renderer).unwrap();
        assert!(work.visible > 100 && work.used() > work.visible);
        assert!(work.used() <= work.pairs);
        let lanes = work.lanes(&tuning);
        assert_eq!(lanes, brute_force(&work, &tuning));
        let all = (work.used() * tuning.tile_pixels()) as u64;
        assert!(lanes > 0 && lanes < all);
    }
}

#[test]
fn every_stage_has_an_amount_of_work() {
    let load = Load {
        gaussians: 100.0,
        planes: 59.0,
        visible: 80.0,
        pairs: 300.0,
        pixels: 1024.0,
        tiles: 4.0,
        passes: 3.0,
        pair_passes: 0.0,
        lanes: 1e4,
    };
    assert_eq!(Load::passes(&Tuning::CPU, 6700), [3.0, 0.0]);
    assert_eq!(Load::passes(&Tuning::GPU, 6700), [4.0, 2.0]);
    let sorting = Load {
        pair_passes: 2.0,
        ..load
    };
    assert_eq!(
        sorting.bytes("sort") - load.bytes("sort"),
        2.0 * 300.0 * 20.0
    );
    assert_eq!(sorting.bytes("bin") - load.bytes("bin"), 300.0 * 4.0);
    for stage in STAGES {
        let flop = Load::flop_per_lane(stage);
        assert!(flop.is_some() != (load.bytes(stage) > 0.0), "{stage}");
    }
    assert_eq!(
        load.bytes("project_grad"),
        100.0 * (59.0 * 24.0 + 8.0) + 300.0 * 36.0
    );
}

#[test]
fn the_device_counts_the_bytes_that_are_alive() {
    let device = Device::open(None).unwrap();
    assert_eq!(device.allocated_bytes(), 0);
    let one = Array::<f32>::zeros(&device, "one", 100).unwrap();
    let two = Array::<u8>::zeros(&device, "two", 3).unwrap();
    assert_eq!(device.allocated_bytes(), 403);
    drop(one);
    assert_eq!(device.allocated_bytes(), 3);
    drop(two);
    assert_eq!(device.allocated_bytes(), 0);
}

#[test]
fn logarithmic_axes() {
    let ends = |min, max| decades(min, max).map(|d| [d.low, d.high]);
    assert_eq!(ends(1e-15, 1e-2), Some([-16.0, -1.0]));
    let [low, high] = ends(3.0, 3.0).unwrap();
    assert!(low < 3f64.log10() && high > 3f64.log10());
    assert_eq!(ends(f64::INFINITY, f64::NEG_INFINITY), None);
    assert_eq!(ends(0.0, 1.0), None);
    assert_eq!(ends(f64::NAN, f64::NAN), None);
}

static RECORD: LazyLock<BenchRecord> = LazyLock::new(|| {
    let device = Device::open(None).unwrap();
    let options = Options::brief(vec![(300, 48), (1200, 48)]);
    bench::run(&device, &options, &mut |_| ()).unwrap()
});

fn has(value: &serde_json::Value, keys: &[&str]) {
    for key in keys {
        assert!(!value[key].is_null(), "{key} is missing in {value}");
    }
}

#[test]
fn json_has_the_contracts_keys() {
    let text = bench::json(&[Outcome::Done(Box::new(RECORD.clone()))]).unwrap();
    let v: serde_json::Value = serde_json::from_str(&text).unwrap();
    has(&v, &["device", "peak", "cases", "precision"]);
    assert!(v["device"].is_string());
    has(&v["peak"], &["fma_gflops", "copy_gbs"]);
    assert_eq!(v["cases"].as_array().unwrap().len(), 2);
    let times = ["median_ms", "min_ms", "max_ms", "cpu_ms", "samples"];
    for case in v["cases"].as_array().unwrap() {
        has(case, &["gaussians", "width", "height", "pairs", "stages"]);
        has(&case["iteration"], &times);
        let names: Vec<&str> = case["stages"]
            .as_array()
            .unwrap()
            .iter()
            .map(|s| s["name"].as_str().unwrap())
            .collect();
        assert_eq!(names, STAGES);
        for stage in case["stages"].as_array().unwrap() {
            has(stage, &times[..3]);
            has(stage, &["samples", "rate", "unit", "share_of_peak"]);
            let lanes = stage["name"].as_str().unwrap().starts_with("splat");
            let unit = if lanes { "lanes/core-s" } else { "bytes/s" };
            assert_eq!(stage["unit"], unit);
        }
    }
    let keys = [
        "stage",
        "variant",
        "median_ms",
        "max_rel_error",
        "median_rel_error",
    ];
    has(&v["precision"][0], &keys);
    let cut = RECORD.precision.iter().find(|p| p.variant == "cut 1/255");
    let same = RECORD.precision.iter().find(|p| p.stage == "splat");
    let (cut, same) = (cut.unwrap(), same.unwrap());
    assert!(
        cut.max_rel_error > 100.0 * same.max_rel_error,
        "{cut:?} {same:?}"
    );
}

#[test]
fn every_output_holds_every_device_and_no_nan() {
    let other = BenchRecord {
        device: "another, with a \"name\" & a comma".into(),
        failed: vec![Failure {
            what: "1000000 Gaussians".into(),
            error: "too large".into(),
        }],
        ..RECORD.clone()
    };
    let outcomes = [
        Outcome::Done(Box::new(RECORD.clone())),
        Outcome::Done(Box::new(other)),
        Outcome::Failed {
            device: "broken".into(),
            error: "does not start".into(),
        },
    ];
    let report = bench::report(&outcomes);
    let (page, text) = (report.to_html(), report.to_markdown());
    for words in [
        "Devices side by side",
        "broken",
        "does not start",
        "too large",
    ] {
        assert!(page.contains(words) && text.contains(words), "{words}");
    }
    assert!(page.contains("<svg") && page.contains("&quot;name&quot; &amp; a comma"));
    let csv = bench::csv(&outcomes);
    for out in [&page, &text, &csv] {
        assert!(!out.contains("NaN") && !out.contains("no data"));
    }
    // Each device: two cases of eight stages and the whole, and the precisions. No cell but a name holds a comma.
    let rows = 2 * (2 * 9 + RECORD.precision.len());
    assert_eq!(csv.lines().count(), 1 + rows);
    for line in csv.lines() {
        let plain = line.replace("another, with", "another with");
        assert_eq!(
            plain.replace(" & a comma", "").matches(',').count(),
            16,
            "{line}"
        );
    }
    let json: serde_json::Value = serde_json::from_str(&bench::json(&outcomes).unwrap()).unwrap();
    assert_eq!(json.as_array().unwrap().len(), 3);
    assert_eq!(json[2]["error"], "does not start");
}

#[test]
fn the_command_writes_its_folder_once() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("bench");
    let out = cli::text(&folder);
    let args = ["bench", "--brief", "100@16", "-o", out, "--json"];
    let printed: serde_json::Value = serde_json::from_str(&cli::done(&args)).unwrap();
    assert_eq!(printed["cases"][0]["gaussians"], 100);
    for name in ["bench.json", "bench.csv", "bench.md", "bench.html"] {
        assert!(folder.join(name).is_file(), "{name}");
    }
    let again = cli::mhsplat(&args);
    assert_eq!(again.status.code(), Some(2));
    assert!(cli::stderr(&again).contains("is not empty"));
}

#[test]
fn ranks_are_measured_beside_one_and_beside_another_scene() {
    let args = ["bench", "--scaling", "--brief", "600@48", "--json"];
    let printed: serde_json::Value = serde_json::from_str(&cli::done(&args)).unwrap();
    let case = &printed[0];
    let visible = case["visible"].as_f64().unwrap();
    assert!((1.0..=600.0).contains(&visible), "{visible}");
    let shared = case["shared"].as_array().unwrap();
    let sent = |k: usize, part: usize| shared[k]["bytes"][part][1].as_f64().unwrap();
    let records = |k: usize| {
        let parts = shared[k]["bytes"].as_array().unwrap();
        sent(k, parts.iter().position(|p| p[0] == "records").unwrap())
    };
    assert_eq!(records(0), 0.0, "one rank sends nothing");
    assert!(records(1) > 0.0 && records(1) < 52.0 * visible);
    // Both need two cores.
    for key in ["speedup", "speedup_beside"] {
        let samples = &case[key]["samples"];
        assert!(case[key].is_null() || samples == 3, "{key}: {samples}");
        assert_eq!(case[key].is_null(), case["beside_ms"].is_null(), "{key}");
    }
}

#[test]
fn what_cannot_be_measured_is_refused() {
    for (args, word) in [
        (vec!["bench", "--device", "abacus"], "abacus"),
        (vec!["bench", "--scene", "missing.ply"], "missing.ply"),
        (vec!["bench", "--full", "--brief", "9@9"], "--brief"),
    ] {
        let output = cli::mhsplat(&args);
        assert_eq!(output.status.code(), Some(2), "{args:?}");
        assert!(cli::stderr(&output).contains(word), "{args:?}");
    }
    let missing = [("abacus".to_owned(), Some("abacus".to_owned()))];
    let outcomes = bench::run_all(
        &missing,
        Device::open,
        &Options::brief(vec![(9, 9)]),
        &mut |_| (),
    );
    assert!(matches!(&outcomes[..], [Outcome::Failed { device, .. }] if device == "abacus"));
}
