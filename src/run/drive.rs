//! [`Run`]: one training run and its folder. Evaluations, exports, checkpoints, records and the report.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::base::error::{Error, Result};
use crate::base::files::FolderLock;
use crate::base::process::peak_rss_bytes;
use crate::config::{Length, TrainConfig};
use crate::evaluate::Evaluator;
use crate::run::budget::{Budget, Pace};
use crate::run::checkpoint::{self, Checkpoint};
use crate::run::clock::Clock;
use crate::run::density_trace::{TRACE_FILE, funnel, write_trace};
use crate::run::export::Exports;
use crate::run::forecast::Forecast;
use crate::run::live::{LARGEST_LIVE, LivePage, Server, Watch};
use crate::run::patience;
use crate::run::progress::Progress;
use crate::run::record::{FinalRecord, PlanRecord, RunRecord, StageRecord};
use crate::run::report::gallery::{GALLERY_VIEWS, GalleryItem, items};
use crate::run::report::page::{folder_name, write_report};
use crate::run::report::training::training_views;
use crate::run::table::{DENSITY_FILE, DensityRow, DensityWriter};
use crate::run::table::{METRICS_FILE, MetricsRow, MetricsWriter, read_rows};
use crate::scene::Gaussians;
use crate::train::{DensityEvent, Event, Trainer};

/// A run under way.
pub struct Run {
    pub(super) _lock: FolderLock,
    pub(super) dir: PathBuf,
    pub(super) exports: Exports,
    pub(super) config: TrainConfig,
    pub(super) trainer: Trainer,
    pub(super) evaluator: Option<Evaluator>,
    pub(super) record: RunRecord,
    /// Training losses at the evaluations, as far as they are numbers.
    pub(super) losses: Vec<f64>,
    pub(super) clock: Clock,
    pub(super) metrics: MetricsWriter,
    pub(super) density: DensityWriter,
    /// Seconds per stage of the sessions before this one.
    pub(super) stages: Vec<StageRecord>,
    pub(super) psnr: Option<f64>,
    /// Training loss at the last evaluation of this session.
    pub(super) loss: Option<f64>,
    /// Iterations of the last row of metrics.csv.
    pub(super) evaluated: Option<u32>,
    /// Iterations of the checkpoint in the folder.
    pub(super) saved: Option<u32>,
    pub(super) pace: Pace,
    pub(super) forecast: Forecast,
    /// Iterations and seconds of training when this session began.
    pub(super) began: (u32, f64),
    /// Those who look on, if that is allowed.
    pub(super) watch: Option<Watch>,
}

impl Run {
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

    /// Sentences on the scene files that were read and written, each of them once.
    pub fn take_remarks(&mut self) -> Vec<String> {
        std::mem::take(&mut self.exports.remarks)
    }

    /// The iterations that the folder's checkpoint has; none if there is no checkpoint yet.
    #[must_use]
    pub fn saved(&self) -> Option<u32> {
        self.saved
    }

    fn train(&mut self, stop: &AtomicBool, mut progress: impl FnMut(&Progress)) -> Result<()> {
        loop {
            self.clock.note_elsewhere(self.trainer.cpu_elsewhere());
            let done = self.trainer.iteration();
            if self.trainer.rested() {
                let (training, all) = self.spent();
                let told = self.forecast.measured() > 0;
                let n = self.trainer.gaussians() as f64;
                self.forecast.iterated(done, self.iterations(), training, n);
                if !told
                    && self.pace.budget().is_none()
                    && let Some(left) = self.left()
                {
                    let what = self.forecast.told(self.iterations(), left);
                    progress(&self.progress(Some(what)));
                }
                // A run that is repeated may have been resumed with another length anywhere.
                if self.pace.repeats() || self.trainer.schedule().may_change(done) {
                    self.plan_length(done, all, &mut progress)?;
                }
            }
            if self.trainer.rested() && done < self.iterations() {
                if done > 0 && self.trainer.recovered() && (self.out_of_time() || self.stalled()) {
                    break;
                }
                if self.attend(stop)? || stop.load(Ordering::Relaxed) {
                    self.interrupt()?;
                    return Err(Error::Interrupted);
                }
            }
            self.trainer.settle_before_density()?;
            let (before, _) = self.spent();
            match self.trainer.advance()? {
                Event::Finished => match self.pace.beyond(done) {
                    // The run that is repeated went on from its end.
                    Some(length) => self.set_length(length)?,
                    None => break,
                },
                Event::Iteration { .. } => progress(&self.progress(None)),
                Event::Decided(decision) => {
                    self.forecast.disturbed();
                    progress(&self.progress(Some(decision.to_string())));
                }
                Event::Density(event) => self.note_density(&event, before)?,
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
        if self.trainer.iteration() < self.iterations() {
            match self.stalled() {
                true => self.record.stalled = self.config.patience,
                false => self.record.out_of_time = true,
            }
        }
        self.trainer.finish()?;
        if let Some(watch) = &self.watch {
            watch.ending();
        }
        self.evaluate(true)?;
        self.save(true, true)?;
        self.write_trace()?;
        self.report(true)?;
        self.export_others()
    }

    /// The page of the run, for a server.
    #[must_use]
    pub fn page(&self) -> LivePage {
        LivePage {
            title: folder_name(&self.record.dataset.path).to_owned(),
            views: self.exports.views.clone(),
            photos: true,
            training: true,
            largest: LARGEST_LIVE,
            gaussians: self.trainer.gaussians(),
            reach: 1.0,
        }
    }

    /// Lets a server show the run from now on, and those who look on pause, save and stop it.
    ///
    /// # Errors
    /// A table of evaluations that cannot be read.
    pub fn watch(&mut self, server: Server) -> Result<()> {
        let rows: Vec<MetricsRow> = read_rows(self.dir.join(METRICS_FILE))?;
        let training = self.trainer.training_views(usize::MAX);
        let views = self.exports.views.clone();
        self.trainer.note_density();
        self.watch = Some(Watch::new(server, views, training, &rows));
        Ok(())
    }

    /// Does what those who look on wish, as far as it is time for it; true if the run is to stop.
    fn attend(&mut self, stop: &AtomicBool) -> Result<bool> {
        let Some(mut watch) = self.watch.take() else {
            return Ok(false);
        };
        let attended = match watch.due() {
            true => self.attend_to(&mut watch, stop),
            false => Ok(()),
        };
        let stops = watch.stops();
        self.watch = Some(watch);
        attended.map(|()| stops)
    }

    fn attend_to(&mut self, watch: &mut Watch, stop: &AtomicBool) -> Result<()> {
        // What is in flight is training; looking is not.
        self.trainer.settle()?;
        self.clock.pause();
        loop {
            watch.tell(&self.progress(None), self.saved, &mut self.trainer)?;
            watch.show(&mut self.trainer, self.evaluator.as_ref());
            if watch.takes_checkpoint() {
                self.save(true, false)?;
                self.clock.pause();
            }
            if !watch.paused() || stop.load(Ordering::Relaxed) {
                break;
            }
            self.clock.stop();
            watch.wait();
        }
        self.clock.resume();
        Ok(())
    }

    /// Writes the other formats that are asked for: at every end of a session, so that none is older than the `scene.ply` it leaves.
    fn export_others(&mut self) -> Result<()> {
        if self.config.export.is_empty() {
            return Ok(());
        }
        let scene = self.trainer.splats()?;
        self.exports
            .write_others(&self.dir, &self.config.export, scene)
    }

    /// Iterations of the whole run as they are planned now.
    fn iterations(&self) -> u32 {
        self.trainer.plan().config.last_iterations()
    }

    /// Sets another length of the run where the time budget asks for it, or the run that is repeated had it.
    fn plan_length(
        &mut self,
        done: u32,
        spent: f64,
        progress: &mut impl FnMut(&Progress),
    ) -> Result<()> {
        let length = self.iterations();
        if done >= length {
            // A run that has come to its end stays there.
            return Ok(());
        }
        let Some(length) = self.pace.length(done, length, &self.forecast, spent) else {
            return Ok(());
        };
        let before = self.forecast.size();
        self.set_length(length)?;
        let first = self.trainer.plan().config.lengths.len() == 1;
        if (first || length.size != before)
            && let Some(budget) = self.pace.budget()
        {
            let size = self.forecast.told_size(length.iterations);
            progress(&self.progress(Some(budget.told(&length) + &size)));
        }
        Ok(())
    }

    fn set_length(&mut self, length: Length) -> Result<()> {
        self.trainer.set_length(length.iterations, length.size)?;
        let done = self.trainer.iteration();
        if self.forecast.follow(self.trainer.schedule(), done) {
            self.losses.clear();
        }
        let lengths = &self.trainer.plan().config.lengths;
        self.record.config.lengths = [lengths.clone(), self.pace.to_come()].concat();
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
            loss: self.loss,
            train_seconds: self.clock.train_seconds(),
            rate: self.rate(),
            left: self.left(),
            decided,
        }
    }

    /// Iterations per second since the start or the resumption.
    fn rate(&self) -> Option<f64> {
        let done = self.trainer.iteration().checked_sub(self.began.0)?;
        let seconds = self.clock.train_seconds() - self.began.1;
        (done > 0 && seconds > 0.0).then(|| f64::from(done) / seconds)
    }

    /// Seconds to the end of the run by the wall's clock.
    fn left(&self) -> Option<f64> {
        let left = self
            .forecast
            .left(self.trainer.iteration(), self.iterations())?;
        let Some(budget) = self.pace.budget() else {
            return Some(left);
        };
        let (_, spent) = self.spent();
        // CPU seconds pass as quickly as they have so far.
        let pace = match budget.cpu {
            true => self.clock.wall_seconds() / spent.max(1e-9),
            false => 1.0,
        };
        Some(left.min(budget.seconds - spent).max(0.0) * pace)
    }

    /// Seconds of training and of everything, on the clock that the run goes by.
    fn spent(&self) -> (f64, f64) {
        Budget::spent(self.pace.budget(), &self.clock)
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
        let (_, spent) = self.spent();
        let length = self.iterations();
        let affords = || self.forecast.affords_evaluation(done, length, spent);
        let evaluated = evaluate && self.evaluated != Some(done) && affords();
        if evaluated {
            self.evaluate(false)?;
            self.forecast.evaluated(self.spent().1 - spent);
        }
        let (_, spent) = self.spent();
        let shows = evaluated && self.forecast.affords_export(spent);
        let export = export || shows;
        // A scene without a checkpoint would be in the way of going on.
        if save || (export && self.saved.is_none()) {
            self.save(true, false)?;
            self.forecast.saved(self.spent().1 - spent);
        }
        let (_, spent) = self.spent();
        if export {
            self.save(false, true)?;
        }
        if shows {
            self.report(false)?;
            self.forecast.exported(self.spent().1 - spent);
        }
        Ok(())
    }

    /// Takes note of a density step before which the clock showed so many seconds of training.
    fn note_density(&mut self, event: &DensityEvent, before: f64) -> Result<()> {
        let seconds = self.spent().0 - before;
        let born = event.stats.accepted + event.stats.cloned + event.stats.split;
        let set = [event.gaussians as u64, born];
        self.forecast.grown(event.iteration, set, seconds);
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
        let (_, spent) = self.spent();
        let end = self.forecast.end(self.iterations()).unwrap_or(0.0);
        let budget = self.pace.budget();
        budget.is_some_and(|budget| spent + end >= budget.seconds)
    }

    /// The record as it was last written.
    #[must_use]
    pub fn record(&self) -> &RunRecord {
        &self.record
    }

    fn interrupt(&mut self) -> Result<()> {
        self.trainer.settle()?;
        self.save(true, true)?;
        self.write_record()?;
        self.export_others()?;
        // Who asks for the end may not wait for it: everything else is there.
        if let Err(error) = self.report(true) {
            let what = format!("the report was not written: {error}");
            self.exports.remarks.push(what);
        }
        Ok(())
    }

    /// Scores the held-out views; the `last` evaluation takes FLIP, too.
    fn evaluate(&mut self, last: bool) -> Result<()> {
        self.trainer.count_non_finite()?;
        self.clock.pause();
        let loss = self.trainer.recent_loss()?.filter(|l| l.is_finite());
        let done = self.trainer.iteration();
        // Smaller photos have smaller losses; the end is no other evaluation than the last.
        if !last && done > self.trainer.full_size_from() {
            self.losses.extend(loss);
        }
        let scores = self.scores(last)?;
        self.psnr = scores.as_ref().map(|s| s.mean.psnr);
        self.loss = loss;
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
        let Some(evaluator) = &self.evaluator else {
            return Ok(None);
        };
        let trainer = &mut self.trainer;
        let mut scores = evaluator.score_all(trainer, background, last)?;
        if last && compensates {
            evaluator.add_color_corrected(&mut scores, trainer, background)?;
        }
        Ok(FinalRecord::of(scores))
    }

    pub(super) fn write_record(&mut self) -> Result<()> {
        let now = self.clock.reading();
        let stages = self.stage_times();
        let r = &mut self.record;
        r.plan = PlanRecord::of(self.trainer.plan());
        r.iterations = self.trainer.iteration();
        r.full_size_from = self.trainer.full_size_from().into();
        r.gaussians = self.trainer.gaussians() as u64;
        r.removed = self.trainer.learned().removed;
        r.train_seconds = now.train_seconds;
        r.wall_seconds = now.wall_seconds;
        r.cpu_seconds = now.cpu_seconds;
        r.peak_rss_bytes = r.peak_rss_bytes.max(peak_rss_bytes());
        r.density = *self.trainer.stats();
        r.photos = self.trainer.photo_stats();
        r.stages = stages;
        r.write(&self.dir)
    }

    /// Has the stages of every iteration timed, and not of a sample that stands for all.
    pub fn time_every_iteration(&mut self) {
        self.trainer.time_every_iteration();
    }

    /// Seconds per stage over all sessions of the run.
    fn stage_times(&self) -> Vec<StageRecord> {
        let mut all = self.stages.clone();
        for (name, t) in self.trainer.stage_times() {
            match all.iter_mut().find(|s| s.name == name) {
                Some(sum) => {
                    sum.seconds += t.seconds;
                    sum.calls += t.calls;
                }
                None => all.push(StageRecord {
                    name: name.into(),
                    seconds: t.seconds,
                    calls: t.calls,
                }),
            }
        }
        all
    }

    /// Writes a checkpoint, then the scene, from one read of the device: first the state to continue from, then the file that
    /// says the run is not to begin again.
    pub(super) fn save(&mut self, checkpoint: bool, export: bool) -> Result<()> {
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
                let (splats, filter) = (&saved.state.splats, &saved.state.rows.filter);
                self.export(splats, filter)?;
            }
        } else if export {
            let (splats, filter) = self.trainer.splats()?;
            self.export(&splats, &filter)?;
        }
        self.clock.resume();
        Ok(())
    }

    /// Writes the page that shows the scene, and the scene.
    fn export(&mut self, splats: &Gaussians, filter: &[f32]) -> Result<()> {
        let background = self.trainer.schedule().fixed_background();
        self.exports.add_views(
            self.evaluator.as_ref(),
            self.record.final_scores.as_ref(),
            background,
        );
        let title = folder_name(&self.record.dataset.path);
        let remarks = self
            .exports
            .write(&self.dir, title, background, splats, filter)?;
        if remarks != self.record.remarks {
            self.record.remarks = remarks;
            self.write_record()?;
        }
        Ok(())
    }

    /// Writes the report: all of it, or what needs no pictures.
    fn report(&mut self, pictures: bool) -> Result<()> {
        self.clock.pause();
        let mut gallery = Vec::new();
        if pictures {
            let (scores, shown) = training_views(&mut self.trainer)?;
            self.record.training = scores;
            gallery = [self.gallery()?, shown].concat();
        }
        self.write_record()?;
        let rows = read_rows(self.dir.join(METRICS_FILE))?;
        let density = read_rows(self.dir.join(DENSITY_FILE))?;
        write_report(
            &self.dir,
            &self.record,
            &rows,
            &density,
            &gallery,
            &self.exports.views,
        )?;
        self.clock.resume();
        Ok(())
    }

    /// Held-out views for the report.
    fn gallery(&mut self) -> Result<Vec<GalleryItem>> {
        let Some(evaluator) = &self.evaluator else {
            return Ok(Vec::new());
        };
        let background = self.trainer.schedule().fixed_background();
        let n = evaluator.views().len();
        let shown = n.min(GALLERY_VIEWS);
        let mut views: Vec<usize> = (0..shown).map(|k| k * n / shown).collect();
        let scores = self.record.final_scores.iter().flat_map(|f| &f.per_view);
        let worst = scores.min_by(|a, b| a.scores.psnr.total_cmp(&b.scores.psnr));
        let names = &evaluator.views().names;
        let worst = worst.and_then(|w| names.iter().position(|name| *name == w.view));
        if let Some(worst) = worst.filter(|w| !views.contains(w)) {
            views.pop();
            views.push(worst);
        }
        items(evaluator, &views, &mut self.trainer, background)
    }
}
