//! [`Estimates`]: first-order estimates of births, before they are decided on.
//!
//! A birth with ε times its opacity leaves the image as it is. The derivative of the loss with respect to its opacity says what
//! the birth would do to the loss, to first order, and one more render and backward pass per view says it for all births
//! together. They are rendered with ε times the alpha cut, so that each covers just the pixels that its birth would; dL/dC is
//! that of the ordinary render.

use std::time::Instant;

use crate::base::error::Result;
use crate::base::math::sigmoid;
use crate::density::{DensityControl, Edit};
use crate::device::{Array, Defines, Device, Program, StageTime};
use crate::pipeline::backward::{Backward, GRADIENT_ROWS};
use crate::pipeline::buffers::GaussianBuffers;
use crate::pipeline::forward::{Quantity, RenderOptions, Renderer};
use crate::pipeline::pass::Pipeline;
use crate::pipeline::room::restride;
use crate::pipeline::stage::edit;
use crate::pipeline::stage::loss::Beside;
use crate::scene::{self, Plane};
use crate::train::gaussians::GaussianState;
use crate::train::smoothing::Smoothing;
use crate::train::views::Views;

/// ε in double precision: thousands of estimates on one ray take less than a hundredth of its light.
pub const EPSILON_DOUBLE: f64 = 1e-6;
/// ε in single precision, where a smaller one would vanish beside the transmittance.
pub const EPSILON_SINGLE: f64 = 1e-4;

/// The logit of `factor` times the opacity of a logit.
#[must_use]
pub fn scaled_logit(logit: f64, factor: f64) -> f64 {
    if factor == 1.0 {
        return logit;
    }
    let o = factor * sigmoid(logit);
    o.ln() - (-o).ln_1p()
}

/// First-order estimate of a birth of this opacity logit, from the derivative with respect to the logit of its faint copy.
#[must_use]
pub fn change(slope: f64, logit: f64, epsilon: f64) -> f64 {
    // dL/dlogit = (1 − o)·o·dL/do at o = ε·o_c; the change by o_c is o_c·dL/do.
    slope / (sigmoid(-scaled_logit(logit, epsilon)) * epsilon)
}

/// Forward and backward stages with an alpha cut of their own.
#[derive(Debug)]
pub struct FaintPass<R: crate::device::Real> {
    /// Forward stages.
    pub forward: Renderer<R>,
    /// Backward stages.
    pub backward: Backward,
}

impl<R: crate::device::Real> FaintPass<R> {
    /// Builds the stages for contributions from `alpha_min` on; gradients of parameters share `pipeline`'s kernels.
    pub fn new(
        device: &Device,
        defines: Defines,
        sh_degree: u32,
        alpha_min: f64,
        pipeline: &Pipeline<R>,
    ) -> Result<Self> {
        let defines = Defines {
            alpha_min,
            ..defines
        };
        Ok(Self {
            forward: Renderer::new(device, defines, sh_degree, true)?,
            backward: pipeline.backward.with_cut::<R>(device, defines)?,
        })
    }
}

/// Everything that an estimate takes of a trainer.
#[derive(Debug)]
pub struct Context<'a> {
    /// Device.
    pub device: &'a Device,
    /// Pipeline of training.
    pub pipeline: &'a mut Pipeline,
    /// Gaussians as they are.
    pub gaussians: &'a GaussianState,
    /// Training views.
    pub views: &'a Views,
    /// Smoothing filter, if there is one.
    pub smoothing: Option<&'a Smoothing>,
    /// Kernels of `edit.cl`, which write rows.
    pub edit: &'a Program,
    /// λ of the loss.
    pub lambda_ssim: f64,
    /// Iterations done.
    pub iteration: u32,
}

/// Renders faint births and differentiates with respect to them.
#[derive(Debug)]
pub struct Estimates {
    pass: FaintPass<f32>,
    /// Views in which births are estimated.
    views: usize,
    /// Time on host and device.
    pub time: StageTime,
}

impl Estimates {
    /// Builds the stages if this density control asks for estimates.
    pub fn new(
        device: &Device,
        defines: Defines,
        sh_degree: u32,
        pipeline: &Pipeline,
        density: &dyn DensityControl,
    ) -> Result<Option<Self>> {
        let views = density.estimate_views();
        if views == 0 {
            return Ok(None);
        }
        let alpha_min = defines.alpha_min * EPSILON_SINGLE;
        Ok(Some(Self {
            pass: FaintPass::new(device, defines, sh_degree, alpha_min, pipeline)?,
            views,
            time: StageTime::default(),
        }))
    }

    /// First-order estimate of each birth: the change of the loss, mean over the views that training takes next, at the size
    /// that they have now; NaN if none of them sees it. The scene is taken as it is, before the step's relocations and removals.
    pub fn changes(&mut self, mut at: Context<'_>, births: &[Edit]) -> Result<Vec<f64>> {
        if births.is_empty() {
            return Ok(Vec::new());
        }
        let began = Instant::now();
        at.device.finish()?;
        let before = at.device.launches();
        let changes = self.over_views(&mut at, births);
        // Counted as `probe`, not as the stages that an estimate passes.
        at.device.forget_launches(before);
        self.time.seconds += began.elapsed().as_secs_f64();
        self.time.calls += 1;
        changes
    }

    /// Runs every kernel once on no Gaussians.
    pub fn warm_up(&mut self, mut at: Context<'_>, sh_degree: u32) -> Result<()> {
        let scene = at.with_faint(&[])?;
        self.in_view(&mut at, &scene, [0, 0], sh_degree)?;
        Ok(())
    }

    fn over_views(&mut self, at: &mut Context<'_>, births: &[Edit]) -> Result<Vec<f64>> {
        let scene = at.with_faint(births)?;
        let n = at.gaussians.scene.count;
        let first = n / GRADIENT_ROWS * GRADIENT_ROWS;
        let count = self.views.min(at.views.len());
        let views = at.views.upcoming(at.iteration, count);
        let degree = at.gaussians.scene.sh_degree;
        let mut changes = vec![f64::NAN; births.len()];
        for (background_of, view) in (at.iteration..).zip(&views) {
            let number = [background_of as usize, *view];
            let slopes = self.in_view(at, &scene, number, degree)?;
            let touched = self.pass.forward.intersected(n)?;
            for (k, (sum, birth)) in changes.iter_mut().zip(births).enumerate() {
                let logit = f64::from(birth.opacity_logit);
                let here = change(slopes[n - first + k], logit, EPSILON_SINGLE);
                if touched[k] {
                    *sum = here + if sum.is_nan() { 0.0 } else { *sum };
                }
            }
        }
        Ok(changes.iter().map(|c| c / views.len() as f64).collect())
    }

    /// Derivatives with respect to the opacity logits in one view, with the faint cut, of the rows from the last whole 16 of the scene on.
    fn in_view(
        &mut self,
        at: &mut Context<'_>,
        faint: &GaussianBuffers,
        [background_of, number]: [usize; 2],
        sh_degree: u32,
    ) -> Result<Vec<f64>> {
        let view = at
            .views
            .view(at.iteration, background_of as u32, number, &[])?;
        let options = RenderOptions {
            sh_degree,
            background: view.background,
            quantity: Quantity::Color,
            active_only: false,
        };
        let (scene, camera) = (&at.gaussians.scene, &view.camera);
        at.pipeline.forward.render(scene, camera, &options)?;
        let pair = at.pipeline.pair(at.views.target(&view))?;
        let pair = pair.everywhere();
        at.pipeline
            .loss_gradient(view.number, &pair, at.lambda_ssim, Beside::NOTHING)?;
        let (dimage, degree) = (at.pipeline.image_gradient(), sh_degree as usize);
        self.pass.forward.render(faint, camera, &options)?;
        let first = scene.count / GRADIENT_ROWS * GRADIENT_ROWS;
        let forward = &self.pass.forward;
        let [slopes] = self.pass.backward.plane_gradients(
            forward,
            faint,
            dimage,
            [first, degree],
            [Plane::OPACITY],
        )?;
        Ok(slopes)
    }
}

impl Context<'_> {
    /// A copy of the scene with a faint copy of every birth after its rows: training's own arrays are left alone.
    fn with_faint(&self, births: &[Edit]) -> Result<GaussianBuffers> {
        let (old, device) = (&self.gaussians.scene, self.device);
        let n = old.count;
        let (planes, from) = (old.planes(), old.stride);
        let stride = GaussianBuffers::<f32>::grown_stride(n + births.len()).max(from);
        let smoothed = self.smoothing.map_or(0, |_| stride);
        let copy = GaussianBuffers {
            params: restride(device, &old.params, planes, from, stride)?,
            filter: Array::zeros(device, "filter", smoothed)?,
            stride,
            count: n + births.len(),
            sh_degree: old.sh_degree,
            shard: None,
        };
        let faint = |(k, birth): (usize, &Edit)| {
            let logit = f64::from(birth.opacity_logit);
            scene::Edit {
                dst: (n + k) as u32,
                opacity_logit: scaled_logit(logit, EPSILON_SINGLE) as f32,
                ..*birth
            }
        };
        let rows: Vec<scene::Edit> = births.iter().enumerate().map(faint).collect();
        let rows = Array::from_slice(device, "estimated rows", &rows)?;
        // The stage clears moments, which these rows do not have.
        let moments = Array::zeros(device, "no moments", planes * stride)?;
        edit::write_rows(self.edit, &copy, [&moments; 2], &rows)?;
        if let Some(smoothing) = self.smoothing {
            smoothing.run(&copy, &self.pipeline.forward.frame, None)?;
        }
        Ok(copy)
    }
}
