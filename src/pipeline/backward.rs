//! Probes: births so faint that the image is as without them. The derivative of the loss by the opacity of one is what it
//! would do to the loss, to first order, and one more render and backward pass per view tells it for all of them together.
//!
//! A probe has ε times the opacity of its birth and is rendered with ε times the cut, so that it covers just the pixels that
//! the birth would; dL/dC is that of the ordinary render.

use crate::base::error::Result;
use crate::base::math::sigmoid;
use crate::device::{Array, CameraArg, Defines, Device, Kernels, Real};
use crate::pipeline::buffers::Scene;
use crate::pipeline::forward::{RenderOptions, Renderer};
use crate::pipeline::stage::project_grad::{ProjectGrad, ProjectGradArgs};
use crate::pipeline::stage::splat_grad::SplatGrad;
use crate::scene::Plane;

/// ε in double precision: thousands of probes on one ray take less than a hundredth of its light.
pub(crate) const EPSILON_DOUBLE: f64 = 1e-6;
/// ε in single precision, where a smaller one would vanish beside the transmittance.
pub(crate) const EPSILON_SINGLE: f64 = 1e-4;

/// Rows of gradients start at multiples of this.
pub(crate) const ROUND: usize = 16;

/// Forward and backward through the same views with a cut of its own.
#[derive(Debug)]
pub(crate) struct Pass<R: Real> {
    device: Device,
    pub(crate) renderer: Renderer<R>,
    splat_grad: SplatGrad,
}

impl<R: Real> Pass<R> {
    /// Builds the kernels for SH degrees 0 to `sh_degree`; contributions below `alpha_min` are dropped.
    ///
    /// # Errors
    /// A build failure.
    pub(crate) fn new(
        device: &Device,
        defines: Defines,
        sh_degree: u32,
        alpha_min: f64,
    ) -> Result<Self> {
        let defines = Defines {
            alpha_min,
            ..defines
        };
        Ok(Self {
            device: device.clone(),
            renderer: Renderer::new(device, defines, sh_degree, true)?,
            splat_grad: SplatGrad::new::<R>(&Kernels::new(device, defines))?,
        })
    }

    /// Renders and waits.
    ///
    /// # Errors
    /// As [`Renderer::render`].
    pub(crate) fn render(
        &mut self,
        scene: &Scene<R>,
        camera: &CameraArg<R>,
        options: &RenderOptions,
    ) -> Result<()> {
        self.renderer.render(scene, camera, options)
    }

    /// What goes back through the view rendered last.
    pub(crate) fn backward<'a>(&'a self, project_grad: &'a ProjectGrad) -> Backward<'a, R> {
        Backward {
            device: &self.device,
            renderer: &self.renderer,
            splat_grad: &self.splat_grad,
            project_grad,
        }
    }

    /// Whether the view rendered last has any pair of each row from `first` to `count`.
    ///
    /// # Errors
    /// The driver's.
    pub(crate) fn touched(&self, first: usize, count: usize) -> Result<Vec<bool>> {
        let pairs = &self.renderer.frame.pair_counts;
        let pairs = pairs.read(first, count - first)?;
        Ok(pairs.into_iter().map(|n| n > 0).collect())
    }
}

/// The backward stages after a render.
#[derive(Debug)]
pub(crate) struct Backward<'a, R: Real> {
    pub(crate) device: &'a Device,
    pub(crate) renderer: &'a Renderer<R>,
    pub(crate) splat_grad: &'a SplatGrad,
    pub(crate) project_grad: &'a ProjectGrad,
}

impl<R: Real> Backward<'_, R> {
    /// Derivatives of the loss by opacity logit and the three log-scales of the rows of the scene rendered last from `first`
    /// (a multiple of 16) on.
    ///
    /// # Errors
    /// More than the device can allocate, or the driver's.
    pub(crate) fn gradients(
        &self,
        scene: &Scene<R>,
        camera: &CameraArg<R>,
        dimage: &Array<R>,
        first: usize,
    ) -> Result<[Vec<f64>; 4]> {
        let frame = &self.renderer.frame;
        self.splat_grad
            .run(&self.renderer.lists(camera), dimage, &frame.sums)?;
        let count = scene.count;
        let rows = (count - first).next_multiple_of(ROUND);
        let grads = Array::zeros(self.device, "grads", scene.planes() * rows)?;
        self.project_grad.run(&ProjectGradArgs {
            params: &scene.params,
            stride: scene.stride,
            count,
            filter: &scene.filter,
            camera,
            pair_start: &frame.pair_start,
            pair_counts: &frame.pair_counts,
            status: &frame.status,
            sums: &frame.sums,
            lambda_opacity: 0.0,
            lambda_scale: 0.0,
            block: first..count,
            grad_stride: rows,
            grads: &grads,
        })?;
        let plane = |p: usize| -> Result<Vec<f64>> {
            let values = grads.read(p * rows, count - first)?;
            Ok(values.into_iter().map(Into::into).collect())
        };
        let scale = Plane::LOG_SCALE;
        Ok([
            plane(Plane::OPACITY)?,
            plane(scale)?,
            plane(scale + 1)?,
            plane(scale + 2)?,
        ])
    }
}

/// The logit of `factor` times the opacity of a logit.
pub(crate) fn scaled_logit(logit: f64, factor: f64) -> f64 {
    if factor == 1.0 {
        return logit;
    }
    let o = factor * sigmoid(logit);
    o.ln() - (-o).ln_1p()
}

/// First-order change of the loss by a birth of this opacity logit, from the derivative by the logit of its probe.
pub(crate) fn change(slope: f64, logit: f64, epsilon: f64) -> f64 {
    // dL/dlogit = (1 − o)·o·dL/do at o = ε·o_c; the change by o_c is o_c·dL/do.
    slope / (sigmoid(-scaled_logit(logit, epsilon)) * epsilon)
}
