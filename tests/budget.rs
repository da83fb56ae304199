//! Runs within a time budget: whole schedules, decided on the way and repeated to the bit.

use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use mhsplat::base::error::Error;
use mhsplat::capture::{LoadOptions, load};
use mhsplat::config::{Length, Sampler, TrainConfig, TrainingSize};
use mhsplat::device::Device;
use mhsplat::run::{Clock, Run, RunRecord, checkpoint};
use mhsplat::train::schedule::Schedule;

use crate::cli::program;

fn train(args: &[&str], run: &Path) -> RunRecord {
    let room = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/room-tiny");
    let mut command = program();
    command.arg("train").arg(room).args(["--max-size", "64"]);
    let done = command.args(args).arg("-o").arg(run).output().unwrap();
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success(), "{said}");
    RunRecord::read(run).unwrap()
}

#[test]
fn a_time_budget_gives_a_whole_run_that_its_record_repeats() {
    let dir = tempfile::tempdir().unwrap();
    let run = |name: &str| dir.path().join(name);
    let whole = |name: String| {
        let record = train(&["--time-budget", "5s"], &run(&name));
        let planned = record.config.last_iterations();
        assert!(record.iterations <= planned && planned < 30_000);
        assert!(!record.config.lengths.is_empty());
        // Other programs may have taken the time that was left for the last iterations.
        (record.iterations == planned).then_some((record, run(&name)))
    };
    let (first, place) = (0..5).find_map(|k| whole(format!("run-{k}"))).unwrap();
    let settings = place.join("run.json");
    let again = train(&["--config", settings.to_str().unwrap()], &run("again"));
    assert_eq!(again.config.lengths, first.config.lengths);
    assert_eq!(again.config.time_budget, None);
    let [a, b] = [&place, &run("again")].map(|r| fs::read(r.join("scene.ply")).unwrap());
    assert!(a == b, "other bytes");
    // Both are valid, and at their end.
    for run in [&place, &run("again")] {
        let room = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/room-tiny");
        let mut resumed = program();
        let resumed = resumed.arg("train").arg(&room).arg("--resume").arg(run);
        assert!(resumed.output().unwrap().status.success());
        assert_eq!(RunRecord::read(run).unwrap().iterations, first.iterations);
        let longer = resumed.args(["--time-budget", "60s"]).output().unwrap();
        assert_eq!(longer.status.code(), Some(2));
        let said = String::from_utf8_lossy(&longer.stderr);
        assert!(said.contains("--extend"), "{said}");
    }
    // A flag that says how long the run is wins over the lengths of a file.
    let args = ["--config", settings.to_str().unwrap(), "--iterations", "40"];
    let short = train(&args, &run("short"));
    assert!(short.iterations <= 40 && short.config.last_iterations() <= 40);
}

/// A job that is queued again after its run has ended ends well, however little of its budget is left.
#[test]
fn a_run_whose_budget_is_used_up_is_brought_to_its_end() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    let record = train(&["--time-budget", "3s"], &run);
    let mut saved = checkpoint::read(&run).unwrap();
    saved.clock.wall_seconds = 4.0;
    checkpoint::write(&run, &saved).unwrap();
    let resume = |more: &[&str]| {
        let room = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/room-tiny");
        let mut command = program();
        command.arg("train").arg(&room).arg("--resume").arg(&run);
        command.args(more).output().unwrap()
    };
    let again = resume(&[]);
    let said = String::from_utf8_lossy(&again.stderr);
    assert!(again.status.success(), "{said}");
    assert_eq!(RunRecord::read(&run).unwrap().iterations, record.iterations);
    for wrong in [["--time-budget", "2s"], ["--budget-cpu", "1s"]] {
        assert_eq!(resume(&wrong).status.code(), Some(2), "{wrong:?}");
    }
}

#[test]
fn a_finished_run_goes_on_and_its_record_repeats_that_too() {
    let dir = tempfile::tempdir().unwrap();
    let run = |name: &str| dir.path().join(name);
    let room = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/room-tiny");
    let before = std::cell::Cell::new(0.0);
    let longer = |name: String| {
        let run = run(&name);
        let short = train(&["--iterations", "60"], &run);
        assert_eq!(short.iterations, 60);
        before.set(short.wall_seconds);
        let mut command = program();
        command.arg("train").arg(&room).arg("--resume").arg(&run);
        let done = command.args(["--extend", "4s"]).output().unwrap();
        let said = String::from_utf8_lossy(&done.stderr);
        assert!(done.status.success(), "{said}");
        let record = RunRecord::read(&run).unwrap();
        // Other programs may have taken the time that was left for the last iterations.
        (record.iterations == record.config.last_iterations()).then_some((record, run))
    };
    let (whole, place) = (0..5).find_map(|k| longer(format!("run-{k}"))).unwrap();
    // The time is used: a plan that ends after its first measurement takes half a second of the four.
    let taken = whole.wall_seconds - before.get();
    assert!(taken > 2.5, "{} iterations in {taken} s", whole.iterations);
    assert!(whole.config.extended() && !whole.out_of_time);
    let settings = place.join("run.json");
    let again = train(&["--config", settings.to_str().unwrap()], &run("again"));
    assert_eq!(again.config.lengths, whole.config.lengths);
    let [a, b] = [place, run("again")].map(|r| fs::read(r.join("scene.ply")).unwrap());
    assert!(a == b, "other bytes");
}

/// Stopped between two density steps, it has the other length from there on; so has what repeats it.
#[test]
fn a_stopped_run_goes_on_to_more_iterations() {
    let dir = tempfile::tempdir().unwrap();
    let run = |name: &str| dir.path().join(name);
    let room = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/room-tiny");
    let config = TrainConfig {
        iterations: 400,
        max_size: 64,
        ..TrainConfig::default()
    };
    let options = LoadOptions {
        max_size: 64,
        ..LoadOptions::default()
    };
    let (data, device) = (load(&room, &options).unwrap(), Device::open(None).unwrap());
    let stop = AtomicBool::new(false);
    let mut begun = Run::start(&run("first"), data, config, &device, Clock::start()).unwrap();
    let stopped = begun.drive(&stop, |p| stop.store(p.iteration >= 149, Ordering::Relaxed));
    assert!(matches!(stopped, Err(Error::Interrupted)));
    drop(begun);
    let saved = checkpoint::read(&run("first")).unwrap();
    let done = saved.state.iteration;
    assert!(!Schedule::new(&saved.config).may_change(done), "{done}");
    let mut resumed = program();
    resumed.arg("train").arg("--resume").arg(run("first"));
    let resumed = resumed.args(["--iterations", "600"]).output().unwrap();
    assert!(resumed.status.success());
    let first = RunRecord::read(run("first")).unwrap();
    assert_eq!(first.config.lengths, [Length::new(done, 600)]);
    let settings = run("first").join("run.json");
    let again = train(&["--config", settings.to_str().unwrap()], &run("again"));
    assert_eq!(again.config.lengths, first.config.lengths);
    let [a, b] = ["first", "again"].map(|r| fs::read(run(r).join("scene.ply")).unwrap());
    assert!(a == b, "other bytes");
}

/// To so many iterations altogether: what a fixed length, an extension and their repetition have in common is the bytes.
#[test]
fn a_finished_run_goes_on_to_more_iterations() {
    let dir = tempfile::tempdir().unwrap();
    let run = |name: &str| dir.path().join(name);
    let resume = |name: &str, iterations: &str| {
        let mut command = program();
        command.arg("train").arg("--resume").arg(run(name));
        command.args(["--iterations", iterations]).output().unwrap()
    };
    train(&["--iterations", "60"], &run("first"));
    let refused = resume("first", "60");
    let said = String::from_utf8_lossy(&refused.stderr);
    assert_eq!(refused.status.code(), Some(2));
    assert!(
        said.contains("--iterations") && said.contains("had 60"),
        "{said}"
    );
    assert!(resume("first", "150").status.success());
    let record = RunRecord::read(run("first")).unwrap();
    assert_eq!((record.iterations, record.config.iterations), (150, 60));
    let length = Length::new(60, 150);
    assert_eq!(record.config.lengths, [length]);
    let settings = run("first").join("run.json");
    train(&["--config", settings.to_str().unwrap()], &run("again"));
    // A budget that is used up does not stand in the way.
    train(&["--time-budget", "2s"], &run("budget"));
    let had = RunRecord::read(run("budget")).unwrap().iterations;
    assert!(resume("budget", &(had + 40).to_string()).status.success());
    let record = RunRecord::read(run("budget")).unwrap();
    assert_eq!(record.iterations, had + 40);
    assert_eq!(record.config.time_budget, None);
    let [a, b] = ["first", "again"].map(|r| fs::read(run(r).join("scene.ply")).unwrap());
    assert!(a == b, "other bytes");
}

/// A budget with room for few iterations: the photos are smaller, which is recorded, said and repeated; an extension without a budget
/// brings the size that was asked for.
#[test]
fn a_budget_with_room_for_few_iterations_trains_on_smaller_photos() {
    let dir = tempfile::tempdir().unwrap();
    let run = |name: &str| dir.path().join(name);
    let few = dir.path().join("few.toml");
    fs::write(&few, "[work]\nresolution-iterations = 1000000\n").unwrap();
    let room = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/room-tiny");
    let whole = |name: String| {
        let mut command = program();
        command.arg("train").arg(&room).args(["--max-size", "192"]);
        command.args(["--budget-cpu", "4s", "--progress", "log"]);
        let done = command.arg("--config").arg(&few).arg("-o").arg(run(&name));
        let done = done.output().unwrap();
        let said = String::from_utf8_lossy(&done.stderr);
        assert!(done.status.success(), "{said}");
        assert!(said.contains("9/16 of the photos' size"), "{said}");
        assert!(said.contains("MB of memory"), "{said}");
        let record = RunRecord::read(run(&name)).unwrap();
        // Other programs may have taken the time that was left for the last iterations.
        (record.iterations == record.config.last_iterations()).then_some((record, run(&name)))
    };
    let found = (0..5).find_map(|k| whole(format!("small-{k}")));
    let (record, place) = found.unwrap();
    let sizes = record.config.lengths.iter().map(|l| l.size);
    assert!(
        sizes
            .into_iter()
            .all(|size| size == TrainingSize::NineSixteenths)
    );
    let mut left_out = record.plan.left_out.iter();
    assert!(left_out.any(|item| item.why.contains("trained at 9/16")));
    let of_config = |name: &str, from: &Path| {
        let mut command = program();
        command.arg("train").arg(&room).arg("--config").arg(from);
        let done = command.arg("-o").arg(run(name)).output().unwrap();
        let said = String::from_utf8_lossy(&done.stderr);
        assert!(done.status.success(), "{said}");
        RunRecord::read(run(name)).unwrap()
    };
    let settings = place.join("run.json");
    let again = of_config("again", &settings);
    assert_eq!(again.config.lengths, record.config.lengths);
    let scene = |place: &Path| fs::read(place.join("scene.ply")).unwrap();
    assert!(scene(&place) == scene(&run("again")), "other bytes");
    // The same lengths at full size give another scene.
    let text = fs::read_to_string(&settings).unwrap();
    let whole = dir.path().join("whole.json");
    fs::write(&whole, text.replace("\"9/16\"", "\"full\"")).unwrap();
    of_config("whole", &whole);
    assert!(
        scene(&run("again")) != scene(&run("whole")),
        "the same bytes"
    );
    let more = (again.iterations + 30).to_string();
    let mut longer = program();
    longer.arg("train").arg("--resume").arg(run("again"));
    assert!(
        longer
            .args(["--iterations", &more])
            .status()
            .unwrap()
            .success()
    );
    let longer = RunRecord::read(run("again")).unwrap();
    assert_eq!(longer.config.last_size(), TrainingSize::Full);
    assert_eq!(longer.iterations, again.iterations + 30);
}

/// CPU seconds of the process end the run, whatever a clock on the wall says.
#[test]
fn a_budget_of_cpu_seconds_gives_a_whole_run() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    let record = train(&["--budget-cpu", "8s"], &run);
    assert!(!record.config.lengths.is_empty());
    let used = checkpoint::read(&run).unwrap().clock.all_cpu_seconds;
    assert!((4.0..9.0).contains(&used), "{used}");
    // Another kind of budget takes the place of the run's; the run has come to its end all the same.
    let room = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/room-tiny");
    let mut other = program();
    other.arg("train").arg(&room).arg("--resume").arg(&run);
    let other = other.args(["--time-budget", "1h"]).output().unwrap();
    let said = String::from_utf8_lossy(&other.stderr);
    assert!(
        said.contains("--extend") && !said.contains("one of them"),
        "{said}"
    );
}

/// Lengths that go up and down.
fn changing(sampler: Sampler) -> Schedule {
    let lengths = [(20, 900), (60, 1100), (137, 870), (400, 1000), (640, 700)];
    let lengths = lengths.map(|(from, iterations)| Length::new(from, iterations));
    Schedule::new(&TrainConfig {
        sampler,
        lengths: lengths.to_vec(),
        ..TrainConfig::default()
    })
}

#[test]
fn density_steps_keep_their_distance_where_the_length_changes() {
    for sampler in [Sampler::Mh, Sampler::Mcmc, Sampler::Adc] {
        let schedule = changing(sampler);
        let steps: Vec<(u32, f64)> = (1..700)
            .filter_map(|at| schedule.density_due(at).map(|progress| (at, progress)))
            .collect();
        assert!(steps.len() >= 10, "{sampler:?}: {steps:?}");
        for pair in steps.windows(2) {
            let [(before, from), (at, progress)] = [pair[0], pair[1]];
            let apart = at - before;
            assert!((12..=100).contains(&apart), "{sampler:?}: {before}, {at}");
            assert_eq!(schedule.density_before(at), Some(from));
            assert!(progress > from - 0.15, "{sampler:?}: {from} to {progress}");
        }
    }
}

/// A run that was stopped right after its length was set has another from the same iteration on when it goes on.
#[test]
fn a_length_takes_the_place_of_one_from_the_same_iteration() {
    let mut config = TrainConfig::default();
    for (from, iterations) in [(20, 900), (60, 1100), (60, 700)] {
        config.set_length(Length::new(from, iterations));
    }
    config.validate().unwrap();
    assert_eq!(
        [59, 60, 61].map(|at| config.iterations_at(at)),
        [900, 700, 700]
    );
    for wrong in [[(60, 700), (20, 900)], [(20, 900), (60, 60)]] {
        config.lengths = wrong
            .map(|(from, iterations)| Length::new(from, iterations))
            .to_vec();
        assert!(config.validate().is_err(), "{wrong:?}");
    }
}

#[test]
fn schedules_go_by_the_length_of_their_iteration() {
    let schedule = changing(Sampler::Mh);
    let fixed = |iterations: u32| {
        Schedule::new(&TrainConfig {
            iterations,
            ..TrainConfig::default()
        })
    };
    for (at, iterations) in [(10, 30_000), (20, 900), (136, 1100), (137, 870), (699, 700)] {
        let of = fixed(iterations);
        assert_eq!(schedule.rates(at), of.rates(at), "{at}");
        assert_eq!(schedule.iterations(at), iterations);
        assert_eq!(schedule.eval_every(at), of.eval_every(at));
        assert_eq!(schedule.exposure_from(at), of.exposure_from(at));
    }
}

/// Records of before there were sizes have photos of full size; a size that nobody knows is refused.
#[test]
fn lengths_without_a_size_are_of_full_size() {
    let read = |text: &str| serde_json::from_str::<Length>(text);
    let length = read(r#"{"from": 20, "iterations": 900}"#).unwrap();
    assert_eq!(length, Length::new(20, 900));
    let text = serde_json::to_string(&length).unwrap();
    assert_eq!(text, r#"{"from":20,"iterations":900}"#);
    let small = read(r#"{"from": 20, "iterations": 900, "size": "3/4"}"#).unwrap();
    assert_eq!(small.size, TrainingSize::ThreeQuarters);
    assert!(serde_json::to_string(&small).unwrap().contains("3/4"));
    for wrong in ["0.75", "\"1/2\"", "\"4/3\""] {
        let text = format!("{{\"from\": 1, \"iterations\": 9, \"size\": {wrong}}}");
        assert!(read(&text).is_err(), "{wrong}");
    }
}

/// A file that has lengths and no number of iterations is not taken for one that leaves the length open.
#[test]
fn lengths_alone_say_how_long_a_run_is() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("lengths.toml");
    let config = file.to_str().unwrap();
    fs::write(&file, "lengths = [{ from = 20, iterations = 60 }]\n").unwrap();
    let record = train(&["--config", config], &dir.path().join("run"));
    assert_eq!(record.iterations, 60);
    fs::write(&file, "lengths = [{ from = 20, iterations = 10 }]\n").unwrap();
    let mut refused = program();
    refused.arg("train").arg("data/room-tiny");
    refused
        .args(["--config", config, "-o"])
        .arg(dir.path().join("none"));
    let refused = refused.output().unwrap();
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(
        refused.status.code() == Some(2) && said.contains("lengths"),
        "{said}"
    );
}
