//! [`Run`]: one training run and its folder. Evaluations, exports, checkpoints, records and the report.

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use crate::base::error::{Error, Result};
use crate::capture::{Dataset, Frame};
use crate::config::{Length, TrainConfig};
use crate::device::{Defines, Device};
use crate::evaluate::Evaluator;
use crate::pipeline::buffers::ViewSet;
use crate::pipeline::photos::Photos;
use crate::run::budget::{Pace, begin, go_on};
use crate::run::checkpoint::{self, Checkpoint};
use crate::run::clock::{self, Clock};
use crate::run::density_trace::{TRACE_FILE, funnel, write_trace};
use crate::run::patience;
use crate::run::record::{FinalRecord, PlanRecord, RECORD_FILE, RunRecord, StageRecord};
use crate::run::report::gallery::{GalleryItem, error_map};
use crate::run::report::page::write_report;
use crate::run::start;
use crate::run::table::{DENSITY_FILE, DensityRow, DensityWriter};
use crate::run::table::{METRICS_FILE, MetricsRow, MetricsWriter, read_rows};
use crate::scene::{Gaussians, ply};
use crate::train::{DensityEvent, Event, Next, Plan, Trainer};

/// Held-out views shown in the report.
const GALLERY_VIEWS: usize = 6;

/// State of a run for the progress display.
#[derive(Debug, Clone, PartialEq)]
pub struct Progress {
    /// Iterations done.
    pub iteration: u32,
    /// Iterations of the run.
    pub iterations: u32,
    /// Number of Gaussians.
    pub gaussians: usize,
    /// PSNR of the last evaluation.
    pub psnr: Option<f64>,
    /// Seconds of training so far.
    pub train_seconds: f64,
    /// Decision that training has just taken, spelt out.
    pub decided: Option<String>,
}

/// State that a run begins with.
struct From {
    plan: Plan,
    /// Lengths that the run is to have later, those of the run that it repeats.
    to_come: Vec<Length>,
    /// Checkpoint to go on from.
    saved: Option<Checkpoint>,
}

/// A run under way.
pub struct Run {
    dir: PathBuf,
    /// Position of the local frame in the dataset's own.
    frame: Frame,
    config: TrainConfig,
    trainer: Trainer,
    evaluator: Option<Evaluator>,
    record: RunRecord,
    /// Training losses at the evaluations, as far as they are numbers.
    losses: Vec<f64>,
    clock: Clock,
    metrics: MetricsWriter,
    density: DensityWriter,
    /// Seconds per stage of the sessions before this one.
    stages: Vec<StageRecord>,
    psnr: Option<f64>,
    /// Iterations of the last row of metrics.csv.
    evaluated: Option<u32>,
    /// Iterations of the checkpoint in the folder.
    saved: Option<u32>,
    pace: Pace,
}

impl Run {
    /// A new run in an empty folder (see [`crate::run::claim_folder`]).
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
        config.validate()?;
        let (config, to_come) = begin(config);
        let plan = Plan::new(&dataset, &config)?;
        let from = From {
            plan,
            to_come,
            saved: None,
        };
        Self::open(dir, dataset, from, device, clock)
    }

    /// Continues the run in `dir` from its checkpoint, or begins it again where it was killed before the first one. `config` is
    /// that of [`crate::run::saved_config`], but for what may change on the way:
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
            let mut config = config;
            if config.time_budget.is_some() {
                // Not to be repeated: the clock begins anew, too.
                config.lengths.clear();
            }
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
        let ended = saved.state.iteration >= saved.config.last_iterations();
        if ended && config.time_budget != saved.config.time_budget {
            return Err(Error::config(
                "--time-budget",
                "the run has come to its end already, and none goes on from there; start anew with -o",
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
        let smoothed = !saved.state.rows.filter.is_empty();
        config.validate()?;
        let (config, to_come) = go_on(config, saved.state.iteration);
        let plan = Plan::new(&dataset, &config)?.begun_with(smoothed, saved.state.halvings);
        let from = From {
            plan,
            to_come,
            saved: Some(saved),
        };
        Self::open(dir, dataset, from, &device, clock)
    }

    /// Begins the run, or goes on from its checkpoint. The photos move to the device one by one, so that nobody holds their pixels on
    /// the host from then on.
    fn open(
        dir: &Path,
        dataset: Dataset,
        from: From,
        device: &Device,
        clock: Clock,
    ) -> Result<Self> {
        let From {
            plan,
            to_come,
            saved,
        } = from;
        let mut record = start::record(&dataset, &plan, device);
        record.config.lengths.extend(&to_come);
        if saved.is_some() && dir.join(RECORD_FILE).exists() {
            // A finished run keeps what its trace has shown.
            record.funnel = RunRecord::read(dir)?.funnel;
        }
        let frame = dataset.frame;
        let splats = match &saved {
            Some(saved) => Cow::Borrowed(&saved.state.splats),
            None => Cow::Owned(start::initial_gaussians(&dataset, &plan)?),
        };
        let photos = Photos::new(device, dataset.image_budget);
        let train = ViewSet::new(&photos, dataset.train)?;
        let test = ViewSet::new(&photos, dataset.test)?;
        let mut trainer = Trainer::with_views(train, &plan, &splats)?;
        let defines = Defines::new(device.tuning());
        let evaluator = (!test.is_empty()).then(|| Evaluator::new(device, defines, test));
        let evaluator = evaluator.transpose()?;
        let [metrics, density] = [METRICS_FILE, DENSITY_FILE].map(|name| dir.join(name));
        let mut rows = Vec::new();
        if let Some(Checkpoint { state, .. }) = &saved {
            trainer.restore(state)?;
            rows = read_rows::<MetricsRow>(&metrics)?;
            rows.retain(|row| row.iteration <= state.iteration);
        } else {
            // The record first: a folder with one can be gone on with.
            record.write(dir)?;
        }
        let losses = patience::losses(&rows, trainer.full_size_from());
        patience::check(&plan.config, &losses)?;
        let done = saved.as_ref().map(|saved| saved.state.iteration);
        // The row of a density step that the checkpoint comes before is written again.
        let stepped = saved.as_ref().map(|saved| match saved.state.next {
            Next::Pause | Next::Density => saved.state.iteration.saturating_sub(1),
            _ => saved.state.iteration,
        });
        let mut run = Self {
            dir: dir.to_path_buf(),
            frame,
            pace: Pace::new(&trainer, to_come),
            config: plan.config,
            trainer,
            evaluator,
            record,
            losses,
            metrics: MetricsWriter::open(metrics, done)?,
            density: DensityWriter::open(density, stepped)?,
            clock: match &saved {
                Some(saved) => Clock::resume_from(saved.clock),
                None => clock,
            },
            stages: saved.map_or_else(Vec::new, |saved| saved.stages),
            psnr: None,
            evaluated: rows.last().map(|row| row.iteration),
            saved: done,
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
            let _ = self.trainer.settle().and_then(|()| self.save(true, false));
        }
        ended.map(|()| &self.record)
    }

    /// The iterations that the folder's checkpoint has; none if there is no checkpoint yet.
    #[must_use]
    pub fn saved(&self) -> Option<u32> {
        self.saved
    }

    fn train(&mut self, stop: &AtomicBool, mut progress: impl FnMut(&Progress)) -> Result<()> {
        loop {
            let done = self.trainer.iteration();
            if self.trainer.rested() && self.trainer.schedule().may_change(done) {
                self.plan_length(done, &mut progress)?;
            }
            if self.trainer.rested() && done < self.iterations() {
                if done > 0 && self.trainer.recovered() && (self.out_of_time() || self.stalled()) {
                    break;
                }
                if stop.load(Ordering::Relaxed) {
                    self.interrupt()?;
                    return Err(Error::Interrupted);
                }
            }
            match self.trainer.advance()? {
                Event::Finished => break,
                Event::Iteration { .. } => progress(&self.progress(None)),
                Event::Decided(decision) => progress(&self.progress(Some(decision.to_string()))),
                Event::Density(event) => self.log_density(&event)?,
                Event::Settled(done) => {
                    if let Err(error) = self.pause(done) {
                        self.trainer.repeat_pause();
                        return Err(error);
                    }
                }
                Event::Compiling => self.clock.pause(),
                Event::Compiled => self.clock.resume(),
            }
        }
        if self.trainer.iteration() < self.iterations() && self.stalled() {
            self.record.stalled = self.config.patience;
        }
        self.trainer.finish()?;
        self.evaluate(true)?;
        self.save(true, true)?;
        self.write_trace()?;
        self.report()
    }

    /// Iterations of the whole run as they are planned now.
    fn iterations(&self) -> u32 {
        self.trainer.plan().config.last_iterations()
    }

    /// Sets another length of the run where the time budget asks for it, or the run that is repeated had it.
    fn plan_length(&mut self, done: u32, progress: &mut impl FnMut(&Progress)) -> Result<()> {
        let (length, used) = (self.iterations(), self.clock.train_seconds());
        if done >= length {
            // A run that has come to its end stays there.
            return Ok(());
        }
        let Some(length) = self.pace.length(done, length, used) else {
            return Ok(());
        };
        self.trainer.set_length(length)?;
        let lengths = &self.trainer.plan().config.lengths;
        let first = lengths.len() == 1;
        self.record.config.lengths = [lengths.clone(), self.pace.to_come()].concat();
        if first && self.record.config.time_budget.is_some() {
            let what = format!("about {length} iterations fit into the time budget");
            progress(&self.progress(Some(what)));
        }
        Ok(())
    }

    /// Writes the trace of density control and records its funnel, if there is one.
    fn write_trace(&mut self) -> Result<()> {
        self.clock.pause();
        let stats = *self.trainer.stats();
        if let Some(trace) = self.trainer.density_trace()? {
            write_trace(&self.dir.join(TRACE_FILE), trace)?;
            self.record.funnel = funnel(trace, &stats, self.config.dead_opacity());
            self.write_record()?;
        }
        self.clock.resume();
        Ok(())
    }

    fn progress(&self, decided: Option<String>) -> Progress {
        Progress {
            iteration: self.trainer.iteration(),
            iterations: self.iterations(),
            gaussians: self.trainer.gaussians(),
            psnr: self.psnr,
            train_seconds: self.clock.train_seconds(),
            decided,
        }
    }

    /// Evaluates, saves and exports, each if it is due.
    fn pause(&mut self, done: u32) -> Result<()> {
        let due = |every: u32| every > 0 && done.is_multiple_of(every);
        let [evaluate, save, export] = [
            self.trainer.schedule().eval_every(done),
            self.config.checkpoint_every,
            self.config.export_every,
        ]
        .map(due);
        if evaluate && self.evaluated != Some(done) {
            self.evaluate(false)?;
        }
        self.save(save, export)
    }

    fn log_density(&mut self, event: &DensityEvent) -> Result<()> {
        self.density.write(&DensityRow {
            iteration: event.iteration,
            train_seconds: self.clock.train_seconds(),
            gaussians: event.gaussians as u64,
            stats: event.stats,
        })
    }

    /// True if the training loss has stopped improving, by the patience of the configuration.
    fn stalled(&self) -> bool {
        patience::stalled(&self.losses, self.config.patience)
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
        self.save(true, true)?;
        self.write_record()
    }

    /// Scores the held-out views; the `last` evaluation takes FLIP, too.
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
        self.psnr = scores.as_ref().map(|s| s.mean.psnr);
        let ssim = scores.as_ref().map(|s| s.mean.ssim);
        self.record.final_scores = scores.or_else(|| self.record.final_scores.take());
        let now = self.clock.reading();
        let stats = *self.trainer.stats();
        self.evaluated = Some(done);
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

    /// Scores of the held-out views; the `last` evaluation takes FLIP, too, and, if exposure is compensated, colour-corrected scores.
    /// `None` without held-out views.
    fn scores(&mut self, last: bool) -> Result<Option<FinalRecord>> {
        let background = self.trainer.schedule().fixed_background();
        let compensates = self.trainer.compensates_exposure();
        let (scene, renderer) = self.trainer.scene_and_renderer();
        let Some(evaluator) = &self.evaluator else {
            return Ok(None);
        };
        let mut scores = evaluator.score_all(scene, renderer, background, last)?;
        if last && compensates {
            evaluator.add_color_corrected(&mut scores, scene, renderer, background)?;
        }
        Ok(FinalRecord::of(scores))
    }

    fn write_record(&mut self) -> Result<()> {
        let now = self.clock.reading();
        let stages = self.stage_times();
        let r = &mut self.record;
        r.plan = PlanRecord::of(self.trainer.plan());
        r.iterations = self.trainer.iteration();
        r.gaussians = self.trainer.gaussians() as u64;
        r.removed = self.trainer.learned().removed;
        r.train_seconds = now.train_seconds;
        r.wall_seconds = now.wall_seconds;
        r.cpu_seconds = now.cpu_seconds;
        r.peak_rss_bytes = clock::peak_rss_bytes();
        r.density = *self.trainer.stats();
        r.photos = self.trainer.photo_stats();
        r.stages = stages;
        r.write(&self.dir)
    }

    /// Seconds per stage over all sessions of the run.
    fn stage_times(&self) -> Vec<StageRecord> {
        let now = self.trainer.stage_times().into_iter();
        now.map(|(name, t)| {
            let before = self.stages.iter().find(|s| s.name == name);
            StageRecord {
                name: name.into(),
                seconds: t.seconds + before.map_or(0.0, |s| s.seconds),
                calls: t.calls + before.map_or(0, |s| s.calls),
            }
        })
        .collect()
    }

    /// Writes a checkpoint, then the scene, from one read of the device: first the state to continue from, then the file that
    /// says the run is not to begin again.
    fn save(&mut self, checkpoint: bool, export: bool) -> Result<()> {
        self.clock.pause();
        if checkpoint {
            let saved = Checkpoint {
                state: self.trainer.state()?,
                config: self.record.config.clone(),
                clock: self.clock.reading(),
                dataset: self.record.dataset.fingerprint.clone().unwrap_or_default(),
                tuning: self.trainer.tuning(),
                stages: self.stage_times(),
            };
            checkpoint::write(&self.dir, &saved)?;
            self.saved = Some(saved.state.iteration);
            if export {
                self.export(&saved.state.splats, &saved.state.rows.filter)?;
            }
        } else if export {
            let (splats, filter) = self.trainer.splats()?;
            self.export(&splats, &filter)?;
        }
        self.clock.resume();
        Ok(())
    }

    fn export(&self, splats: &Gaussians, filter: &[f32]) -> Result<()> {
        ply::write_filtered(&self.dir.join("scene.ply"), splats, filter, &self.frame)
    }

    fn report(&mut self) -> Result<()> {
        self.clock.pause();
        let gallery = self.gallery()?;
        let rows = read_rows(self.dir.join(METRICS_FILE))?;
        let density = read_rows(self.dir.join(DENSITY_FILE))?;
        write_report(&self.dir, &self.record, &rows, &density, &gallery)?;
        self.clock.resume();
        Ok(())
    }

    /// Held-out views for the report.
    fn gallery(&mut self) -> Result<Vec<GalleryItem>> {
        let Some(evaluator) = &self.evaluator else {
            return Ok(Vec::new());
        };
        let background = self.trainer.schedule().fixed_background();
        let (scene, renderer) = self.trainer.scene_and_renderer();
        let n = evaluator.views().len();
        let shown = n.min(GALLERY_VIEWS);
        let views: Vec<usize> = (0..shown).map(|k| k * n / shown).collect();
        let mut items = Vec::with_capacity(shown);
        for (k, &view) in views.iter().enumerate() {
            let next = &views[k + 1..];
            let Some(score) = evaluator.score(view, next, scene, renderer, background)? else {
                continue;
            };
            let image = renderer.read_image()?;
            let render = image.rgb8();
            let photo = evaluator.views().read_photo(view)?;
            let counted = photo.counted(render.clone());
            items.push(GalleryItem {
                view: score.view,
                psnr: score.scores.psnr,
                ssim: score.scores.ssim,
                width: image.width as u32,
                height: image.height as u32,
                error: error_map(&counted, &photo.rgb_over(background))?,
                render,
                photo: photo.shown(background),
            });
        }
        Ok(items)
    }
}
