//! What happens before the first iteration: every kernel is built and run once.

use crate::base::error::Result;
use crate::density::Wanted;
use crate::device::tuning::status;
use crate::device::{Array, Defines, Device, Kernels};
use crate::pipeline::buffers::Scene;
use crate::pipeline::stage::loss::size_of_image;
use crate::pipeline::stage::project_grad::ProjectGrad;
use crate::scene::{Edit, Splats};
use crate::train::Trainer;

/// One build of the stage for every SH degree that training passes through.
pub(super) fn project_grad_per_degree(
    device: &Device,
    defines: Defines,
    highest: u32,
) -> Result<Vec<ProjectGrad>> {
    (0..=highest)
        .map(|sh_degree| {
            ProjectGrad::new::<f32>(&Kernels::new(
                device,
                Defines {
                    sh_degree,
                    ..defines
                },
            ))
        })
        .collect()
}

impl Trainer {
    /// Runs every kernel once on no Gaussians, for every SH degree, and sizes the pair arrays by rendering each view.
    pub(super) fn warm_up(&mut self) -> Result<()> {
        let most = self.config.sh_degree;
        let mut nothing = Scene::upload(&self.device, &Splats::zeros(most, 0), 0)?;
        if self.filter.is_some() {
            nothing = nothing.with_filter(&self.device)?;
        }
        let state = |name| Array::zeros(&self.device, name, nothing.planes() * nothing.stride);
        let moments = [state("moment1")?, state("moment2")?];
        let scene = std::mem::replace(&mut self.scene, nothing);
        let [first, second] = moments;
        let kept = [
            std::mem::replace(&mut self.moment1, first),
            std::mem::replace(&mut self.moment2, second),
        ];
        self.fit_views()?;
        for degree in 0..=most {
            self.enqueue_step(0, degree)?;
            self.warm_up_probes(degree)?;
        }
        self.warm_up_rest()?;
        self.scene = scene;
        [self.moment1, self.moment2] = kept;
        self.fit_views()?;
        self.refresh_filter(&self.scene)?;
        for v in 0..self.views.len() {
            let options = self.options(0, 0);
            self.renderer
                .render(&self.scene, &self.views.cameras[v], &options)?;
            let pairs = self.renderer.frame.status.read(status::PAIRS as usize, 1)?[0];
            self.tally.most_pairs = self.tally.most_pairs.max(pairs as usize);
        }
        self.fit_views()?;
        self.device.finish()?;
        self.device.collect_times(usize::MAX)?;
        self.device.reset_times();
        Ok(())
    }

    /// Kernels that do not run in every iteration.
    fn warm_up_rest(&mut self) -> Result<()> {
        let photo = self.views.photo(0, &[])?;
        let camera = self.views.cameras[0];
        if let Wanted::Errors { .. } = self.density.wanted(1, 1.0) {
            let pair = self.pair(0, &camera, &photo, self.schedule.fixed_background())?;
            self.add_cues(&camera, &pair, true)?;
        }
        if let Some(judge) = self.judge.metrics.clone() {
            let pair = self.pair(0, &camera, &photo, self.schedule.fixed_background())?;
            judge.0.run(&pair, &judge.1)?;
        }
        self.seen(0..1)?;
        self.warm_up_edits()?;
        let size = size_of_image(&camera);
        match &self.shrink {
            Some(shrink) if size.iter().all(|s| *s > 1) => shrink.run(&photo, size, 2, &self.small),
            _ => Ok(()),
        }
    }

    /// The edit kernels write where they are told to, so they get planes of their own.
    fn warm_up_edits(&self) -> Result<()> {
        let (planes, stride) = (self.scene.planes(), 16);
        let scratch = || Array::<f32>::zeros(&self.device, "scratch", planes * stride);
        let scene = Scene {
            params: scratch()?,
            filter: Array::zeros(&self.device, "filter", 0)?,
            stride,
            count: 1,
            sh_degree: self.scene.sh_degree,
        };
        let moments = [&scratch()?, &scratch()?];
        let edits = Array::from_slice(&self.device, "edits", &[Edit::default()])?;
        self.edit.run(&scene, moments, &edits)?;
        self.edit.limit_opacity(&scene, moments, 0.0)?;
        let order = Array::from_slice(&self.device, "order", &[0u32])?;
        self.edit
            .reorder(&order, [planes, stride], &scene.params, moments[0])
    }
}
