//! Runs in their order, and what is there of each.

use std::path::{Path, PathBuf};

use super::file::Experiment;
use crate::compare::finished;
use crate::config::TrainConfig;
use crate::error::{Error, Result};
use crate::export::checkpoint;
use crate::report::settings::flatten;
use crate::report::{RECORD_FILE, RunRecord};

/// One run of the matrix.
#[derive(Debug, Clone, PartialEq)]
pub struct Planned {
    /// Place of its scene.
    pub scene: usize,
    /// Place of its setting.
    pub setting: usize,
    /// Seed.
    pub seed: u64,
    /// Run folder.
    pub dir: PathBuf,
    /// Whether the number of its Gaussians is another run's.
    pub capped: bool,
}

/// What is there of a run.
#[derive(Debug, Clone, PartialEq)]
pub enum State {
    /// Nothing.
    New,
    /// A checkpoint to go on from.
    Begun,
    /// What a run leaves that ended before its first checkpoint.
    Broken,
    /// All of it.
    Done(Box<RunRecord>),
}

/// The folder of a run.
pub(super) fn folder(e: &Experiment, scene: usize, setting: usize, seed: u64) -> PathBuf {
    let (scene, setting) = (&e.scenes[scene].name, &e.settings[setting].name);
    e.output
        .join(scene)
        .join(setting)
        .join(format!("seed-{seed}"))
}

/// All runs: scene by scene, seed by seed; of a seed, the setting that gives the cap first, then the others in their order.
#[must_use]
pub fn blocks(e: &Experiment) -> Vec<Vec<Planned>> {
    let first = e.cap_from.into_iter();
    let others = (0..e.settings.len()).filter(|s| Some(*s) != e.cap_from);
    let settings: Vec<usize> = first.chain(others).collect();
    let block = |scene: usize, seed: u64| -> Vec<Planned> {
        let run = |setting: &usize| Planned {
            scene,
            setting: *setting,
            seed,
            dir: folder(e, scene, *setting, seed),
            capped: e.cap_from.is_some_and(|c| c != *setting),
        };
        settings.iter().map(run).collect()
    };
    (0..e.scenes.len())
        .flat_map(|scene| e.seeds.iter().map(move |seed| (scene, *seed)))
        .map(|(scene, seed)| block(scene, seed))
        .collect()
}

/// Options in which two configurations differ, `name: a instead of b`.
fn differences(found: &TrainConfig, wanted: &TrainConfig) -> Vec<String> {
    let pairs = flatten(found).into_iter().zip(flatten(wanted));
    pairs
        .filter(|(a, b)| a != b)
        .map(|(a, b)| format!("{}: {} instead of {}", a.0, a.1, b.1))
        .collect()
}

/// What is there of a run; `config` none takes any configuration for the right one.
///
/// # Errors
/// A folder that holds something else, or a run of another configuration.
pub fn state(dir: &Path, config: Option<&TrainConfig>) -> Result<State> {
    if !dir.exists() {
        return Ok(State::New);
    }
    let saved = checkpoint::path(dir).exists();
    if !dir.join(RECORD_FILE).exists() {
        if saved {
            return Err(Error::input(
                dir,
                format!("holds a checkpoint without {RECORD_FILE}"),
                "move it away",
            ));
        }
        return Ok(State::Broken);
    }
    let record = RunRecord::read(dir)?;
    let other = config.map_or_else(Vec::new, |c| differences(&record.config, c));
    if !other.is_empty() {
        return Err(Error::input(
            dir,
            format!("was run with other options ({})", other.join("; ")),
            "move it away, or choose another output with -o",
        ));
    }
    Ok(match (finished(&record), saved) {
        (true, _) if dir.join("scene.ply").exists() => State::Done(Box::new(record)),
        (_, true) => State::Begun,
        (_, false) => State::Broken,
    })
}
