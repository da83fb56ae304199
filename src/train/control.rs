//! The density step: error cues from the device, decisions on the host, edits back to the device.

use super::Trainer;
use crate::buffers::{Scene, restride};
use crate::density::{Cues, DensityStats, Outcome, SceneState, StepContext};
use crate::error::Result;
use crate::gpu::tuning::status;
use crate::gpu::{Array, EditRow};
use crate::model::{Plane, morton};
use crate::render::RenderOptions;
use crate::stage::edit::EditArgs;
use crate::stage::importance::ImportanceArgs;

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
    /// Renders a view and writes its error maps; `next` are the views to follow.
    pub(super) fn error_maps(&mut self, view: usize, next: &[usize]) -> Result<()> {
        let photo = self.views.photo(view, next)?;
        let degree = self.schedule.sh_degree(self.iteration);
        let background = self.schedule.fixed_background();
        let options = RenderOptions {
            background,
            ..self.options(0, degree)
        };
        self.renderer
            .enqueue(&self.scene, &self.views.cameras[view], &options)?;
        self.loss.errors(
            &self.pair(view, &photo, background),
            &self.maps,
            &self.partial,
        )
    }

    pub(super) fn accumulate(
        &self,
        view: usize,
        first_view: bool,
        cues: &[Array<f32>; 2],
        seen: &Array<u32>,
    ) -> Result<()> {
        self.importance.run(&ImportanceArgs {
            params: &self.scene.params,
            stride: self.scene.stride,
            count: self.scene.count,
            camera: &self.views.cameras[view],
            maps: &self.maps,
            first_view,
            ssim: &cues[0],
            l1: &cues[1],
            views: seen,
        })
    }

    /// Error cues of every Gaussian over a subset of the views: sums of 1 − SSIM and L1, views that see it.
    fn cues(&mut self, subset: &[usize]) -> Result<(Vec<f32>, Vec<f32>, Vec<u32>)> {
        let n = self.scene.count;
        let cues = [
            Array::zeros(&self.device, "cue 1-SSIM", n)?,
            Array::zeros(&self.device, "cue L1", n)?,
        ];
        let seen = Array::zeros(&self.device, "cue views", n)?;
        let mut next = 0;
        while next < subset.len() {
            self.error_maps(subset[next], &subset[next + 1..])?;
            // A blocking look at the counters: a view that did not fit must not be counted.
            let counters = self.renderer.frame.status.to_vec()?;
            self.most_pairs = self
                .most_pairs
                .max(counters[status::PAIRS as usize] as usize);
            let needed = counters[status::OVERFLOW as usize];
            if needed > 0 {
                self.renderer.grow_pairs(needed)?;
                continue;
            }
            self.accumulate(subset[next], next == 0, &cues, &seen)?;
            next += 1;
        }
        self.device.collect_times(usize::MAX)?;
        Ok((cues[0].to_vec()?, cues[1].to_vec()?, seen.to_vec()?))
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
        self.last_density = Some(self.iteration);
        let subset = self.density.view_subset(self.views.len(), progress);
        if subset.is_empty() {
            return Ok(None);
        }
        let (ssim, l1, views) = self.cues(&subset)?;
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
        let context = StepContext {
            iteration: self.iteration,
            progress,
            seed: self.config.seed,
            max_gaussians: self.config.max_gaussians,
        };
        let cues = Cues {
            ssim: &ssim,
            l1: &l1,
            views: &views,
        };
        let outcome = self.density.step(&context, &state, &cues)?;
        self.apply(&outcome)?;
        self.stats.add(&outcome.stats);
        Ok(Some(DensityEvent {
            iteration: self.iteration,
            progress,
            gaussians: self.scene.count,
            stats: outcome.stats,
        }))
    }

    fn apply(&mut self, outcome: &Outcome) -> Result<()> {
        let before = self.scene.count;
        if outcome.len > self.scene.stride {
            let (planes, from) = (self.scene.planes(), self.scene.stride);
            let to = Scene::<f32>::grown_stride(outcome.len);
            for array in [&mut self.scene.params, &mut self.moment1, &mut self.moment2] {
                *array = restride(&self.device, array, planes, from, to)?;
            }
            self.scene.stride = to;
        }
        let rows: Vec<EditRow> = outcome
            .edits
            .iter()
            .map(|e| EditRow {
                src: e.src,
                dst: e.dst,
                position: e.position,
                log_scale: e.log_scale,
                opacity_logit: e.opacity_logit,
            })
            .collect();
        self.apply_edits(&Array::from_slice(&self.device, "edits", &rows)?)?;
        self.scene.count = outcome.len;
        self.reorder()?;
        self.most_pairs =
            (self.most_pairs as f64 * outcome.len as f64 / before.max(1) as f64) as usize;
        self.fit_views()
    }

    /// Puts the Gaussians in Morton order: births are appended, wherever they lie.
    fn reorder(&mut self) -> Result<()> {
        let position = |k: usize| self.scene.plane(Plane::POSITION + k);
        let [x, y, z] = [position(0)?, position(1)?, position(2)?];
        let order = Array::from_slice(&self.device, "order", &morton::order([&x, &y, &z]))?;
        let shape = [self.scene.planes(), self.scene.stride];
        for array in [&mut self.scene.params, &mut self.moment1, &mut self.moment2] {
            let to = Array::zeros(&self.device, array.name(), shape[0] * shape[1])?;
            self.edit.reorder(&order, shape, array, &to)?;
            *array = to;
        }
        Ok(())
    }

    pub(super) fn apply_edits(&self, edits: &Array<EditRow>) -> Result<()> {
        self.edit.run(&EditArgs {
            edits,
            stride: self.scene.stride,
            planes: self.scene.planes(),
            params: &self.scene.params,
            moment1: &self.moment1,
            moment2: &self.moment2,
        })
    }
}
