//! What is left out at the end of a run, because the trained scene does not need it.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::{Bands, Trainer};
use crate::buffers::Scene;
use crate::config::TrainConfig;
use crate::error::Result;
use crate::gpu::{Array, Kernels};
use crate::render::RenderOptions;
use crate::stage::loss::size_of_image;
use crate::stage::metrics::Metrics;
use crate::stage::weight::{Weight, WeightArgs, red_image};

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
    /// What views show of each Gaussian: for those that are not seen.
    weight: Option<Arc<Weight>>,
}

impl Judge {
    /// Builds the kernels; `height` is that of the largest view.
    pub(super) fn new(kernels: &Kernels, height: usize, config: &TrainConfig) -> Result<Self> {
        let metrics = || {
            let rows = Array::zeros(kernels.device(), "score", 2 * height)?;
            Ok(Arc::new((Metrics::new::<f32>(kernels)?, rows)))
        };
        let weight = || Ok(Arc::new(Weight::new::<f32>(kernels)?));
        let bands = config.work.sh_by_need && config.sh_degree > 0;
        Ok(Self {
            metrics: bands.then(metrics).transpose()?,
            weight: config.work.remove_unseen.then(weight).transpose()?,
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

    /// Sum of the squared errors of training views of a scene, at the size that they have now.
    pub(super) fn squared_error(
        &mut self,
        (metrics, rows): &(Metrics, Array<f32>),
        scene: &Scene,
        views: &[usize],
    ) -> Result<f64> {
        let mut total = 0.0;
        for (k, &view) in views.iter().enumerate() {
            let photo = self.views.photo(view, &views[k + 1..])?;
            let (camera, factor) = self.camera_at(self.iteration, view);
            let options = self.final_options(scene.sh_degree);
            self.renderer.render(scene, &camera, &options)?;
            let photo = self.shrunk(&photo, view, factor)?;
            let pair = self.pair(view, &camera, photo, options.background)?;
            metrics.run(&pair, rows)?;
            let sums = rows.read(0, pair.size[1])?;
            total += sums.into_iter().map(f64::from).sum::<f64>();
        }
        Ok(total)
    }

    /// How views are rendered to be judged: over the background that does not change.
    pub(super) fn final_options(&self, sh_degree: u32) -> RenderOptions {
        RenderOptions {
            background: self.schedule.fixed_background(),
            ..self.options(self.iteration, sh_degree)
        }
    }

    /// The most that any training view shows of each Gaussian: the sum of α·T over its pixels.
    fn weights(&mut self, weight: &Weight) -> Result<Vec<f32>> {
        let count = self.scene.count;
        let most = Array::zeros(&self.device, "weights", count)?;
        let options = self.final_options(self.scene.sh_degree);
        for camera in self.views.cameras.clone() {
            self.renderer.render(&self.scene, &camera, &options)?;
            let frame = &self.renderer.frame;
            self.dimage.write(0, &red_image(size_of_image(&camera)))?;
            self.splat_grad
                .run(&self.renderer.lists(&camera), &self.dimage, &frame.sums)?;
            weight.run(&WeightArgs {
                count,
                pair_start: &frame.pair_start,
                pair_counts: &frame.pair_counts,
                sums: &frame.sums,
                most: &most,
            })?;
        }
        most.read(0, count)
    }

    /// Removes the Gaussians that no pixel of any training view shows: behind, beyond, below the cut or hidden in all of them.
    /// What is left renders every training view to the same bit.
    fn remove_unseen(&mut self) -> Result<()> {
        let Some(weight) = self.judge.weight.clone() else {
            return Ok(());
        };
        let weights = self.weights(&weight)?;
        let kept: Vec<u32> = (0..weights.len() as u32)
            .filter(|&i| weights[i as usize] > 0.0)
            .collect();
        let removed = (weights.len() - kept.len()) as u64;
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
