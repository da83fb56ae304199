//! What is left out at the end of a run, because the trained scene does not need it.

use std::ops::Range;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::base::error::Result;
use crate::config::TrainConfig;
use crate::device::{Array, Kernels};
use crate::pipeline::forward::RenderOptions;
use crate::pipeline::stage::loss::ImagePair;
use crate::pipeline::stage::metrics::Metrics;
use crate::pipeline::stage::seen::Seen;
use crate::train::Trainer;
use crate::train::bands::Bands;

/// What training has found out about its scene.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Findings {
    /// Bands of spherical harmonics.
    pub bands: Bands,
    /// Gaussians removed at the end, because no training view shows them.
    pub removed: u64,
    /// Iteration after which the run was finished; a run that goes on from there is finished again.
    pub finished: Option<u32>,
}

/// Stages that judge the scene by the training views, each where the configuration asks for what it decides.
#[derive(Debug, Clone)]
pub(super) struct Judge {
    /// Errors of views, and the row sums that they are added up from: for bands.
    pub(super) metrics: Option<Arc<(Metrics, Array<f32>)>>,
    /// Which Gaussians views show.
    seen: Option<Arc<Seen>>,
}

impl Judge {
    /// Builds the kernels; `height` is that of the largest view.
    pub(super) fn new(kernels: &Kernels, height: usize, config: &TrainConfig) -> Result<Self> {
        let metrics = || {
            let rows = Array::zeros(kernels.device(), "score", 2 * height)?;
            Ok(Arc::new((Metrics::new::<f32>(kernels)?, rows)))
        };
        let seen = || Ok(Arc::new(Seen::new::<f32>(kernels)?));
        let bands = config.work.sh_by_need && config.sh_degree > 0;
        Ok(Self {
            metrics: bands.then(metrics).transpose()?,
            seen: config.work.remove_unseen.then(seen).transpose()?,
        })
    }
}

impl Trainer {
    /// Ends the run: bands and Gaussians that the training views do not miss are left out, if the configuration says so.
    /// Once per run.
    ///
    /// # Errors
    /// More than the device can allocate, or the driver's.
    pub fn finish(&mut self) -> Result<()> {
        self.settle()?;
        if self.findings.finished == Some(self.iteration) {
            return Ok(());
        }
        self.drop_bands()?;
        self.findings.removed = 0;
        self.remove_unseen()?;
        self.findings.finished = Some(self.iteration);
        self.fit_views()
    }

    /// What training has found out about its scene so far.
    #[must_use]
    pub fn findings(&self) -> &Findings {
        &self.findings
    }

    /// Something of the renders and photos of training views, in their order, at the size that they have now; `next` are
    /// those that come after them.
    pub(super) fn over_views(
        &mut self,
        views: &[usize],
        next: &[usize],
        of: impl Fn(&Self, &ImagePair<'_, f32>) -> Result<f64>,
    ) -> Result<Vec<f64>> {
        let mut all = Vec::with_capacity(views.len());
        let order = [views, next].concat();
        for (k, &view) in views.iter().enumerate() {
            let photo = self.views.photo(view, &order[k + 1..])?;
            let (camera, factor) = self.camera_at(self.iteration, view);
            let options = self.final_options(self.scene.sh_degree);
            self.renderer.render(&self.scene, &camera, &options)?;
            let photo = self.shrunk(&photo, view, factor)?;
            let pair = self.pair(view, &camera, photo, options.background)?;
            all.push(of(self, &pair)?);
        }
        Ok(all)
    }

    /// How views are rendered to be judged: over the background that does not change.
    pub(super) fn final_options(&self, sh_degree: u32) -> RenderOptions {
        RenderOptions {
            background: self.schedule.fixed_background(),
            ..self.options(self.iteration, sh_degree)
        }
    }

    /// Which Gaussians some training views show, 1 or 0; none where nobody asks.
    pub(super) fn seen(&mut self, views: Range<usize>) -> Result<Option<Vec<u32>>> {
        let (count, Some(stage)) = (self.scene.count, self.judge.seen.clone()) else {
            return Ok(None);
        };
        let seen = Array::zeros(&self.device, "seen", count)?;
        let mut shown = Array::zeros(&self.device, "shown", 0)?;
        let options = self.final_options(self.scene.sh_degree);
        for camera in &self.views.cameras[views] {
            self.renderer.pair(&self.scene, camera, &options)?;
            let frame = &self.renderer.frame;
            if shown.len() < frame.pair_capacity() {
                shown = Array::zeros(&self.device, "shown", frame.pair_capacity())?;
            }
            stage.run(frame, camera, &shown, &seen)?;
        }
        seen.to_vec().map(Some)
    }

    /// Removes the Gaussians that no pixel of any training view shows: behind, beyond, below the cut or hidden in all of them.
    /// What is left renders every training view to the same bit.
    fn remove_unseen(&mut self) -> Result<()> {
        let Some(seen) = self.seen(0..self.views.len())? else {
            return Ok(());
        };
        let kept: Vec<u32> = (0..seen.len() as u32)
            .filter(|&i| seen[i as usize] != 0)
            .collect();
        let removed = (seen.len() - kept.len()) as u64;
        if removed > 0 && !kept.is_empty() {
            let order = Array::from_slice(&self.device, "order", &kept)?;
            self.scene.params = self.reordered(&order, &self.scene.params)?;
            self.moment1 = self.reordered(&order, &self.moment1)?;
            self.moment2 = self.reordered(&order, &self.moment2)?;
            if !self.scene.filter.is_empty() {
                self.scene.filter = self.reordered_planes(&order, &self.scene.filter, 1)?;
            }
            if !self.cues.is_empty() {
                let rows = self.sampler.cue_rows;
                self.cues = self.reordered_planes(&order, &self.cues, rows)?;
            }
            self.scene.count = kept.len();
            self.findings.removed = removed;
        }
        Ok(())
    }

    /// The rows of `order` of an array of the scene's shape.
    pub(super) fn reordered(&self, order: &Array<u32>, from: &Array<f32>) -> Result<Array<f32>> {
        self.reordered_planes(order, from, self.scene.planes())
    }

    fn reordered_planes(
        &self,
        order: &Array<u32>,
        from: &Array<f32>,
        planes: usize,
    ) -> Result<Array<f32>> {
        let to = Array::zeros(&self.device, from.name(), planes * self.scene.stride)?;
        self.edit
            .reorder(order, [planes, self.scene.stride], from, &to)?;
        Ok(to)
    }
}
