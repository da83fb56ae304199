//! Killed, stopped or robbed of its photos: a run goes on as if nothing had happened.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant, SystemTime};

use mhsplat::base::rng::Philox;
use mhsplat::capture::{LoadOptions, load};
use mhsplat::device::Device;
use mhsplat::run::{
    Clock, DensityRow, Extension, Progress, Run, RunRecord, checkpoint, read_rows, saved_config,
    saved_tuning,
};

/// Kills; more with MHSPLAT_KILLS.
const KILLS: u64 = 6;
const ITERATIONS: &str = "160";
/// Compilers of other drivers, and a device's first tuning, take their time.
const LONGEST_START: Duration = Duration::from_secs(1800);
/// From the first record on.
const LONGEST_RUN: Duration = Duration::from_secs(600);

fn room() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("data/room-tiny")
}

fn train(data: &Path, run: &Path, resume: bool) -> Command {
    long(data, run, resume, ITERATIONS)
}

fn long(data: &Path, run: &Path, resume: bool, iterations: &str) -> Command {
    let mut command = crate::cli::program();
    let target = if resume { "--resume" } else { "--output" };
    command.arg("train").arg(data).arg(target).arg(run);
    if !resume {
        // Deaths, births and relocations all within so short a run.
        let settings = run.with_extension("toml");
        fs::write(&settings, "[mh]\ndeaths-until-iteration = 15000\n").unwrap();
        command.arg("--config").arg(settings);
        command.args(["--iterations", iterations, "--max-size", "64"]);
        command.args(["--checkpoint-every", "20", "--eval-every", "50"]);
        // More often: a scene comes with a checkpoint.
        command.args(["--export-every", "10"]);
    }
    command.stdout(Stdio::null()).stderr(Stdio::null());
    command
}

/// How long a child was at work until it ended, `begun` telling from when on, or none where that was not `within` the time
/// given: then it is killed.
fn finished(mut child: Child, begun: impl Fn() -> bool, within: Duration) -> Option<Duration> {
    let spawned = Instant::now();
    let mut began = None;
    while began.is_none_or(|at: Instant| at.elapsed() < within) {
        if let Some(status) = child.try_wait().unwrap() {
            assert!(status.success(), "{status}");
            return Some(began.map_or(Duration::ZERO, |at| at.elapsed()));
        }
        if began.is_none() && begun() {
            began = Some(Instant::now());
        }
        let (since, most) = began.map_or((spawned, LONGEST_START), |at| (at, LONGEST_RUN));
        assert!(since.elapsed() < most, "it hangs");
        std::thread::sleep(Duration::from_millis(1));
    }
    // SIGKILL: nothing of the program runs any more.
    child.kill().unwrap();
    child.wait().unwrap();
    None
}

/// When a run's record was written last: a session writes one when it begins its work.
fn recorded(run: &Path) -> Option<SystemTime> {
    fs::metadata(run.join("run.json")).ok()?.modified().ok()
}

#[test]
fn killed_at_any_moment_it_ends_with_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let whole = dir.path().join("whole");
    // From the first record on: a driver may take longer to build kernels than the run takes.
    let child = train(&room(), &whole, false).spawn().unwrap();
    let lasts = finished(child, || recorded(&whole).is_some(), Duration::MAX).unwrap();
    let table = read_rows::<DensityRow>(whole.join("density.csv")).unwrap();
    let sum = |of: &dyn Fn(&mhsplat::density::DensityStats) -> u64| -> u64 {
        table.iter().map(|row| of(&row.stats)).sum()
    };
    assert!(sum(&|s| s.pruned) > 0 && sum(&|s| s.accepted) > 0);
    let kills = std::env::var("MHSPLAT_KILLS").map_or(KILLS, |n| n.parse().unwrap());
    let (mut at_work, mut again) = (0, 0);
    let mut runs = 0;
    while at_work < kills {
        let k = runs;
        runs += 1;
        assert!(runs < 20 * kills, "runs end before they are killed");
        let run = dir.path().join(format!("run-{k}"));
        let mut attempts = 0;
        loop {
            // Any moment from the first record of a session to after the last.
            let share = Philox::uniform(9, k, attempts)[0];
            let before = recorded(&run);
            let child = train(&room(), &run, before.is_some()).spawn().unwrap();
            attempts += 1;
            let within = if attempts > 2 { 1000.0 } else { 1.1 * share };
            let began = || recorded(&run) != before;
            if finished(child, began, lasts.mul_f64(within)).is_some() {
                break;
            }
            at_work += 1;
            again += u64::from(!checkpoint::path(&run).exists());
        }
        for file in ["scene.ply", "density.csv"] {
            let [a, b] = [&whole, &run].map(|r| fs::read(r.join(file)).unwrap());
            let columns = |bytes: &[u8]| without_seconds(bytes);
            let same = if file == "scene.ply" {
                a == b
            } else {
                columns(&a) == columns(&b)
            };
            assert!(same, "kill {k}: {file} differs");
        }
        let left = fs::read_dir(run.join("checkpoint")).unwrap().count();
        assert_eq!(left, 1, "half-written files are swept away");
    }
    println!(
        "{runs} runs, {at_work} kills, {again} of them before the first checkpoint: all ended alike"
    );
}

/// From its first evaluation on a run can be looked at, and gone on with, whatever becomes of it.
#[test]
fn a_run_that_is_going_on_has_a_scene_and_a_report() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    let mut command = crate::cli::program();
    command.arg("train").arg(room()).arg("-o").arg(&run);
    command.args(["--iterations", "100000", "--max-size", "64"]);
    command.args(["--checkpoint-every", "0", "--eval-every", "10"]);
    command.stdout(Stdio::null()).stderr(Stdio::null());
    let mut child = command.spawn().unwrap();
    let began = Instant::now();
    while !run.join("report.html").exists() {
        assert!(began.elapsed() < LONGEST_START, "no report");
        assert!(child.try_wait().unwrap().is_none(), "ended too early");
        std::thread::sleep(Duration::from_millis(20));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    for file in ["scene.ply", "scene.html"] {
        assert!(run.join(file).is_file(), "{file}");
    }
    let eval = crate::cli::program()
        .arg("eval")
        .arg(&run)
        .output()
        .unwrap();
    assert!(eval.status.success(), "{eval:?}");
    let rows = || fs::read_to_string(run.join("metrics.csv")).map_or(0, |t| t.lines().count());
    let (before, began) = (rows(), Instant::now());
    let mut resumed = train(&room(), &run, true).spawn().unwrap();
    while rows() < before + 3 {
        assert!(began.elapsed() < LONGEST_START, "it does not go on");
        assert!(resumed.try_wait().unwrap().is_none(), "ended too early");
        std::thread::sleep(Duration::from_millis(20));
    }
    resumed.kill().unwrap();
    resumed.wait().unwrap();
}

/// Two begin a run in one place at once: one trains, the other is refused.
#[test]
fn two_cannot_begin_one_run() {
    let dir = tempfile::tempdir().unwrap();
    for attempt in 0..3 {
        let run = dir.path().join(format!("run-{attempt}"));
        let begin = || long(&room(), &run, false, "20").spawn().unwrap();
        let both = [begin(), begin()].map(|mut child| child.wait().unwrap().code());
        assert!(
            both.contains(&Some(0)) && both.contains(&Some(2)),
            "{both:?}"
        );
        assert!(run.join("scene.ply").is_file());
    }
}

/// A requeued job must go on: resumed where there is a folder, begun anew where there is none.
#[test]
fn killed_before_its_first_record_it_leaves_no_folder() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    let mut begun = 0;
    for kill in 0..400 {
        // On a busy machine a run takes longer to begin.
        if kill >= 40 && begun > 0 {
            break;
        }
        let mut child = train(&room(), &run, false).spawn().unwrap();
        std::thread::sleep(Duration::from_millis(25 * kill));
        child.kill().unwrap();
        child.wait().unwrap();
        if run.exists() {
            begun += 1;
            let mut resumed = train(&room(), &run, true).spawn().unwrap();
            assert!(recorded(&run).is_some(), "{kill}: an empty folder");
            if begun == 1 {
                assert!(resumed.wait().unwrap().success());
            } else {
                resumed.kill().unwrap();
                resumed.wait().unwrap();
            }
            fs::remove_dir_all(&run).unwrap();
        }
    }
    assert!(begun > 0, "none had begun when it was killed");
    let whole = train(&room(), &run, false).status().unwrap();
    assert!(whole.success() && run.join("scene.ply").exists());
}

/// The checkpoint of an iteration comes before its density step, whose row is in the table already where a run is killed later.
#[test]
fn a_density_step_after_the_checkpoint_has_one_row() {
    resumed_with_one_row_a_step(0, 0, 1);
}

/// The checkpoint comes while a step is decided, the row once it has ended.
#[test]
fn a_density_step_under_way_at_the_checkpoint_has_one_row() {
    resumed_with_one_row_a_step(6, 3, 8);
}

/// Steps end `lag` iterations after they begin; the checkpoint is `saved` iterations after a step, the kill `lost`.
fn resumed_with_one_row_a_step(lag: u32, saved: u32, lost: u32) {
    let dir = tempfile::tempdir().unwrap();
    let [whole, run] = ["whole", "run"].map(|name| dir.path().join(name));
    assert!(train(&room(), &whole, false).status().unwrap().success());
    let rows = |run: &Path| read_rows::<DensityRow>(run.join("density.csv")).unwrap();
    let told = rows(&whole);
    let step = told[told.len() / 2].iteration;
    let mut config = saved_config(&whole).unwrap();
    config.checkpoint_every = step + saved;
    config.work.density_lag = Some(lag);
    fs::create_dir(&run).unwrap();
    let device = Device::open(None).unwrap();
    let options = LoadOptions {
        max_size: config.max_size,
        ..LoadOptions::default()
    };
    let data = load(&room(), &options).unwrap();
    let killed = dir.path().join("killed");
    let mut begun = Run::start(&run, data, config, &device, Clock::start()).unwrap();
    let copied = |p: &Progress| {
        if p.iteration == step + lost {
            copy(&run, &killed);
        }
    };
    begun.drive(&AtomicBool::new(false), copied).unwrap();
    let state = checkpoint::read(&killed).unwrap().state;
    assert_eq!(state.iteration, step + saved);
    assert_eq!(state.deciding.is_some(), lag > 0);
    // Without a checkpoint a run begins again, and not as another device had begun it.
    assert_eq!(saved_tuning(&killed).unwrap(), Some(device.tuning()));
    let bare = dir.path().join("bare");
    fs::create_dir(&bare).unwrap();
    fs::copy(killed.join("run.json"), bare.join("run.json")).unwrap();
    assert_eq!(saved_tuning(&bare).unwrap(), None);
    assert_eq!(rows(&killed).last().unwrap().iteration, step);
    assert!(train(&room(), &killed, true).status().unwrap().success());
    let steps = |rows: &[DensityRow]| -> Vec<u32> { rows.iter().map(|r| r.iteration).collect() };
    assert_eq!(steps(&rows(&killed)), steps(&told));
}

/// A table without its clocks.
fn without_seconds(bytes: &[u8]) -> Vec<String> {
    let text = String::from_utf8_lossy(bytes);
    let cells = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        [&cells[..1], &cells[2..]].concat().join(",")
    };
    text.lines().map(cells).collect()
}

#[test]
fn a_damaged_checkpoint_is_refused_by_its_checksum() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    assert!(train(&room(), &run, false).status().unwrap().success());
    let file = checkpoint::path(&run);
    let good = fs::read(&file).unwrap();
    checkpoint::read(&run).unwrap();
    // The last byte is a tensor's, one in the header the configuration's.
    let header = good.windows(10).position(|w| w == b"iterations").unwrap();
    for (at, what) in [(good.len() - 1, "a tensor"), (header + 1, "the header")] {
        let mut bad = good.clone();
        bad[at] ^= 1;
        fs::write(&file, &bad).unwrap();
        let said = checkpoint::read(&run).unwrap_err().to_string();
        assert!(said.contains("damaged checkpoint"), "{what}: {said}");
        let status = train(&room(), &run, true).status().unwrap();
        assert_eq!(status.code(), Some(2), "{what}");
    }
    // The configuration is read without the tensors.
    fs::write(&file, &good[..good.len() / 2]).unwrap();
    assert!(checkpoint::read(&run).is_err());
    checkpoint::read_config(&run).unwrap();
    fs::write(&file, &good[..header]).unwrap();
    assert!(checkpoint::read_config(&run).is_err());
}

/// A budget that was asked for on the way is that of the run from then on, be it that the run is killed at once.
#[test]
fn a_budget_that_is_given_on_the_way_is_kept() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    assert!(long(&room(), &run, false, "40").status().unwrap().success());
    let options = LoadOptions {
        max_size: 64,
        ..LoadOptions::default()
    };
    let data = load(&room(), &options).unwrap();
    let device = Device::open(None).unwrap();
    // As if it had been stopped.
    let mut saved = checkpoint::read(&run).unwrap();
    saved.config.iterations = 4000;
    saved.config.time_budget = Some(100.0);
    checkpoint::write(&run, &saved).unwrap();
    let config = saved_config(&run).unwrap();
    let longer = Some(Extension::Seconds(3600.0));
    let begun = Run::resume(&run, data, config, &device, Clock::start(), longer);
    drop(begun.unwrap());
    let kept = saved_config(&run).unwrap().time_budget.unwrap();
    assert!(kept >= 3600.0, "{kept}");
}

/// Iterations that were asked for are not forgotten, nor the largest memory of an earlier session.
#[test]
fn an_extension_that_is_killed_at_once_goes_on() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    assert!(long(&room(), &run, false, "40").status().unwrap().success());
    let mut record = RunRecord::read(&run).unwrap();
    record.peak_rss_bytes = 1 << 40;
    record.write(&run).unwrap();
    let options = LoadOptions {
        max_size: 64,
        ..LoadOptions::default()
    };
    let data = load(&room(), &options).unwrap();
    let (config, device) = (saved_config(&run).unwrap(), Device::open(None).unwrap());
    let longer = Some(Extension::Iterations(90));
    let begun = Run::resume(&run, data, config, &device, Clock::start(), longer);
    drop(begun.unwrap());
    assert!(train(&room(), &run, true).status().unwrap().success());
    let record = RunRecord::read(&run).unwrap();
    assert_eq!((record.iterations, record.peak_rss_bytes), (90, 1 << 40));
}

#[test]
fn a_photo_that_vanishes_leaves_the_last_good_state() {
    let dir = tempfile::tempdir().unwrap();
    let (data, run) = (dir.path().join("data"), dir.path().join("run"));
    copy(&room(), &data);
    let gone = dir.path().join("gone");
    let mut command = long(&data, &run, false, "1500");
    // So little room for photos that they are read again and again.
    let child = command.args(["--image-budget", "60k"]);
    let child = child.stderr(Stdio::piped()).spawn().unwrap();
    let began = Instant::now();
    while !checkpoint::path(&run).exists() {
        assert!(began.elapsed() < Duration::from_secs(120), "no checkpoint");
        std::thread::sleep(Duration::from_millis(5));
    }
    fs::rename(data.join("images"), &gone).unwrap();
    let ended = child.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&ended.stderr);
    assert_eq!(ended.status.code(), Some(2), "{said}");
    assert!(
        said.contains("images") && said.contains("is saved"),
        "{said}"
    );
    let saved = checkpoint::read(&run).unwrap().state.iteration;
    fs::rename(&gone, data.join("images")).unwrap();
    assert!(train(&data, &run, true).status().unwrap().success());
    assert!(saved < 1500 && checkpoint::read(&run).unwrap().state.iteration == 1500);
    // As if nothing had happened.
    let whole = dir.path().join("whole");
    let mut straight = long(&data, &whole, false, "1500");
    assert!(
        straight
            .args(["--image-budget", "60k"])
            .status()
            .unwrap()
            .success()
    );
    let [a, b] = [&whole, &run].map(|r| fs::read(r.join("scene.ply")).unwrap());
    assert!(a == b);
}

#[test]
fn a_finished_run_without_its_checkpoint_is_not_begun_again() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    assert!(train(&room(), &run, false).status().unwrap().success());
    fs::remove_dir_all(run.join("checkpoint")).unwrap();
    let before: Vec<Vec<u8>> = ["run.json", "metrics.csv", "scene.ply"]
        .map(|f| fs::read(run.join(f)).unwrap())
        .to_vec();
    assert_eq!(train(&room(), &run, true).status().unwrap().code(), Some(2));
    let after: Vec<Vec<u8>> = ["run.json", "metrics.csv", "scene.ply"]
        .map(|f| fs::read(run.join(f)).unwrap())
        .to_vec();
    assert!(before == after, "nothing is overwritten");
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        if entry.file_type().unwrap().is_dir() {
            copy(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}
