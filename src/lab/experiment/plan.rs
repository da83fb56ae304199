//! Runs in their order, and the state of each.

use std::path::{Path, PathBuf};

use crate::base::error::{Error, Result};
use crate::config::TrainConfig;
use crate::lab::compare::finished;
use crate::lab::experiment::file::Experiment;
use crate::run::METRICS_FILE;
use crate::run::report::settings::flatten;
use crate::run::{RECORD_FILE, RunRecord, checkpoint};

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
    /// True if its cap is the final number of Gaussians of another run.
    pub capped: bool,
}

/// State of a run folder.
#[derive(Debug, Clone, PartialEq)]
pub enum State {
    /// No folder.
    New,
    /// A checkpoint to resume from.
    Begun,
    /// The remains of a run that ended before its first checkpoint.
    Broken,
    /// A finished run.
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

/// All runs: seed by seed, scene by scene; of both, the setting that gives the cap first, then the others in their order.
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
    let scenes = 0..e.scenes.len();
    let all = e
        .seeds
        .iter()
        .flat_map(|seed| scenes.clone().map(move |s| (s, *seed)));
    all.map(|(scene, seed)| block(scene, seed)).collect()
}

/// Options in which the configuration of a run differs from the wanted one, `name: a instead of b`.
fn differences(record: &RunRecord, wanted: &TrainConfig) -> Vec<String> {
    let pairs = flatten(&record.config).into_iter().zip(flatten(wanted));
    pairs
        .filter(|(a, b)| a != b)
        .map(|(a, b)| format!("{}: {} instead of {}", a.0, a.1, b.1))
        .collect()
}

/// State of a run folder; with `config` `None`, of whatever configuration.
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
    let other = config.map_or_else(Vec::new, |c| differences(&record, c));
    if !other.is_empty() {
        return Err(Error::input(
            dir,
            format!("other options ({})", other.join("; ")),
            "move it away, or choose another output with -o",
        ));
    }
    // Record and metrics are all that a comparison needs: whoever deletes the rest does not want it again. A run that its time
    // budget ends is not known to be over before the scene is written.
    let over = record.iterations >= record.config.iterations;
    if over && !dir.join(METRICS_FILE).is_file() {
        return Err(Error::input(
            dir,
            format!("holds a finished run without {METRICS_FILE}"),
            "move it away",
        ));
    }
    Ok(match (finished(&record), saved) {
        (true, _) if over || dir.join("scene.ply").exists() => State::Done(Box::new(record)),
        (_, true) => State::Begun,
        (_, false) => State::Broken,
    })
}

/// State of a run of an experiment.
#[derive(Debug, Clone, PartialEq)]
pub enum Found {
    /// A run by the options that the experiment gives it.
    Matches(State),
    /// Something that is neither counted nor touched, with the reason.
    Refused(String),
}

impl Found {
    /// One word for it.
    #[must_use]
    pub fn word(&self) -> &'static str {
        match self {
            Self::Matches(State::New) => "new",
            Self::Matches(State::Begun) => "begun",
            Self::Matches(State::Broken) => "broken",
            Self::Matches(State::Done(_)) => "done",
            Self::Refused(_) => "refused",
        }
    }

    /// The next step, or the reason why there is none.
    #[must_use]
    pub fn why(&self) -> &str {
        match self {
            Self::Matches(State::New) => "not started",
            Self::Matches(State::Begun) => "resumes from its checkpoint",
            Self::Matches(State::Broken) => "starts again",
            Self::Matches(State::Done(_)) => "complete",
            Self::Refused(why) => why,
        }
    }
}

/// The configuration that a run has to have, with the cap of the run that gives it; `None` while that one is not done.
///
/// # Errors
/// Invalid options.
pub fn expected(e: &Experiment, run: &Planned) -> Result<Option<TrainConfig>> {
    let of = |setting: usize| e.config(&e.scenes[run.scene], &e.settings[setting], run.seed);
    let mut config = of(run.setting)?;
    let Some(from) = e.cap_from.filter(|_| run.capped) else {
        return Ok(Some(config));
    };
    let dir = folder(e, run.scene, from, run.seed);
    let Ok(State::Done(record)) = state(&dir, Some(&of(from)?)) else {
        return Ok(None);
    };
    config.max_gaussians = Some((record.gaussians + record.removed) as usize);
    Ok(Some(config))
}

/// State of a run, checked against the options that it has to have.
///
/// # Errors
/// Invalid options.
pub fn look(e: &Experiment, run: &Planned) -> Result<Found> {
    Ok(match expected(e, run)? {
        Some(config) => match state(&run.dir, Some(&config)) {
            Ok(state) => Found::Matches(state),
            Err(Error::Input { what, fix, .. }) => Found::Refused(format!("{what}; {fix}")),
            Err(error) => Found::Refused(error.to_string()),
        },
        None if !run.dir.exists() => Found::Matches(State::New),
        None => Found::Refused("the run that gives its number of Gaussians is not there".into()),
    })
}
