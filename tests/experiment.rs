//! Experiments: order, budget, resuming, caps, what the file may say.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use crate::compare::made::{Made, run as made};
use mhsplat::base::error::{Error, Result};
use mhsplat::config::TrainConfig;
use mhsplat::lab::experiment::*;

mod cli;
mod shards;
mod stale;
mod summary;

const TWO: &str = "seeds = [0, 1]\ncap-from = \"mh\"\n[train]\niterations = 1000\n\
    [[setting]]\nname = \"none\"\nsampler = \"none\"\n[[setting]]\nname = \"mh\"\n\
    [[scene]]\npath = \"a\"\n[[scene]]\npath = \"b\"\nmax-size = 240\n";

/// An experiment in a folder of its own, with empty folders for scenes.
fn experiment(dir: &Path, file: &str) -> Result<Experiment> {
    for scene in ["a", "b"] {
        fs::create_dir_all(dir.join(scene)).unwrap();
    }
    let path = dir.join("file.toml");
    fs::write(&path, file).unwrap();
    let mut e = Experiment::read(&path, None)?;
    e.output = dir.join("out");
    Ok(e)
}

/// Trains nothing, in 10 seconds of its own clock, and leaves what a run leaves.
#[derive(Default)]
struct Fake {
    jobs: Vec<String>,
    resumed: Vec<String>,
    seconds: f64,
    fail: Option<&'static str>,
    stop_at: Option<usize>,
    /// What becomes of a run of this name.
    change: Option<fn(&str, Made) -> Made>,
}

impl Launch for Fake {
    fn train(&mut self, job: &Job) -> Result<()> {
        let parts: Vec<_> = job.dir.components().rev().take(3).collect();
        let name = parts.iter().rev().map(|c| c.as_os_str().to_str().unwrap());
        let name = name.collect::<Vec<_>>().join("/");
        self.jobs.push(name.clone());
        if job.resume {
            self.resumed.push(name.clone());
        }
        self.seconds += 10.0;
        if self.fail.is_some_and(|f| name.contains(f)) {
            return Err(Error::config("fake", "told to fail"));
        }
        let config: TrainConfig =
            serde_json::from_str(&fs::read_to_string(&job.config).unwrap()).unwrap();
        let stopped = self.stop_at == Some(self.jobs.len());
        let count = config.max_gaussians.unwrap_or(1200 + config.seed as usize);
        let run = made("r", config.seed).with(|r| {
            r.config = config.clone();
            r.gaussians = count as u64;
            r.iterations = if stopped { 300 } else { 1000 };
        });
        let run = run.rows(if stopped { 6 } else { 20 });
        let run = match self.change {
            Some(change) => change(&name, run),
            None => run,
        };
        let folder = run.write(job.dir.parent().unwrap());
        if folder != job.dir {
            let _ = fs::remove_dir_all(&job.dir);
            fs::rename(&folder, &job.dir).unwrap();
        }
        if stopped {
            fs::create_dir(job.dir.join("checkpoint")).unwrap();
            fs::write(job.dir.join("checkpoint/state.safetensors"), "").unwrap();
            return Err(Error::Interrupted);
        }
        fs::write(job.dir.join("scene.ply"), "").unwrap();
        Ok(())
    }

    fn seconds(&self) -> f64 {
        self.seconds
    }
}

fn drive(e: &Experiment, fake: &mut Fake) -> Result<Outcome> {
    run(e, fake, &AtomicBool::new(false), &mut |_| {})
}

const ORDER: [&str; 8] = [
    "a/mh/seed-0",
    "a/none/seed-0",
    "b/mh/seed-0",
    "b/none/seed-0",
    "a/mh/seed-1",
    "a/none/seed-1",
    "b/mh/seed-1",
    "b/none/seed-1",
];

fn record(e: &Experiment, run: &str) -> mhsplat::RunRecord {
    mhsplat::RunRecord::read(e.output.join(run)).unwrap()
}

#[test]
fn runs_come_seed_by_seed_and_scene_by_scene_with_the_caps_run_first() {
    let dir = tempfile::tempdir().unwrap();
    let e = experiment(dir.path(), TWO).unwrap();
    let mut fake = Fake::default();
    let outcome = drive(&e, &mut fake).unwrap();
    assert_eq!(fake.jobs, ORDER);
    assert_eq!((outcome.done, outcome.left), (8, 0));
    assert_eq!(record(&e, "a/mh/seed-1").config.max_gaussians, None);
    assert_eq!(record(&e, "a/none/seed-1").config.max_gaussians, Some(1201));
    assert_eq!(record(&e, "b/none/seed-0").config.max_size, 240);
    let names = fs::read_dir(e.output.join("a/mh")).unwrap();
    let names = names.map(|n| n.unwrap().file_name().into_string().unwrap());
    let runs: Vec<_> = names.filter(|n| n.starts_with("seed-")).collect();
    assert_eq!(runs.len(), 2, "seed-* are runs: {runs:?}");
    // Once more: everything is there.
    let mut again = Fake::default();
    assert_eq!(drive(&e, &mut again).unwrap().done, 8);
    assert!(again.jobs.is_empty());
    let summary = fs::read_to_string(e.output.join("summary.md")).unwrap();
    assert!(
        summary.contains("## a") && summary.contains("| none | 2 | 1200 |"),
        "{summary}"
    );
    assert!(summary.contains("## none against mh"), "{summary}");
    for file in [
        "summary.html",
        "summary.json",
        "a/compare.html",
        "b/compare.html",
    ] {
        assert!(e.output.join(file).is_file(), "{file}");
    }
}

#[test]
fn a_stopped_experiment_goes_on_from_the_checkpoint() {
    let dir = tempfile::tempdir().unwrap();
    let e = experiment(dir.path(), TWO).unwrap();
    let mut fake = Fake {
        stop_at: Some(4),
        ..Fake::default()
    };
    assert!(matches!(drive(&e, &mut fake), Err(Error::Interrupted)));
    assert_eq!(fake.jobs, ORDER[..4]);
    assert!(
        e.output.join("a/compare.html").is_file(),
        "what there is was compared"
    );
    let mut rest = Fake::default();
    assert_eq!(drive(&e, &mut rest).unwrap().done, 8);
    assert_eq!(rest.jobs, ORDER[3..]);
    assert_eq!(rest.resumed, ["b/none/seed-0"]);
    let stop = AtomicBool::new(true);
    let other = tempfile::tempdir().unwrap();
    let e = experiment(other.path(), TWO).unwrap();
    let mut none = Fake::default();
    assert!(matches!(
        run(&e, &mut none, &stop, &mut |_| {}),
        Err(Error::Interrupted)
    ));
    assert!(none.jobs.is_empty() && stop.load(Ordering::Relaxed));
}

#[test]
fn a_run_killed_before_its_first_checkpoint_starts_again() {
    let dir = tempfile::tempdir().unwrap();
    let e = experiment(dir.path(), TWO).unwrap();
    drive(&e, &mut Fake::default()).unwrap();
    let cut = e.output.join("a/mh/seed-0");
    let mut begun = record(&e, "a/mh/seed-0");
    begun.iterations = 300;
    begun.write(&cut).unwrap();
    fs::remove_file(cut.join("scene.ply")).unwrap();
    assert_eq!(state(&cut, None), State::Broken);
    let mut fake = Fake::default();
    drive(&e, &mut fake).unwrap();
    assert_eq!(fake.jobs, ["a/mh/seed-0"]);
    assert!(fake.resumed.is_empty());
    // Files of somebody else are left alone.
    begun.write(&cut).unwrap();
    fs::remove_file(cut.join("scene.ply")).unwrap();
    fs::write(cut.join("notes.txt"), "mine").unwrap();
    let outcome = drive(&e, &mut Fake::default()).unwrap();
    assert!(outcome.failed[0].1.contains("move it away"), "{outcome:?}");
    assert_eq!(fs::read_to_string(cut.join("notes.txt")).unwrap(), "mine");
}

#[test]
fn a_budget_ends_between_scenes_with_the_seeds_before_whole() {
    let dir = tempfile::tempdir().unwrap();
    let e = experiment(dir.path(), &format!("budget = \"45s\"\n{TWO}")).unwrap();
    let mut fake = Fake::default();
    let outcome = drive(&e, &mut fake).unwrap();
    // Two runs of 10 s a scene: a third one would end after 60 s. Both scenes have their first seed.
    assert_eq!(fake.jobs, ORDER[..4]);
    assert_eq!((outcome.done, outcome.left), (4, 4));
    let mut more = Fake::default();
    let outcome = drive(&e, &mut more).unwrap();
    assert_eq!(more.jobs, ORDER[4..], "the budget is a session's");
    assert_eq!((outcome.done, outcome.left), (8, 0));
    // Before anything was measured, a run's own time budget tells.
    let other = tempfile::tempdir().unwrap();
    let file = TWO.replace("[train]", "[train]\ntime-budget = \"60s\"");
    let e = experiment(other.path(), &format!("budget = \"100s\"\n{file}")).unwrap();
    let mut none = Fake::default();
    assert_eq!(drive(&e, &mut none).unwrap().left, 8);
    assert!(none.jobs.is_empty());
}

#[test]
fn a_failure_is_told_and_the_others_go_on() {
    let dir = tempfile::tempdir().unwrap();
    let e = experiment(dir.path(), TWO).unwrap();
    let mut fake = Fake {
        fail: Some("a/mh/seed-0"),
        ..Fake::default()
    };
    let outcome = drive(&e, &mut fake).unwrap();
    assert_eq!(outcome.done, 6);
    assert_eq!(outcome.failed.len(), 2);
    assert!(outcome.failed[0].1.contains("told to fail"));
    assert!(
        outcome.failed[1].1.contains("a run that failed"),
        "{outcome:?}"
    );
    assert!(
        !fake.jobs.contains(&"a/none/seed-0".to_owned()),
        "its cap is not known"
    );
    let summary = fs::read_to_string(e.output.join("summary.md")).unwrap();
    assert!(summary.contains("> a: 2 runs are missing"), "{summary}");
    let mut again = Fake::default();
    drive(&e, &mut again).unwrap();
    assert_eq!(again.jobs, ["a/mh/seed-0", "a/none/seed-0"]);
}

#[test]
fn runs_of_other_options_and_folders_of_others_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let e = experiment(dir.path(), TWO).unwrap();
    drive(&e, &mut Fake::default()).unwrap();
    let other = experiment(dir.path(), &TWO.replace("240", "320")).unwrap();
    let mut fake = Fake::default();
    let outcome = drive(&other, &mut fake).unwrap();
    assert!(fake.jobs.is_empty());
    assert_eq!(outcome.failed.len(), 4);
    assert!(
        outcome.failed[0].1.contains("max-size: 240 instead of 320"),
        "{outcome:?}"
    );
    let mut foreign = e.clone();
    foreign.output = dir.path().join("mine");
    fs::create_dir(&foreign.output).unwrap();
    fs::write(foreign.output.join("thesis.txt"), "mine").unwrap();
    let refused = drive(&foreign, &mut Fake::default())
        .unwrap_err()
        .to_string();
    assert!(refused.contains("no experiment"), "{refused}");
    assert_eq!(fs::read_dir(&foreign.output).unwrap().count(), 1);
    let mut nowhere = e;
    nowhere.scenes[1].path = dir.path().join("c");
    let refused = drive(&nowhere, &mut Fake::default())
        .unwrap_err()
        .to_string();
    assert!(
        refused.contains("no such folder or zip archive (scene b)") && refused.contains("--data"),
        "{refused}"
    );
}

#[test]
fn files_that_make_no_sense_are_refused_with_their_reason() {
    let dir = tempfile::tempdir().unwrap();
    for (from, to, word) in [
        ("[0, 1]", "[]", "one of each"),
        ("[0, 1]", "[0, 0]", "0 is there twice"),
        (
            "cap-from = \"mh\"",
            "cap-from = \"adc\"",
            "no setting \"adc\"",
        ),
        ("seeds", "sedes", "sedes"),
        ("iterations = 1000", "iteratoins = 1000", "iteratoins"),
        (
            "iterations = 1000",
            "iterations = 0",
            "scene a, setting none",
        ),
        ("iterations = 1000", "seed = 3", "seeds for the whole file"),
        (
            "sampler = \"none\"",
            "sampler = \"chance\"",
            "setting none: sampler: unknown variant",
        ),
        ("name = \"mh\"\n", "name = \"../mh\"\n", "names a folder"),
        (
            "name = \"mh\"\n",
            "name = \"compare.html\"\n",
            "written beside its folder",
        ),
        (
            "name = \"mh\"\n",
            "name = \"none\"\n",
            "none is there twice",
        ),
        ("path = \"a\"", "name = \"a\"", "without a path"),
        (
            "path = \"a\"",
            "path = \"a\"\nthresholds = [20, 1e9]",
            "within ±200",
        ),
    ] {
        assert!(TWO.contains(from), "{from}");
        let error = experiment(dir.path(), &TWO.replacen(from, to, 1)).unwrap_err();
        assert!(error.to_string().contains(word), "{word}: {error}");
    }
    let soon = experiment(dir.path(), &format!("budget = \"soon\"\n{TWO}"));
    assert!(soon.is_err());
}

#[test]
fn options_of_a_setting_win_over_the_scenes_and_theirs_over_all() {
    let dir = tempfile::tempdir().unwrap();
    let file = TWO.replace(
        "[[setting]]\nname = \"mh\"",
        "[[setting]]\nname = \"mh\"\niterations = 7\nmh = { birth = \"copy\" }",
    );
    let file = file.replace("[train]", "[train]\nmh = { interval = 50 }\nmax-size = 100");
    let e = experiment(dir.path(), &file).unwrap();
    let c = e.config(&e.scenes[1], &e.settings[1], 5).unwrap();
    assert_eq!(
        (c.iterations, c.max_size, c.seed, c.mh.interval),
        (7, 240, 5, 50)
    );
    assert_eq!(c.mh.birth, Some(mhsplat::config::Birth::Copy));
    let c = e.config(&e.scenes[0], &e.settings[0], 0).unwrap();
    assert_eq!((c.iterations, c.max_size), (1000, 100));
}

#[test]
fn the_bundled_files_are_read() {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("data/experiments");
    let e = Experiment::read(&folder.join("room.toml"), None).unwrap();
    e.check_scenes().unwrap();
    let text = fs::read_to_string(folder.join("samplers.toml")).unwrap();
    let raw: toml::Table = toml::from_str(&text).unwrap();
    let scenes = raw["scene"].as_array().unwrap();
    assert_eq!(scenes.len(), 7);
    let relative = |s: &toml::Value| Path::new(s["path"].as_str().unwrap()).is_relative();
    assert!(scenes.iter().all(relative), "--data says where they are");
    let data = tempfile::tempdir().unwrap();
    let e = Experiment::read(&folder.join("ablations.toml"), Some(data.path())).unwrap();
    for setting in &e.settings {
        e.config(&e.scenes[0], setting, 0)
            .unwrap()
            .validate()
            .unwrap();
    }
}
