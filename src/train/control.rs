//! The density step: error cues from the device, decisions on the host, edits back to the device.

use std::time::Instant;

use crate::base::error::Result;
use crate::density::{
    Cues, DensityStats, Evidence, Outcome, SceneState, ScreenGradient, StepContext, Wanted,
};
use crate::device::{Array, CameraArg, EditRow};
use crate::pipeline::buffers::{Scene, restride};
use crate::pipeline::stage::edit::EditArgs;
use crate::pipeline::stage::importance::ImportanceArgs;
use crate::pipeline::stage::loss::ImagePair;
use crate::scene::{Plane, morton};
use crate::train::Trainer;

/// What one density step did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DensityEvent {
    /// Iteration.
    pub iteration: u32,
    /// Progress η.
    pub progress: f64,
    /// Gaussians afterwards.
    pub gaussians: usize,
    /// This step's statistics.
    pub stats: DensityStats,
}

impl Trainer {
    /// Adds the errors of the iteration's render to the cues if the next density step wants them: the last k renders
    /// before it serve as its view subset (\[MH\] Eq. 10), as many as there are since the last step at most. Training
    /// takes the views in random order, so that they are a random subset (of two epochs where one ends between: a view may
    /// then count twice), and no view is rendered for density control alone.
    pub(super) fn watch(
        &self,
        iteration: u32,
        camera: &CameraArg<f32>,
        pair: &ImagePair<'_, f32>,
    ) -> Result<()> {
        let Some((due, progress)) = self.schedule.next_density(iteration) else {
            return Ok(());
        };
        let Wanted::Errors { views } = self.density.wanted(self.views.len(), progress) else {
            return Ok(());
        };
        let since_last = self.schedule.density_interval().min(due);
        let first = due - since_last.min(u32::try_from(views).unwrap_or(u32::MAX));
        if iteration < first {
            return Ok(());
        }
        self.add_cues(camera, pair, iteration == first)
    }

    pub(super) fn add_cues(
        &self,
        camera: &CameraArg<f32>,
        pair: &ImagePair<'_, f32>,
        first_view: bool,
    ) -> Result<()> {
        let Some(importance) = &self.sampler.importance else {
            return Ok(());
        };
        self.loss.errors(pair, &self.maps, &self.partial)?;
        importance.run(&ImportanceArgs {
            params: &self.scene.params,
            stride: self.scene.stride,
            count: self.scene.count,
            camera,
            maps: &self.maps,
            first_view,
            status: &self.renderer.frame.status,
            cues: &self.cues,
        })
    }

    /// Runs density control if it is due after the iterations done so far.
    ///
    /// # Errors
    /// As [`Trainer::step`].
    pub fn density_step(&mut self) -> Result<Option<DensityEvent>> {
        if self.schedule.density_due(self.iteration).is_none() {
            return Ok(None);
        }
        self.settle()?;
        // Settling may have gone back and forth; only now is the iteration what it says.
        let due = self.schedule.density_due(self.iteration);
        let Some(progress) = due.filter(|_| self.last_density != Some(self.iteration)) else {
            return Ok(None);
        };
        let began = Instant::now();
        let outcome = self.decide(progress)?;
        self.last_density = Some(self.iteration);
        self.apply(&outcome)?;
        self.device.finish()?;
        self.tally.density_time.seconds += began.elapsed().as_secs_f64();
        self.tally.density_time.calls += 1;
        self.tally.stats.add(&outcome.stats);
        Ok(Some(DensityEvent {
            iteration: self.iteration,
            progress,
            gaussians: self.scene.count,
            stats: outcome.stats,
        }))
    }

    /// What density control wants, from what the device knows.
    fn decide(&mut self, progress: f64) -> Result<Outcome> {
        let planes: Vec<Vec<f32>> = (0..Plane::SH)
            .map(|p| self.scene.plane(p))
            .collect::<Result<_>>()?;
        let slice = |p: usize| planes[p].as_slice();
        let state = SceneState {
            positions: std::array::from_fn(|k| slice(Plane::POSITION + k)),
            log_scales: std::array::from_fn(|k| slice(Plane::LOG_SCALE + k)),
            rotations: std::array::from_fn(|k| slice(Plane::ROTATION + k)),
            opacity_logits: slice(Plane::OPACITY),
        };
        let cameras: Vec<[f32; 3]> = self.views.cameras.iter().map(|c| c.center).collect();
        let pictures = self.pictures(progress)?;
        let context = StepContext {
            iteration: self.iteration,
            progress,
            seed: self.config.seed,
            max_gaussians: self.config.max_gaussians,
            opacity_resets: self.schedule.opacity_resets(self.iteration),
            resets_opacity: self.schedule.resets_opacity(self.iteration),
            cameras: &cameras,
            pictures: &pictures,
        };
        let rows = self.read_cues()?;
        let cue = |k: usize| rows.get(k).map_or(&[][..], Vec::as_slice);
        let wanted = self.density.wanted(self.views.len(), progress);
        let views: Vec<u32> = match wanted {
            Wanted::Nothing => Vec::new(),
            // The last row counts.
            _ => cue(wanted.rows() - 1).iter().map(|v| *v as u32).collect(),
        };
        let evidence = match wanted {
            Wanted::Nothing => Evidence::Nothing,
            Wanted::Errors { .. } => Evidence::Errors(Cues {
                ssim: cue(0),
                l1: cue(1),
                views: &views,
            }),
            Wanted::ScreenGradient => Evidence::ScreenGradient(ScreenGradient {
                norms: cue(0),
                views: &views,
            }),
        };
        let density = self.density.clone();
        density.step_probed(&context, &state, &evidence, &mut |trials| {
            self.probe(trials)
        })
    }

    /// The cues so far, as the sampler wants them: sums of 1 − SSIM and of |x − y| and the views that see the centre (mh),
    /// sums of the gradient's norm and the iterations that saw the Gaussian (adc), or none.
    pub(super) fn read_cues(&self) -> Result<Vec<Vec<f32>>> {
        let row = |k: usize| self.cues.read(k * self.scene.stride, self.scene.count);
        (0..self.sampler.cue_rows).map(row).collect()
    }

    fn apply(&mut self, outcome: &Outcome) -> Result<()> {
        let before = self.scene.count;
        if outcome.rows > self.scene.stride {
            let (planes, from) = (self.scene.planes(), self.scene.stride);
            let to = Scene::<f32>::grown_stride(outcome.rows);
            for array in [&mut self.scene.params, &mut self.moment1, &mut self.moment2] {
                *array = restride(&self.device, array, planes, from, to)?;
            }
            self.scene.stride = to;
            self.cues = self.sampler.cues(&self.device, to)?;
        } else {
            self.cues.clear()?;
        }
        let rows: Vec<EditRow> = outcome.edits.iter().map(EditRow::from).collect();
        let edits = Array::from_slice(&self.device, "edits", &rows)?;
        self.edit.run(&self.edit_args(&edits))?;
        self.scene.count = outcome.rows;
        if let Some(limit) = outcome.logit_limit {
            let args = self.edit_args(&edits);
            self.edit
                .limit_opacity(&args, outcome.rows, f64::from(limit))?;
        }
        if self.config.work.morton_order || !outcome.removed.is_empty() {
            self.reorder(&outcome.removed)?;
        }
        self.fit_filter()?;
        self.refresh_filter(&self.scene)?;
        self.tally.most_pairs = (self.tally.most_pairs as f64 * self.scene.count as f64
            / before.max(1) as f64) as usize;
        self.fit_views()
    }

    /// Puts the Gaussians in Morton order (if that is wanted), the removed ones (rows, rising) left out: births are appended, wherever they lie.
    fn reorder(&mut self, removed: &[u32]) -> Result<()> {
        let position = |k: usize| self.scene.plane(Plane::POSITION + k);
        let [x, y, z] = [position(0)?, position(1)?, position(2)?];
        let mut order = if self.config.work.morton_order {
            morton::order([&x, &y, &z])
        } else {
            (0..x.len() as u32).collect()
        };
        if !removed.is_empty() {
            order.retain(|row| removed.binary_search(row).is_err());
        }
        self.scene.count = order.len();
        let order = Array::from_slice(&self.device, "order", &order)?;
        self.scene.params = self.reordered(&order, &self.scene.params)?;
        self.moment1 = self.reordered(&order, &self.moment1)?;
        self.moment2 = self.reordered(&order, &self.moment2)?;
        Ok(())
    }

    fn edit_args<'a>(&'a self, edits: &'a Array<EditRow>) -> EditArgs<'a, f32> {
        EditArgs {
            edits,
            stride: self.scene.stride,
            planes: self.scene.planes(),
            params: &self.scene.params,
            moment1: &self.moment1,
            moment2: &self.moment2,
        }
    }
}
