//! Run records, metrics tables and the report page.

mod page;
pub mod samples;
mod script;

use samples::*;

use std::path::Path;

use mhsplat::base::error::Error;
use mhsplat::density::DensityStats;
use mhsplat::run::table::Row;
use mhsplat::run::*;

fn keys(value: &serde_json::Value) -> Vec<&str> {
    let mut keys: Vec<_> = value
        .as_object()
        .unwrap()
        .keys()
        .map(String::as_str)
        .collect();
    keys.sort_unstable();
    keys
}

#[test]
fn run_json_has_the_contracts_keys() {
    let text = record().to_json().unwrap();
    let value: serde_json::Value = serde_json::from_str(&text).unwrap();
    let mut expected = [
        "version",
        "commit",
        "config",
        "seed",
        "dataset",
        "device",
        "plan",
        "iterations",
        "gaussians",
        "train_seconds",
        "wall_seconds",
        "cpu_seconds",
        "peak_rss_bytes",
        "photos",
        "stages",
        "density",
        "final",
    ];
    expected.sort_unstable();
    assert_eq!(keys(&value), expected);
    let dataset = [
        "fingerprint",
        "height",
        "layout",
        "path",
        "test_views",
        "train_views",
        "width",
    ];
    assert_eq!(keys(&value["dataset"]), dataset);
    assert_eq!(
        keys(&value["device"]),
        [
            "compute_units",
            "cores",
            "driver",
            "name",
            "platform",
            "vendor"
        ]
    );
    assert_eq!(keys(&value["plan"]), ["kept", "left_out"]);
    assert_eq!(keys(&value["plan"]["left_out"][0]), ["what", "why"]);
    assert_eq!(keys(&value["stages"][0]), ["calls", "name", "seconds"]);
    for key in ["proposed", "accepted", "relocated", "pruned"] {
        assert!(value["density"][key].is_u64(), "{key}");
    }
    assert_eq!(keys(&value["final"]), ["flip", "per_view", "psnr", "ssim"]);
    assert_eq!(
        keys(&value["final"]["per_view"][0]),
        ["flip", "psnr", "ssim", "view"]
    );
    let means = "\"final\": {\n    \"psnr\": 27.314159,\n    \"ssim\": 0.87123,\n    \"flip\": 0.0912,\n    \"per_view\": [";
    let view = "{\n        \"view\": \"IMG_0008.jpg\",\n        \"psnr\": 26.9,\n        \"ssim\": 0.86,\n        \"flip\": 0.0951\n      }";
    for part in [means, view] {
        assert!(text.contains(part), "{text}");
    }
    // An f32 option is spelt as it was typed, so that the file serves as a configuration.
    assert!(text.contains("\"lambda-ssim\": 0.2,"));
}

#[test]
fn run_json_round_trips() {
    let dir = tempfile::tempdir().unwrap();
    for record in [
        record(),
        RunRecord {
            final_scores: None,
            ..record()
        },
    ] {
        record.write(dir.path()).unwrap();
        assert_eq!(RunRecord::read(dir.path()).unwrap(), record);
    }
    std::fs::write(dir.path().join("run.json"), "{\"version\": 3}").unwrap();
    assert!(matches!(
        RunRecord::read(dir.path()),
        Err(Error::Input { .. })
    ));
    let absent = RunRecord::read(dir.path().join("absent"));
    assert!(matches!(absent, Err(Error::Io { .. })));
}

#[test]
fn run_json_refuses_what_is_not_finite() {
    let dir = tempfile::tempdir().unwrap();
    record().write(dir.path()).unwrap();
    type Spoil = fn(&mut RunRecord);
    let cases: [(&str, Spoil); 7] = [
        ("flip", |r| {
            r.final_scores.as_mut().unwrap().per_view[1].scores.flip = Some(f64::NAN)
        }),
        ("train_seconds", |r| r.train_seconds = f64::NAN),
        ("psnr", |r| {
            r.final_scores.as_mut().unwrap().mean.psnr = f64::INFINITY
        }),
        ("seconds", |r| r.stages[3].seconds = f64::NEG_INFINITY),
        ("mean_prior", |r| r.density.mean_prior = f64::NAN),
        ("time-budget", |r| r.config.time_budget = Some(f64::NAN)),
        ("lambda-ssim", |r| r.config.loss.lambda_ssim = f64::NAN),
    ];
    for (name, spoil) in cases {
        let mut bad = record();
        spoil(&mut bad);
        match bad.write(dir.path()) {
            Err(Error::Numerics { what, .. }) => assert!(what.contains(name), "{name}: {what}"),
            other => panic!("{name}: {other:?}"),
        }
    }
    assert_eq!(
        RunRecord::read(dir.path()).unwrap(),
        record(),
        "the good file stays"
    );
}

#[test]
fn metrics_csv_has_the_contracts_columns() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("metrics.csv");
    let mut writer = MetricsWriter::open(&path, None).unwrap();
    let row = MetricsRow {
        iteration: 500,
        train_seconds: 1.5,
        wall_seconds: 2.25,
        cpu_seconds: 3.0,
        loss: Some(0.125),
        psnr: None,
        ssim: Some(0.5),
        gaussians: 6,
        proposed: 7,
        accepted: 8,
        relocated: 9,
        pruned: 10,
        non_finite: 11,
    };
    writer.write(&row).unwrap();
    // Read while the writer is alive: a row is there as soon as `write` returns.
    let text = std::fs::read_to_string(&path).unwrap();
    assert_eq!(
        text,
        "iteration,train_seconds,wall_seconds,cpu_seconds,loss,psnr,ssim,gaussians,proposed,accepted,relocated,pruned,non_finite\n\
         500,1.5,2.25,3,0.125,,0.5,6,7,8,9,10,11\n"
    );
    assert_eq!(read_rows::<MetricsRow>(&path).unwrap(), [row]);
    let bad = MetricsRow {
        loss: Some(f64::NAN),
        ..row
    };
    assert!(
        matches!(writer.write(&bad), Err(Error::Numerics { what, .. }) if what.contains("loss"))
    );
    assert_eq!(
        read_rows::<MetricsRow>(&path).unwrap(),
        [row],
        "nothing of a refused row is written"
    );
}

#[test]
fn appending_drops_what_lies_beyond_the_checkpoint() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("metrics.csv");
    let mut writer = MetricsWriter::open(&path, Some(0)).unwrap();
    rows().iter().for_each(|r| writer.write(r).unwrap());
    drop(writer);
    let mut whole = std::fs::read_to_string(&path).unwrap();
    whole.push_str("7500,12");
    std::fs::write(&path, whole).unwrap();
    assert_eq!(
        read_rows::<MetricsRow>(&path).unwrap(),
        rows(),
        "an unfinished line is not a row"
    );
    let mut writer = MetricsWriter::open(&path, Some(1000)).unwrap();
    writer.write(&row(1250)).unwrap();
    assert_eq!(
        read_rows::<MetricsRow>(&path).unwrap(),
        [row(0), row(500), row(1000), row(1250)]
    );
}

#[test]
fn tables_reject_what_is_not_theirs() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("t.csv");
    let header = DensityRow::COLUMNS;
    let good = "100,1.5,9,3,2,0,0,1,1,2,1,4,0.5,0,0,0,0,0";
    let put = |line: &str| {
        std::fs::write(&path, format!("{header}\n{good}\n{line}\n")).unwrap();
        read_rows::<DensityRow>(&path)
    };
    assert_eq!(put("").unwrap().len(), 1);
    for line in [
        "100",
        "x,1,9,3,2,0,0,1,1,2,1,4,0.5,0,0,0,0,0",
        "1,NaN,9,3,2,0,0,1,1,2,1,4,0.5,0,0,0,0,0",
        "1,2,-9,3,2,0,0,1,1,2,1,4,0.5,0,0,0,0,0",
        &format!("{good},7"),
    ] {
        let found = put(line);
        assert!(
            matches!(&found, Err(Error::Input { what, .. }) if what.contains("line 3")),
            "{found:?}"
        );
    }
    put("").unwrap();
    assert!(
        matches!(MetricsWriter::open(&path, Some(9)), Err(Error::Input { what, .. }) if what.contains("header"))
    );
    assert_eq!(
        read_rows::<DensityRow>(&path).unwrap().len(),
        1,
        "the other table is left alone"
    );
}

#[test]
fn density_csv_round_trips() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("density.csv");
    let mut writer = DensityWriter::open(&path, None).unwrap();
    density().iter().for_each(|r| writer.write(r).unwrap());
    assert_eq!(read_rows::<DensityRow>(&path).unwrap(), density());
}

/// Lines of both tables as version 0.1 wrote them: a resumed run must not mix two spellings.
#[test]
fn numbers_in_tables_keep_their_spelling() {
    let dir = tempfile::tempdir().unwrap();
    let last = |path: &Path| {
        let text = std::fs::read_to_string(path).unwrap();
        text.lines().last().unwrap().to_owned()
    };
    let path = dir.path().join("metrics.csv");
    let row = MetricsRow {
        iteration: u32::MAX,
        train_seconds: 1.0 / 3.0,
        wall_seconds: 1e16,
        cpu_seconds: 0.0,
        loss: Some(1e-7),
        psnr: Some(-27.0),
        ssim: None,
        gaussians: u64::MAX,
        non_finite: 9_007_199_254_740_993,
        ..MetricsRow::default()
    };
    MetricsWriter::open(&path, None)
        .unwrap()
        .write(&row)
        .unwrap();
    assert_eq!(
        last(&path),
        "4294967295,0.3333333333333333,10000000000000000,0,0.0000001,-27,,18446744073709551615,0,0,0,0,9007199254740993"
    );
    assert_eq!(read_rows::<MetricsRow>(&path).unwrap(), [row]);
    let path = dir.path().join("density.csv");
    let row = DensityRow {
        iteration: 100,
        train_seconds: 12.25,
        gaussians: 9,
        stats: DensityStats {
            proposed: 1,
            accepted: 2,
            relocated: 3,
            pruned: 4,
            coarse: [5, 6],
            fine: [7, 8],
            pixel: [9, 10],
            occupied_voxels: 11,
            mean_prior: 5e-324,
            cloned: 12,
            split: 13,
            opacity_resets: 14,
        },
    };
    DensityWriter::open(&path, None)
        .unwrap()
        .write(&row)
        .unwrap();
    let tiny = format!("0.{}5", "0".repeat(323));
    assert_eq!(
        last(&path),
        format!("100,12.25,9,1,2,3,4,5,6,7,8,11,{tiny},12,13,14,9,10")
    );
    assert_eq!(read_rows::<DensityRow>(&path).unwrap(), [row]);
}

#[test]
fn clock_leaves_evaluation_out() {
    let earlier = Reading {
        train_seconds: 10.0,
        wall_seconds: 20.0,
        cpu_seconds: 30.0,
        all_cpu_seconds: 40.0,
    };
    let mut clock = Clock::start().after(earlier);
    let pause = std::time::Duration::from_millis(80);
    clock.pause();
    std::thread::sleep(pause);
    clock.resume();
    let after = clock.reading();
    assert!(after.wall_seconds >= 20.08, "{after:?}");
    assert!(
        after.train_seconds >= 10.0 && after.train_seconds < after.wall_seconds - 10.079,
        "{after:?}"
    );
    std::thread::sleep(pause);
    assert!(clock.train_seconds() >= 10.08);
    clock.pause();
    let stopped = clock.train_seconds();
    clock.pause();
    std::thread::sleep(pause);
    assert_eq!(
        clock.train_seconds(),
        stopped,
        "a stopped clock stays stopped"
    );
}

#[test]
fn clocks_leave_out_the_time_in_which_a_run_waits() {
    let mut clock = Clock::start();
    clock.stop();
    let stopped = clock.reading();
    let begun = std::time::Instant::now();
    while begun.elapsed() < std::time::Duration::from_millis(80) {
        std::hint::spin_loop();
    }
    clock.stop();
    assert_eq!(clock.reading(), stopped);
    clock.resume();
    std::thread::sleep(std::time::Duration::from_millis(20));
    let after = clock.reading();
    assert!(after.wall_seconds >= stopped.wall_seconds + 0.02);
    assert!(after.wall_seconds < stopped.wall_seconds + begun.elapsed().as_secs_f64() - 0.079);
    assert!(after.train_seconds >= stopped.train_seconds + 0.02);
}

#[cfg(target_os = "linux")]
#[test]
fn cpu_seconds_count_threads_that_have_ended() {
    let clock = Clock::start();
    let spin = || {
        let start = std::time::Instant::now();
        while start.elapsed().as_millis() < 150 {
            std::hint::spin_loop();
        }
    };
    let before = clock.cpu_seconds();
    // The process shares its cores with other tests and processes, so as many threads as it takes.
    let counted = (0..100).any(|_| {
        std::thread::spawn(spin).join().unwrap();
        clock.cpu_seconds() - before >= 0.05
    });
    assert!(counted);
    assert!(mhsplat::base::process::peak_rss_bytes() > 1 << 20);
}

#[test]
fn proc_lines_parse_whatever_the_program_is_called() {
    use mhsplat::base::process::{parse_peak, parse_stat};
    let stat = "7 (a ) b (c) R 1 7 7 0 -1 4194304 100 0 0 0 250 50 9 9 20 0 1 0";
    assert_eq!(parse_stat(stat), Some(3.0));
    assert_eq!(parse_stat("7 (a) R 1 7"), None);
    assert_eq!(parse_stat(""), None);
    assert_eq!(
        parse_peak("VmPeak:\t9 kB\nVmHWM:\t    12 kB\n"),
        Some(12 * 1024)
    );
    assert_eq!(parse_peak("VmPeak:\t9 kB\n"), None);
}
