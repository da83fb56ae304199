//! One training run with its run folder: evaluations, exports, checkpoints, records and the report.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use crate::buffers::ViewSet;
use crate::config::{Init, TrainConfig};
use crate::dataset::Dataset;
use crate::error::{Error, Result};
use crate::evaluate::{Evaluator, mean};
use crate::export::{checkpoint, ply};
use crate::gpu::tuning::Tuning;
use crate::gpu::{Defines, Device};
use crate::model::{Splats, init};
use crate::plan::Plan;
use crate::report::{
    Clock, DatasetRecord, DensityRow, DensityWriter, DeviceRecord, FinalRecord, GalleryItem,
    MetricsRow, MetricsWriter, RunRecord, StageRecord, clock, error_map, read_density, read_rows,
    write_report,
};
use crate::train::Trainer;

/// Held-out views shown in the report.
const GALLERY_VIEWS: usize = 6;
/// Gaussians of a random initialisation.
const RANDOM_GAUSSIANS: usize = 30_000;

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
}

/// A run under way.
pub struct Run {
    dir: PathBuf,
    dataset: Dataset,
    config: TrainConfig,
    trainer: Trainer,
    evaluator: Option<Evaluator>,
    record: RunRecord,
    clock: Clock,
    metrics: MetricsWriter,
    density: DensityWriter,
    psnr: Option<f64>,
}

/// The first Gaussians that a configuration asks for.
///
/// # Errors
/// A PLY file that cannot be read, or has another SH degree than can be used.
pub fn initial_splats(dataset: &Dataset, config: &TrainConfig) -> Result<Splats> {
    match &config.init {
        Init::File(path) => ply::read(path, &dataset.frame)?.with_sh_degree(config.sh_degree),
        Init::Points if !dataset.points.positions.is_empty() => {
            init::from_points(&dataset.points, config.sh_degree)
        }
        Init::Points | Init::Random => {
            init::random(dataset, RANDOM_GAUSSIANS, config.sh_degree, config.seed)
        }
    }
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
        let trainer = Trainer::new(device, &dataset, &config, &splats)?;
        let metrics = MetricsWriter::create(dir.join("metrics.csv"))?;
        let density = DensityWriter::create(dir.join("density.csv"))?;
        Self::assemble(
            dir, dataset, config, device, trainer, clock, metrics, density,
        )
    }

    /// Continues the run in `dir` from its checkpoint.
    ///
    /// # Errors
    /// No usable checkpoint, another dataset, or as [`Trainer::new`].
    pub fn resume(
        dir: &Path,
        dataset: Dataset,
        config: TrainConfig,
        device: &Device,
    ) -> Result<Self> {
        let saved = checkpoint::read(dir)?;
        let state = &saved.state;
        let mut trainer = Trainer::new(device, &dataset, &config, &state.splats)?;
        trainer.restore(state)?;
        let clock = Clock::resume_from(saved.clock);
        let metrics = MetricsWriter::append(dir.join("metrics.csv"), state.iteration)?;
        let density = DensityWriter::append(dir.join("density.csv"), state.iteration)?;
        Self::assemble(
            dir, dataset, config, device, trainer, clock, metrics, density,
        )
    }

    #[allow(clippy::too_many_arguments)]
    fn assemble(
        dir: &Path,
        dataset: Dataset,
        config: TrainConfig,
        device: &Device,
        trainer: Trainer,
        clock: Clock,
        metrics: MetricsWriter,
        density: DensityWriter,
    ) -> Result<Self> {
        let evaluator = if dataset.test.is_empty() {
            None
        } else {
            let defines = Defines::new(Tuning::for_device(device.info()));
            Some(Evaluator::new(
                device,
                defines,
                ViewSet::upload(device, &dataset.test)?,
            )?)
        };
        let info = device.info();
        let size = |f: fn(&crate::dataset::Photo) -> u32| {
            dataset.train.iter().map(|v| f(&v.photo)).max().unwrap_or(0)
        };
        let record = RunRecord::new(
            config.clone(),
            DatasetRecord {
                path: dataset.path.display().to_string(),
                layout: dataset.layout.to_string(),
                train_views: dataset.train.len(),
                test_views: dataset.test.len(),
                width: size(|p| p.width),
                height: size(|p| p.height),
            },
            DeviceRecord {
                name: info.name.clone(),
                vendor: info.vendor.clone(),
                platform: info.platform.clone(),
                driver: info.driver.clone(),
            },
            Plan::new(&dataset, &config),
        );
        let mut run = Self {
            dir: dir.to_path_buf(),
            dataset,
            config,
            trainer,
            evaluator,
            record,
            clock,
            metrics,
            density,
            psnr: None,
        };
        run.write_record()?;
        Ok(run)
    }

    /// Trains until the iterations or the time are used up, or `stop` is set; leaves the run folder complete.
    ///
    /// # Errors
    /// [`Error::Interrupted`] when stopped (a checkpoint was written), or whatever failed.
    pub fn drive(
        &mut self,
        stop: &AtomicBool,
        mut progress: impl FnMut(&Progress),
    ) -> Result<&RunRecord> {
        let due = |every: u32, done: u32| every > 0 && done.is_multiple_of(every);
        while self.trainer.iteration() < self.config.iterations && !self.out_of_time() {
            if stop.load(Ordering::Relaxed) {
                self.interrupt()?;
                return Err(Error::Interrupted);
            }
            self.trainer.step()?;
            if let Some(event) = self.trainer.density_step()? {
                self.density.write(&DensityRow {
                    iteration: event.iteration,
                    train_seconds: self.clock.train_seconds(),
                    gaussians: event.gaussians as u64,
                    stats: event.stats,
                })?;
            }
            let done = self.trainer.iteration();
            if done < self.config.iterations {
                if due(self.trainer.schedule().eval_every(), done) {
                    self.evaluate()?;
                }
                if due(self.config.export_every, done) {
                    self.export()?;
                }
                if due(self.config.checkpoint_every, done) {
                    self.checkpoint()?;
                }
            }
            progress(&Progress {
                iteration: done,
                iterations: self.config.iterations,
                gaussians: self.trainer.gaussians(),
                psnr: self.psnr,
                train_seconds: self.clock.train_seconds(),
            });
        }
        self.trainer.settle()?;
        self.evaluate()?;
        self.export()?;
        self.checkpoint()?;
        self.report()?;
        Ok(&self.record)
    }

    fn out_of_time(&self) -> bool {
        self.config
            .time_budget
            .is_some_and(|t| self.clock.train_seconds() >= t)
    }

    /// What was planned, for the terminal.
    #[must_use]
    pub fn plan(&self) -> &Plan {
        &self.record.plan
    }

    fn interrupt(&mut self) -> Result<()> {
        self.trainer.settle()?;
        self.checkpoint()?;
        self.export()?;
        self.write_record()
    }

    fn evaluate(&mut self) -> Result<()> {
        self.trainer.settle()?;
        self.clock.pause();
        let loss = self.trainer.recent_loss()?;
        let done = self.trainer.iteration();
        let degree = self.trainer.schedule().sh_degree(done);
        let background = self.trainer.schedule().fixed_background();
        let (scene, renderer) = self.trainer.scene_and_renderer();
        let scores = match &self.evaluator {
            Some(e) => e.score_all(scene, renderer, degree, background)?,
            None => Vec::new(),
        };
        let means = mean(&scores);
        self.psnr = means.map(|(p, _)| p);
        if let Some((psnr, ssim)) = means {
            self.record.final_scores = Some(FinalRecord {
                psnr,
                ssim,
                per_view: scores,
            });
        }
        let now = self.clock.reading();
        let stats = *self.trainer.stats();
        self.metrics.write(&MetricsRow {
            iteration: done,
            train_seconds: now.train_seconds,
            wall_seconds: now.wall_seconds,
            cpu_seconds: now.cpu_seconds,
            loss: loss.is_finite().then_some(loss),
            psnr: self.psnr,
            ssim: means.map(|(_, s)| s),
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

    fn write_record(&mut self) -> Result<()> {
        let now = self.clock.reading();
        let r = &mut self.record;
        r.iterations = self.trainer.iteration();
        r.gaussians = self.trainer.gaussians() as u64;
        r.train_seconds = now.train_seconds;
        r.wall_seconds = now.wall_seconds;
        r.cpu_seconds = now.cpu_seconds;
        r.peak_rss_bytes = clock::peak_rss_bytes();
        r.density = *self.trainer.stats();
        r.stages = self
            .trainer
            .stage_times()
            .into_iter()
            .map(|(name, t)| StageRecord {
                name: name.into(),
                seconds: t.seconds,
                calls: t.calls,
            })
            .collect();
        r.write(&self.dir)
    }

    fn export(&mut self) -> Result<()> {
        self.clock.pause();
        let splats = self.trainer.state()?.splats;
        ply::write(&self.dir.join("scene.ply"), &splats, &self.dataset.frame)?;
        self.clock.resume();
        Ok(())
    }

    fn checkpoint(&mut self) -> Result<()> {
        self.clock.pause();
        let state = self.trainer.state()?;
        checkpoint::write(&self.dir, &state, &self.config, &self.clock.reading())?;
        self.clock.resume();
        Ok(())
    }

    fn report(&mut self) -> Result<()> {
        self.clock.pause();
        let gallery = self.gallery()?;
        let rows = read_rows(self.dir.join("metrics.csv"))?;
        let density = read_density(self.dir.join("density.csv"))?;
        write_report(&self.dir, &self.record, &rows, &density, &gallery)?;
        self.clock.resume();
        Ok(())
    }

    fn gallery(&mut self) -> Result<Vec<GalleryItem>> {
        let Some(evaluator) = &self.evaluator else {
            return Ok(Vec::new());
        };
        let degree = self.trainer.schedule().sh_degree(self.trainer.iteration());
        let background = self.trainer.schedule().fixed_background();
        let (scene, renderer) = self.trainer.scene_and_renderer();
        let n = self.dataset.test.len();
        let shown = n.min(GALLERY_VIEWS);
        let mut items = Vec::with_capacity(shown);
        for k in 0..shown {
            let view = k * n / shown;
            let score = evaluator.score(view, scene, renderer, degree, background)?;
            let image = renderer.read_image(&evaluator.views().cameras[view])?;
            let render = image.rgb8();
            let photo = self.dataset.test[view].photo.rgb_over(background);
            items.push(GalleryItem {
                view: score.view,
                psnr: score.psnr,
                ssim: score.ssim,
                width: image.width as u32,
                height: image.height as u32,
                error: error_map(&render, &photo)?,
                render,
                photo,
            });
        }
        Ok(items)
    }
}

/// Makes the run folder; refuses one that exists.
///
/// # Errors
/// An existing folder, or one that cannot be made.
pub fn claim_folder(dir: &Path) -> Result<()> {
    if dir.exists() {
        return Err(Error::input(
            dir,
            "exists already; a run never overwrites anything",
            "choose another folder with -o, or continue it with --resume",
        ));
    }
    std::fs::create_dir_all(dir).map_err(|e| {
        Error::input(
            dir,
            format!("cannot be made: {e}"),
            "choose a folder that can be written with -o",
        )
    })
}
