//! Runs in their order, and the state of each.

use std::path::{Path, PathBuf};

use crate::base::error::Result;
use crate::config::TrainConfig;
use crate::lab::compare::finished;
use crate::lab::experiment::file::Experiment;
use crate::run::METRICS_FILE;
use crate::run::report::settings::flatten;
use crate::run::{RECORD_FILE, RunRecord, checkpoint};

/// Remedy for a run folder that holds something else.
const MOVE: &str = "move it away, or choose another output with -o";
/// Remedy for a run whose number of Gaussians is that of another one, which is not done.
pub(super) const CAP_FIRST: &str = "mend that one first";

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
}

impl Planned {
    fn new(e: &Experiment, scene: usize, setting: usize, seed: u64) -> Self {
        let names = [&e.scenes[scene].name, &e.settings[setting].name];
        let dir = e.output.join(names[0]).join(names[1]);
        Self {
            scene,
            setting,
            seed,
            dir: dir.join(format!("seed-{seed}")),
        }
    }

    /// The configuration of the run, without the cap of another one.
    ///
    /// # Errors
    /// Invalid options.
    pub fn config(&self, e: &Experiment) -> Result<TrainConfig> {
        e.config(&e.scenes[self.scene], &e.settings[self.setting], self.seed)
    }
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
    /// Something that is neither counted nor touched: a run of other options, say.
    Refused {
        /// Reason.
        what: String,
        /// Remedy for the user.
        fix: &'static str,
    },
}

impl State {
    /// One word for it; and the next step, or the reason why there is none with its remedy.
    #[must_use]
    pub fn words(&self) -> (&'static str, String) {
        let (word, next) = match self {
            Self::New => ("new", "not started"),
            Self::Begun => ("begun", "resumes from its checkpoint"),
            Self::Broken => ("broken", "starts again"),
            Self::Done(_) => ("done", "complete"),
            Self::Refused { what, fix } => return ("refused", format!("{what}; {fix}")),
        };
        (word, next.to_owned())
    }

    /// Returns true if there is something to train.
    #[must_use]
    pub fn is_open(&self) -> bool {
        matches!(self, Self::New | Self::Begun | Self::Broken)
    }
}

/// All runs: seed by seed, scene by scene; of both, the setting that gives the cap first, then the others in their order.
#[must_use]
pub fn blocks(e: &Experiment) -> Vec<Vec<Planned>> {
    let mut settings: Vec<usize> = (0..e.settings.len()).collect();
    settings.sort_by_key(|s| e.cap_from.as_ref() != Some(&e.settings[*s].name));
    let mut blocks = Vec::new();
    for seed in &e.seeds {
        for scene in 0..e.scenes.len() {
            let run = |setting: &usize| Planned::new(e, scene, *setting, *seed);
            blocks.push(settings.iter().map(run).collect());
        }
    }
    blocks
}

/// The runs of this session, in the order of [`blocks`]: all, or those of its shard. A run that needs the number of Gaussians of another
/// one is in the same shard.
#[must_use]
pub fn mine(e: &Experiment) -> Vec<Vec<Planned>> {
    let all = blocks(e);
    match e.shard {
        Some(shard) => shard.take(all, e.cap_from.is_some()),
        None => all,
    }
}

/// State of a run folder; with `config` `None`, of whatever configuration.
#[must_use]
pub fn state(dir: &Path, config: Option<&TrainConfig>) -> State {
    if !dir.exists() {
        return State::New;
    }
    let refused = |what: String| State::Refused { what, fix: MOVE };
    let saved = checkpoint::path(dir).exists();
    if !dir.join(RECORD_FILE).exists() {
        return match saved {
            true => refused(format!("holds a checkpoint without {RECORD_FILE}")),
            false => State::Broken,
        };
    }
    let record = match RunRecord::read(dir) {
        Ok(record) => record,
        Err(error) => return refused(error.to_string()),
    };
    let options = config.map_or_else(Vec::new, flatten).into_iter();
    let other = options.zip(flatten(&record.config)).filter(|(a, b)| a != b);
    let other = other.map(|(wanted, own)| format!("{}: {} instead of {}", own.0, own.1, wanted.1));
    let other = other.collect::<Vec<_>>().join("; ");
    if !other.is_empty() {
        return refused(format!("other options ({other})"));
    }
    // Record and metrics are all that a comparison needs: whoever deletes the rest does not want it again. A run that its time
    // budget ends is not known to be over before the scene is written.
    let over = record.iterations >= record.config.last_iterations();
    if over && !dir.join(METRICS_FILE).is_file() {
        return refused(format!("holds a finished run without {METRICS_FILE}"));
    }
    match (finished(&record), saved) {
        (true, _) if over || dir.join("scene.ply").exists() => State::Done(Box::new(record)),
        (_, true) => State::Begun,
        (_, false) => State::Broken,
    }
}

/// The configuration that a run has to have, with the cap of the run that gives it; `None` while that one is not done.
///
/// # Errors
/// Invalid options.
pub fn expected(e: &Experiment, run: &Planned) -> Result<Option<TrainConfig>> {
    let mut config = run.config(e)?;
    let from = e
        .settings
        .iter()
        .position(|s| Some(&s.name) == e.cap_from.as_ref());
    let Some(from) = from.filter(|from| *from != run.setting) else {
        return Ok(Some(config));
    };
    let giver = Planned::new(e, run.scene, from, run.seed);
    let State::Done(record) = state(&giver.dir, Some(&giver.config(e)?)) else {
        return Ok(None);
    };
    config.max_gaussians = Some((record.gaussians + record.removed) as usize);
    Ok(Some(config))
}

/// State of a run, checked against the options that it has to have.
#[must_use]
pub fn look(e: &Experiment, run: &Planned) -> State {
    match expected(e, run) {
        Ok(Some(config)) => state(&run.dir, Some(&config)),
        Ok(None) if !run.dir.exists() => State::New,
        Ok(None) => State::Refused {
            what: "the run that gives its number of Gaussians is not there".into(),
            fix: CAP_FIRST,
        },
        Err(error) => State::Refused {
            what: error.to_string(),
            fix: "correct the experiment's file",
        },
    }
}
