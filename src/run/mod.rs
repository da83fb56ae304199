//! One training run with its run folder: evaluations, exports, checkpoints, records and the report.

pub mod checkpoint;
pub mod clock;
pub mod density_log;
mod files;
mod gallery;
pub mod metrics;
mod patience;
pub mod record;
pub mod report;
mod score;
mod start;
pub mod table;

pub use crate::run::clock::{Clock, Reading};
pub use crate::run::density_log::{DensityRow, DensityWriter, read_density};
pub use crate::run::metrics::{MetricsRow, MetricsWriter, read_rows};
pub use crate::run::record::{
    DatasetRecord, DeviceRecord, FinalRecord, RECORD_FILE, RunRecord, StageRecord,
};
pub use crate::run::report::gallery::{GalleryItem, error_map};
pub use crate::run::report::page::write_report;
pub use crate::run::start::{abandon_folder, claim_folder, initial_splats, saved_config};

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use crate::base::error::{Error, Result};
use crate::capture::{Dataset, Frame};
use crate::config::TrainConfig;
use crate::device::Device;
use crate::evaluate::Evaluator;
use crate::train::Trainer;
use crate::train::brightness::Decision;
use crate::train::plan::Plan;
use crate::train::sampling_rates::AntiAlias;

/// What the progress display shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Progress {
    /// Iterations done.
    pub iteration: u32,
    /// Iterations of the run.
    pub iterations: u32,
    /// Gaussians.
    pub gaussians: usize,
    /// PSNR of the last evaluation.
    pub psnr: Option<f64>,
    /// Seconds of training so far.
    pub train_seconds: f64,
    /// What was decided on per-image exposure, if that was left open.
    pub exposure: Option<Decision>,
}

/// A run under way.
pub struct Run {
    dir: PathBuf,
    /// Where the local frame lies in the dataset's own.
    frame: Frame,
    /// [`Dataset::fingerprint`].
    fingerprint: String,
    config: TrainConfig,
    trainer: Trainer,
    evaluator: Option<Evaluator>,
    record: RunRecord,
    /// What was decided before training.
    plan: Plan,
    /// Training losses at the evaluations, as far as they are numbers.
    losses: Vec<f64>,
    clock: Clock,
    metrics: MetricsWriter,
    density: DensityWriter,
    /// Seconds per stage of the sessions before this one.
    stages: Vec<StageRecord>,
    psnr: Option<f64>,
    /// Iterations of the checkpoint in the folder.
    saved: Option<u32>,
    /// Iterations after which evaluation, export and checkpoint were looked after: repeating an iteration whose pairs did
    /// not fit must not repeat those.
    handled: u32,
}

/// What a run keeps of its dataset, on the device and on the host.
struct Prepared {
    trainer: Trainer,
    evaluator: Option<Evaluator>,
    record: RunRecord,
    frame: Frame,
    fingerprint: String,
}

/// What a new run and a resumed one have different.
struct Start {
    losses: Vec<f64>,
    clock: Clock,
    metrics: MetricsWriter,
    density: DensityWriter,
    stages: Vec<StageRecord>,
    saved: Option<u32>,
}

impl Run {
    /// A new run in an empty folder (see [`claim_folder`]).
    ///
    /// # Errors
    /// A folder that cannot be written, or as [`Trainer::new`].
    pub fn start(
        dir: &Path,
        dataset: Dataset,
        config: TrainConfig,
        device: &Device,
        clock: Clock,
    ) -> Result<Self> {
        let splats = initial_splats(&dataset, &config)?;
        let aa = AntiAlias::decide(&dataset, &config).on;
        let prepared = Prepared::new(dataset, &config, device, &splats, aa)?;
        // The record first: a folder with one can be gone on with.
        prepared.record.write(dir)?;
        let start = Start {
            losses: Vec::new(),
            clock,
            metrics: MetricsWriter::create(dir.join("metrics.csv"))?,
            density: DensityWriter::create(dir.join("density.csv"))?,
            stages: Vec::new(),
            saved: None,
        };
        Self::assemble(dir, config, prepared, start)
    }

    /// Continues the run in `dir` from its checkpoint, or begins it again where it was killed before the first one. `config` is
    /// that of [`saved_config`], but for what may change on the way:
    /// the budgets for time and photos, and how often to evaluate, export and save.
    ///
    /// # Errors
    /// A damaged checkpoint, none in a folder of a run that came to its end, another dataset, a time budget or a patience that is used up, or as [`Trainer::new`].
    pub fn resume(
        dir: &Path,
        dataset: Dataset,
        config: TrainConfig,
        device: &Device,
        clock: Clock,
    ) -> Result<Self> {
        crate::base::files::sweep(dir);
        crate::base::files::sweep(&dir.join("checkpoint"));
        if !start::has_checkpoint(dir)? {
            start::check_unfinished(dir, &dataset)?;
            return Self::start(dir, dataset, config, device, clock);
        }
        let saved = checkpoint::read(dir)?;
        if saved.dataset != dataset.fingerprint() {
            return Err(Error::input(
                &dataset.path,
                dataset.not_that_of(dir),
                "give the dataset of that run, or start anew with -o",
            ));
        }
        let used = saved.clock.train_seconds;
        if config.time_budget.is_some_and(|budget| used >= budget) {
            return Err(Error::config(
                "--time-budget",
                format!("{used:.0} s of training are done already; give a larger one"),
            ));
        }
        if let Some(fault) = saved.tuning.fault(device.info()) {
            return Err(Error::input(
                checkpoint::path(dir),
                format!("its kernels cannot be built for this device ({fault})"),
                "resume on the device it was trained on, with --device",
            ));
        }
        // Another tuning would add in another order: the run goes on as it began.
        let device = device.clone().with_tuning(saved.tuning);
        let state = &saved.state;
        let aa = !state.filter.is_empty();
        let mut prepared = Prepared::new(dataset, &config, &device, &state.splats, aa)?;
        prepared.trainer.restore(state)?;
        let full_from = prepared.trainer.full_size_from();
        let losses = patience::losses(dir, state.iteration, full_from)?;
        patience::check(&config, &losses)?;
        let start = Start {
            losses,
            clock: Clock::resume_from(saved.clock),
            metrics: MetricsWriter::append(dir.join("metrics.csv"), state.iteration)?,
            density: DensityWriter::append(dir.join("density.csv"), state.iteration)?,
            stages: saved.stages,
            saved: Some(state.iteration),
        };
        Self::assemble(dir, config, prepared, start)
    }

    fn assemble(dir: &Path, config: TrainConfig, prepared: Prepared, start: Start) -> Result<Self> {
        let mut run = Self {
            dir: dir.to_path_buf(),
            frame: prepared.frame,
            fingerprint: prepared.fingerprint,
            config,
            handled: prepared.trainer.iteration(),
            saved: start.saved,
            trainer: prepared.trainer,
            evaluator: prepared.evaluator,
            plan: prepared.record.plan.clone(),
            record: prepared.record,
            losses: start.losses,
            clock: start.clock,
            metrics: start.metrics,
            density: start.density,
            stages: start.stages,
            psnr: None,
        };
        run.write_record()?;
        Ok(run)
    }

    /// Trains until the iterations or the time are used up, or `stop` is set; leaves the run folder complete.
    ///
    /// # Errors
    /// [`Error::Interrupted`] when stopped (a checkpoint was written), or whatever failed. Where that can be told of the files
    /// and not of the device, say a photo that is no longer there, a checkpoint of the last good state is written first;
    /// [`Run::saved`] says which there is.
    pub fn drive(
        &mut self,
        stop: &AtomicBool,
        progress: impl FnMut(&Progress),
    ) -> Result<&RunRecord> {
        let ended = self.train(stop, progress);
        if matches!(ended, Err(Error::Io { .. } | Error::Input { .. })) {
            // The record stays as it was: not that of a run that came to its end.
            let _ = self.trainer.settle().and_then(|()| self.checkpoint());
        }
        ended.map(|()| &self.record)
    }

    /// The iterations that the folder's checkpoint has; none if there is no checkpoint yet.
    #[must_use]
    pub fn saved(&self) -> Option<u32> {
        self.saved
    }

    fn train(&mut self, stop: &AtomicBool, mut progress: impl FnMut(&Progress)) -> Result<()> {
        let due = |every: u32, done: u32| every > 0 && done.is_multiple_of(every);
        // After something failed, a density step may be still to be done.
        if self.trainer.iteration() > 0 {
            self.density_step()?;
        }
        while self.trainer.iteration() < self.config.iterations
            && (self.trainer.iteration() == 0 || !(self.out_of_time() || self.stalled()))
        {
            if stop.load(Ordering::Relaxed) {
                self.interrupt()?;
                return Err(Error::Interrupted);
            }
            self.prepare()?;
            self.trainer.step()?;
            self.density_step()?;
            let done = self.trainer.iteration();
            if done < self.config.iterations && done > self.handled {
                self.handled = done;
                if due(self.trainer.schedule().eval_every(), done) {
                    self.evaluate(false)?;
                }
                // First what a run goes on from, then what it is not begun again over.
                if due(self.config.checkpoint_every, done) {
                    self.checkpoint()?;
                }
                if due(self.config.export_every, done) {
                    self.export()?;
                }
            }
            progress(&Progress {
                iteration: done,
                iterations: self.config.iterations,
                gaussians: self.trainer.gaussians(),
                psnr: self.psnr,
                train_seconds: self.clock.train_seconds(),
                exposure: self.trainer.exposure_decision(),
            });
        }
        if self.trainer.iteration() < self.config.iterations && self.stalled() {
            self.record.stalled = self.config.patience;
        }
        self.trainer.finish()?;
        self.evaluate(true)?;
        self.checkpoint()?;
        self.export()?;
        self.report()
    }

    /// What comes before an iteration. The kernels of exposure, if it begins in mid-run, are compiled outside of training time.
    fn prepare(&mut self) -> Result<()> {
        if self.trainer.prepare()? {
            self.clock.pause();
            let built = self.trainer.build_exposure();
            self.clock.resume();
            built?;
        }
        Ok(())
    }

    fn density_step(&mut self) -> Result<()> {
        let Some(event) = self.trainer.density_step()? else {
            return Ok(());
        };
        self.density.write(&DensityRow {
            iteration: event.iteration,
            train_seconds: self.clock.train_seconds(),
            gaussians: event.gaussians as u64,
            stats: event.stats,
        })
    }

    fn out_of_time(&self) -> bool {
        self.config
            .time_budget
            .is_some_and(|t| self.clock.train_seconds() >= t)
    }

    /// The record as it was last written.
    #[must_use]
    pub fn record(&self) -> &RunRecord {
        &self.record
    }

    fn interrupt(&mut self) -> Result<()> {
        self.trainer.settle()?;
        self.checkpoint()?;
        self.export()?;
        self.write_record()
    }

    /// Scores the held-out views; `last` takes FLIP, too.
    fn evaluate(&mut self, last: bool) -> Result<()> {
        self.trainer.settle()?;
        self.clock.pause();
        let loss = self.trainer.recent_loss()?.filter(|l| l.is_finite());
        let done = self.trainer.iteration();
        // Smaller photos have smaller losses; the end is no other evaluation than the last.
        if !last && done > self.trainer.full_size_from() {
            self.losses.extend(loss);
        }
        let scores = self.scores(last)?;
        self.psnr = scores.as_ref().map(|s| s.psnr);
        let ssim = scores.as_ref().map(|s| s.ssim);
        self.record.final_scores = scores.or_else(|| self.record.final_scores.take());
        let now = self.clock.reading();
        let stats = *self.trainer.stats();
        self.metrics.write(&MetricsRow {
            iteration: done,
            train_seconds: now.train_seconds,
            wall_seconds: now.wall_seconds,
            cpu_seconds: now.cpu_seconds,
            loss,
            psnr: self.psnr,
            ssim,
            gaussians: self.trainer.gaussians() as u64,
            proposed: stats.proposed,
            accepted: stats.accepted,
            relocated: stats.relocated,
            pruned: stats.pruned,
            non_finite: self.trainer.non_finite(),
        })?;
        self.write_record()?;
        self.clock.resume();
        Ok(())
    }
}
