//! Runs an experiment within its budget.

use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use crate::base::error::{Error, Result};
use crate::config::TrainConfig;
use crate::lab::experiment::file::Experiment;
use crate::lab::experiment::plan::{Found, Planned, State, blocks, expected, look, state};
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
#[derive(Debug, Clone, PartialEq, Default)]
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

/// Makes the output folder; refuses one that holds something else.
fn claim(e: &Experiment) -> Result<()> {
    let dir = &e.output;
    let empty = std::fs::read_dir(dir).map_or(!dir.exists(), |mut d| d.next().is_none());
    let mark = dir.join(MARK);
    if !empty && !mark.is_file() {
        return Err(Error::input(
            dir,
            "holds something that is no experiment; nothing is overwritten",
            "choose another folder with -o",
        ));
    }
    std::fs::create_dir_all(dir).map_err(|e| Error::io(dir, e))?;
    match mark.is_file() {
        false => crate::base::files::write_bytes(&mark, e.text.as_bytes()),
        true => Ok(()),
    }
}

/// Puts the experiment's present text into its folder, unless it holds a run that does not fit it: the old text describes that one.
fn renew_mark(e: &Experiment) -> Result<()> {
    for run in blocks(e).iter().flatten() {
        if matches!(look(e, run)?, Found::Refused(_)) {
            return Ok(());
        }
    }
    crate::base::files::write_bytes(&e.output.join(MARK), e.text.as_bytes())
}

/// Runs what is missing, as far as the budget goes, and writes the comparisons after every scene of a seed.
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
    claim(experiment)?;
    renew_mark(experiment)?;
    let all = blocks(experiment);
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
        let [_, missing] = drive.counts(block)?;
        if missing > 0 && !drive.fits(block, missing)? {
            for block in &all[place..] {
                let [done, left] = drive.counts(block)?;
                drive.outcome.done += done;
                drive.outcome.left += left;
            }
            break;
        }
        let done = drive.block(block);
        // Whatever ended the block, what there is can be compared.
        summary::write(experiment)?;
        done?;
    }
    summary::write(experiment)?;
    Ok(drive.outcome)
}

impl Drive<'_> {
    /// Numbers of runs of a block that are done, and that are to be trained.
    fn counts(&self, block: &[Planned]) -> Result<[usize; 2]> {
        let mut counts = [0, 0];
        for run in block {
            match look(self.experiment, run)? {
                Found::Matches(State::Done(_)) => counts[0] += 1,
                Found::Matches(_) => counts[1] += 1,
                Found::Refused(_) => (),
            }
        }
        Ok(counts)
    }

    /// Returns true if so many runs of a block can be expected to end within the budget.
    fn fits(&self, block: &[Planned], missing: usize) -> Result<bool> {
        let Some(budget) = self.experiment.budget else {
            return Ok(true);
        };
        let mut longest: f64 = 0.0;
        for run in block {
            let limit = self.config(run)?.time_budget.unwrap_or(0.0);
            longest = longest.max(BESIDE * limit);
        }
        // Runs of this session tell more than their limits.
        let (runs, seconds) = self.taken;
        if runs > 0 {
            longest = seconds / runs as f64;
        }
        let used = self.launch.seconds() - self.began;
        Ok(used < budget && used + missing as f64 * longest <= budget)
    }

    fn config(&self, run: &Planned) -> Result<TrainConfig> {
        let e = self.experiment;
        e.config(&e.scenes[run.scene], &e.settings[run.setting], run.seed)
    }

    fn block(&mut self, block: &[Planned]) -> Result<()> {
        for run in block {
            if self.stop.load(Ordering::Relaxed) {
                return Err(Error::Interrupted);
            }
            let name = run.dir.display().to_string();
            let failed = match expected(self.experiment, run)? {
                None => Some(
                    "its number of Gaussians is that of a run that failed or is of other options"
                        .to_owned(),
                ),
                Some(config) => match self.one(run, &config) {
                    Ok(()) => None,
                    Err(Error::Interrupted) => return Err(Error::Interrupted),
                    Err(error) => Some(error.to_string()),
                },
            };
            match failed {
                None => self.outcome.done += 1,
                Some(why) => {
                    (self.note)(&format!("{name}: failed: {why}"));
                    self.outcome.failed.push((name, why));
                }
            }
        }
        Ok(())
    }

    /// Brings one run to its end.
    fn one(&mut self, run: &Planned, config: &TrainConfig) -> Result<()> {
        let found = state(&run.dir, Some(config))?;
        if matches!(found, State::Done(_)) {
            return Ok(());
        }
        if found == State::Broken {
            abandon_folder(&run.dir);
            if run.dir.exists() {
                return Err(Error::input(
                    &run.dir,
                    "holds part of a run and other files",
                    "move it away",
                ));
            }
        }
        let job = Job {
            dataset: self.experiment.scenes[run.scene].path.clone(),
            dir: run.dir.clone(),
            config: write_config(&run.dir, config)?,
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
        match state(&run.dir, Some(config))? {
            State::Done(record) => {
                let psnr = record.final_scores.as_ref().map_or(f64::NAN, |f| f.psnr);
                (self.note)(&format!(
                    "    {psnr:.2} dB, {} Gaussians, {:.0} s ({:.0} CPU s)",
                    record.gaussians, record.train_seconds, record.cpu_seconds
                ));
                Ok(())
            }
            _ => Err(Error::input(
                &run.dir,
                "training ended, but the run is not complete",
                "run `mhsplat train` on it by hand to see why",
            )),
        }
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
