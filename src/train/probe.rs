//! Births tried before they are decided on: what each would do to the loss, to first order (see [`crate::pipeline::backward`]).

use std::time::Instant;

use crate::base::error::Result;
use crate::density::{DensityControl, Edit, Trial};
use crate::device::{Array, Defines, Device};
use crate::pipeline::backward::{Backward, EPSILON_SINGLE, Pass, ROUND, change, scaled_logit};
use crate::pipeline::buffers::{Scene, restride};
use crate::pipeline::forward::RenderOptions;
use crate::train::Trainer;

/// What renders probes, if this density control tries births.
pub(super) fn pass(
    device: &Device,
    defines: Defines,
    sh_degree: u32,
    density: &dyn DensityControl,
) -> Result<Option<Pass<f32>>> {
    (density.trial_views() > 0)
        .then(|| {
            let alpha_min = defines.alpha_min * EPSILON_SINGLE;
            Pass::new(device, defines, sh_degree, alpha_min)
        })
        .transpose()
}

impl Trainer {
    /// First-order change of the loss by each birth, mean over the views that training takes next, at the size that they
    /// have now; NaN where none of them sees it. The scene is taken as it is, before the step's relocations.
    ///
    /// # Errors
    /// More than the device can allocate, or the driver's.
    #[doc(hidden)]
    pub fn probe(&mut self, trials: &[Trial]) -> Result<Vec<f64>> {
        if trials.is_empty() {
            return Ok(Vec::new());
        }
        let Some(mut pass) = self.probes.take() else {
            return Ok(Vec::new());
        };
        let began = Instant::now();
        self.device.finish()?;
        self.device.collect_times(usize::MAX)?;
        let changes = self.probe_with(&mut pass, trials);
        self.probes = Some(pass);
        // Counted as `probe`, not as the stages that a probe passes.
        self.device.forget_launches();
        self.tally.probe_time.seconds += began.elapsed().as_secs_f64();
        self.tally.probe_time.calls += 1;
        changes
    }

    /// Runs every kernel of a probe once on no Gaussians, if there are probes.
    pub(super) fn warm_up_probes(&mut self, degree: u32) -> Result<()> {
        if let Some(mut pass) = self.probes.take() {
            let scene = self.with_probes(&[])?;
            let options = self.options(0, degree);
            self.probe_view(&mut pass, &scene, 0, &options, true)?;
            self.probes = Some(pass);
        }
        Ok(())
    }

    fn probe_with(&mut self, pass: &mut Pass<f32>, trials: &[Trial]) -> Result<Vec<f64>> {
        let scene = self.with_probes(trials)?;
        let n = self.scene.count;
        let shared = trials.iter().any(|t| t.source_change.is_some());
        let first = n / ROUND * ROUND;
        let count = self.density.trial_views().min(self.views.len());
        let views = self.upcoming(self.iteration, count);
        let degree = self.scene.sh_degree as usize;
        let mut changes = vec![f64::NAN; trials.len()];
        for (at, view) in (self.iteration..).zip(&views) {
            let options = self.options(at, degree as u32);
            let [probes, sources] = self.probe_view(pass, &scene, *view, &options, shared)?;
            let touched = pass.touched(n, scene.count)?;
            for (k, (sum, trial)) in changes.iter_mut().zip(trials).enumerate() {
                let logit = f64::from(trial.birth.opacity_logit);
                let mut here = change(probes[0][n - first + k], logit, EPSILON_SINGLE);
                if let Some(source) = trial.source_change {
                    let at = trial.birth.src as usize;
                    here += (0..4).map(|g| source[g] * sources[g][at]).sum::<f64>();
                }
                if touched[k] || here != 0.0 {
                    *sum = here + if sum.is_nan() { 0.0 } else { *sum };
                }
            }
        }
        Ok(changes.iter().map(|c| c / views.len() as f64).collect())
    }

    /// A copy of the scene with a probe of every birth after its rows: training's own arrays are left alone.
    fn with_probes(&self, trials: &[Trial]) -> Result<Scene> {
        let n = self.scene.count;
        let (planes, from) = (self.scene.planes(), self.scene.stride);
        let stride = Scene::<f32>::grown_stride(n + trials.len()).max(from);
        let scene = Scene {
            params: restride(&self.device, &self.scene.params, planes, from, stride)?,
            filter: Array::zeros(
                &self.device,
                "filter",
                self.filter.as_ref().map_or(0, |_| stride),
            )?,
            stride,
            count: n + trials.len(),
            sh_degree: self.scene.sh_degree,
        };
        let faint = |(k, t): (usize, &Trial)| {
            let logit = f64::from(t.birth.opacity_logit);
            Edit {
                dst: (n + k) as u32,
                opacity_logit: scaled_logit(logit, EPSILON_SINGLE) as f32,
                ..t.birth
            }
        };
        let rows: Vec<Edit> = trials.iter().enumerate().map(faint).collect();
        let rows = Array::from_slice(&self.device, "probes", &rows)?;
        // The stage clears moments, which probes do not have.
        let moments = Array::zeros(&self.device, "no moments", planes * stride)?;
        self.edit.run(&scene, [&moments; 2], &rows)?;
        self.refresh_filter(&scene)?;
        Ok(scene)
    }

    /// Derivatives by opacity logit and log-scales in one view: of the rows from the last whole 16 of the scene on, with the
    /// probes' cut, and of the scene's own, if `shared`, with the ordinary one. dL/dC is that of the ordinary render.
    fn probe_view(
        &mut self,
        pass: &mut Pass<f32>,
        scene: &Scene,
        view: usize,
        options: &RenderOptions,
        shared: bool,
    ) -> Result<[[Vec<f64>; 4]; 2]> {
        let photo = self.views.photo(view, &[])?;
        let (camera, factor) = self.camera_at(self.iteration, view);
        self.renderer.render(&self.scene, &camera, options)?;
        let photo = self.shrunk(&photo, view, factor)?;
        let pair = self.pair(view, &camera, photo, options.background)?;
        self.loss_gradient(view, &pair)?;
        let (project_grad, dimage) = (&self.project_grad[options.sh_degree as usize], &self.dimage);
        let sources = if shared {
            let backward = Backward {
                device: &self.device,
                renderer: &self.renderer,
                splat_grad: &self.splat_grad,
                project_grad,
            };
            backward.gradients(&self.scene, &camera, dimage, 0)?
        } else {
            Default::default()
        };
        pass.render(scene, &camera, options)?;
        let first = self.scene.count / ROUND * ROUND;
        let probes = pass
            .backward(project_grad)
            .gradients(scene, &camera, dimage, first)?;
        Ok([probes, sources])
    }
}
