//! Runs an experiment within its budget.

use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use crate::base::error::{Error, Result};
use crate::base::files::{FolderLock, is_free};
use crate::config::TrainConfig;
use crate::lab::experiment::file::Experiment;
use crate::lab::experiment::plan::{
    CAP_FIRST, Planned, State, blocks, expected, look, mine, state,
};
use crate::lab::experiment::summary;
use crate::lab::folder::json;
use crate::run::abandon_folder;

/// File name of the experiment's own text in its output folder, by which the folder is recognised.
const MARK: &str = "experiment.toml";
/// Whole time of a run over its time budget: start, evaluations and report come on top.
const BESIDE: f64 = 1.2;

/// A run to train.
#[derive(Debug, Clone, PartialEq)]
pub struct Job {
    /// Dataset.
    pub dataset: PathBuf,
    /// Run folder.
    pub dir: PathBuf,
    /// Configuration, as a file for `--config`.
    pub config: PathBuf,
    /// True to resume from its checkpoint.
    pub resume: bool,
}

/// A way to train a run, with a clock.
pub trait Launch {
    /// Trains to the end.
    ///
    /// # Errors
    /// [`Error::Interrupted`] if the user stopped it, or the failure.
    fn train(&mut self, job: &Job) -> Result<()>;

    /// Seconds since some moment before.
    fn seconds(&self) -> f64;
}

/// Numbers of runs that are done, failed and left.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize)]
pub struct Outcome {
    /// Finished runs, earlier ones included.
    pub done: usize,
    /// Runs that failed, with the reason.
    pub failed: Vec<(String, String)>,
    /// Runs that the budget left for another time.
    pub left: usize,
}

struct Drive<'a> {
    experiment: &'a Experiment,
    launch: &'a mut dyn Launch,
    stop: &'a AtomicBool,
    note: &'a mut dyn FnMut(&str),
    began: f64,
    /// Runs of this session, and seconds that they took.
    taken: (usize, f64),
    outcome: Outcome,
    runs: usize,
}

/// Makes the output folder and puts the experiment's present text into it, unless it holds a run that does not fit: the old
/// text describes that one. Refuses a folder that holds something else.
fn claim(e: &Experiment, blocks: &[Vec<Planned>]) -> Result<()> {
    let dir = &e.output;
    let mark = dir.join(MARK);
    // Another job may be putting its text there at this moment.
    if !is_free(dir) && !mark.is_file() {
        return Err(Error::input(
            dir,
            "holds something that is no experiment; nothing is overwritten",
            "choose another folder with -o",
        ));
    }
    std::fs::create_dir_all(dir).map_err(|e| Error::io(dir, e))?;
    let refused = |run: &Planned| matches!(look(e, run), State::Refused { .. });
    match blocks.iter().flatten().any(refused) {
        true => Ok(()),
        false => crate::base::files::write_bytes(&mark, e.text.as_bytes()),
    }
}

/// True if every run of the experiment is finished, those of other shards included.
#[must_use]
pub fn is_complete(experiment: &Experiment) -> bool {
    let done = |run: &Planned| matches!(look(experiment, run), State::Done(_));
    blocks(experiment).iter().flatten().all(done)
}

/// Runs what is missing, as far as the budget goes, and writes the comparisons after every scene of a seed; those of a shard once the
/// whole experiment is complete.
///
/// A run that fails is named in the outcome, as are those that need its number of Gaussians; the others go on.
///
/// # Errors
/// [`Error::Interrupted`]; scenes that are not there; an output folder, or a run in it, that is something else; files that
/// cannot be written.
pub fn run(
    experiment: &Experiment,
    launch: &mut dyn Launch,
    stop: &AtomicBool,
    note: &mut dyn FnMut(&str),
) -> Result<Outcome> {
    experiment.check_scenes()?;
    claim(experiment, &blocks(experiment))?;
    let all = mine(experiment);
    let compare = || match experiment.shard.is_none() || is_complete(experiment) {
        true => summary::write(experiment).map(drop),
        false => Ok(()),
    };
    let mut drive = Drive {
        experiment,
        began: launch.seconds(),
        launch,
        stop,
        note,
        taken: (0, 0.0),
        outcome: Outcome::default(),
        runs: all.iter().map(Vec::len).sum(),
    };
    for (place, block) in all.iter().enumerate() {
        let missing = block.iter().filter(|r| look(experiment, r).is_open());
        if !drive.fits(block, missing.count())? {
            for run in all[place..].iter().flatten() {
                let state = look(experiment, run);
                drive.outcome.left += usize::from(state.is_open());
                drive.outcome.done += usize::from(matches!(state, State::Done(_)));
            }
            break;
        }
        let done = drive.block(block);
        // Whatever ended the block, what there is can be compared.
        compare()?;
        done?;
    }
    compare()?;
    Ok(drive.outcome)
}

impl Drive<'_> {
    /// Returns true if so many runs of a block can be expected to end within the budget.
    fn fits(&self, block: &[Planned], missing: usize) -> Result<bool> {
        let Some(budget) = self.experiment.budget.filter(|_| missing > 0) else {
            return Ok(true);
        };
        // Runs of this session tell more than their limits.
        let (runs, seconds) = self.taken;
        let mut longest = if runs > 0 { seconds / runs as f64 } else { 0.0 };
        for run in block.iter().filter(|_| runs == 0) {
            let limit = run.config(self.experiment)?.time_budget.unwrap_or(0.0);
            longest = longest.max(BESIDE * limit);
        }
        let used = self.launch.seconds() - self.began;
        Ok(used < budget && used + missing as f64 * longest <= budget)
    }

    fn block(&mut self, block: &[Planned]) -> Result<()> {
        for run in block {
            if self.stop.load(Ordering::Relaxed) {
                return Err(Error::Interrupted);
            }
            match self.one(run) {
                Ok(()) => self.outcome.done += 1,
                Err(Error::Interrupted) => return Err(Error::Interrupted),
                Err(error) => {
                    let (name, why) = (run.dir.display().to_string(), error.to_string());
                    let why = why.trim_start_matches(&format!("{name}: ")).to_owned();
                    (self.note)(&format!("{name}: failed: {why}"));
                    self.outcome.failed.push((name, why));
                }
            }
        }
        Ok(())
    }

    /// Brings one run to its end.
    fn one(&mut self, run: &Planned) -> Result<()> {
        let wrong = |what: &str, fix: &str| Err(Error::input(&run.dir, what, fix));
        let Some(config) = expected(self.experiment, run)? else {
            return wrong(
                "its number of Gaussians is that of a run that failed or is of other options",
                CAP_FIRST,
            );
        };
        let found = state(&run.dir, Some(&config));
        match &found {
            State::Done(_) => return Ok(()),
            State::Refused { what, fix } => return wrong(what, fix),
            State::Broken => {
                // So is one that has only just begun, in another process, which may have come further meanwhile.
                let lock = FolderLock::take(&run.dir)?;
                if state(&run.dir, Some(&config)) != State::Broken {
                    return wrong("another process trains it", "run the same command later");
                }
                abandon_folder(&run.dir);
                drop(lock);
                if run.dir.exists() {
                    return wrong("holds part of a run and other files", "move it away");
                }
            }
            State::New | State::Begun => (),
        }
        let job = Job {
            dataset: self.experiment.scenes[run.scene].path.clone(),
            dir: run.dir.clone(),
            config: write_config(&run.dir, &config)?,
            resume: found == State::Begun,
        };
        let count = self.outcome.done + self.outcome.failed.len() + 1;
        let verb = if job.resume { "resumes" } else { "starts" };
        let name = run.dir.display();
        (self.note)(&format!("[{count}/{}] {name} {verb}", self.runs));
        let before = self.launch.seconds();
        self.launch.train(&job)?;
        self.taken.0 += 1;
        self.taken.1 += self.launch.seconds() - before;
        let State::Done(record) = state(&run.dir, Some(&config)) else {
            return wrong(
                "training ended, but the run is not complete",
                "run `mhsplat train` on it by hand to see why",
            );
        };
        let psnr = record.final_scores.as_ref().map_or_else(
            || "no held-out view".to_owned(),
            |f| format!("{:.2} dB", f.mean.psnr),
        );
        (self.note)(&format!(
            "    {psnr}, {} Gaussians, {:.0} s ({:.0} CPU s)",
            record.gaussians, record.train_seconds, record.cpu_seconds
        ));
        Ok(())
    }
}

/// Writes `config-seed-N.json` beside the run folder: `seed-*` are runs and nothing else.
fn write_config(dir: &Path, config: &TrainConfig) -> Result<PathBuf> {
    let run = dir.file_name().unwrap_or_default().to_string_lossy();
    let file = dir.with_file_name(format!("config-{run}.json"));
    if let Some(parent) = file.parent() {
        std::fs::create_dir_all(parent).map_err(|e| Error::io(parent, e))?;
    }
    let text = json(&file.display().to_string(), config)?;
    crate::base::files::write_bytes(&file, (text + "\n").as_bytes())?;
    Ok(file)
}

/// The last line of a process's stderr that begins with `error: `, whatever bytes the lines hold: drivers write there, too.
pub fn last_error(stderr: impl Read) -> Option<String> {
    let lines = BufReader::new(stderr).split(b'\n');
    let errors = lines
        .map_while(std::io::Result::ok)
        .filter(|l| l.starts_with(b"error: "));
    let last = errors.last()?;
    Some(String::from_utf8_lossy(&last).trim_end().to_owned())
}
