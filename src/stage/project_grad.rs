//! Sums per pair → gradients of the raw parameters (`kernels/project_grad.cl`).

use std::ops::Range;

use crate::error::Result;
use crate::gpu::tuning::status::SLOTS;
use crate::gpu::{Array, CameraArg, Kernel, Kernels, Real};
use crate::model::Plane;

/// The project_grad stage, specialised for one SH degree.
#[derive(Debug)]
pub struct ProjectGrad {
    kernel: Kernel,
    local: usize,
    lanes: usize,
    planes: usize,
    anti_alias: bool,
}

/// Arguments of [`ProjectGrad::run`].
#[derive(Debug)]
pub struct ProjectGradArgs<'a, R: Real> {
    /// Raw parameters \[planes, stride\].
    pub params: &'a Array<R>,
    /// Gaussians allocated.
    pub stride: usize,
    /// Gaussians.
    pub count: usize,
    /// Standard deviations of the 3D filter, local units \[stride\]; not looked at unless the kernels are built with `anti_alias`.
    pub filter: &'a Array<R>,
    /// Camera.
    pub camera: &'a CameraArg<R>,
    /// First pair of each Gaussian \[count\].
    pub pair_start: &'a Array<u32>,
    /// Pairs of each Gaussian \[count\].
    pub pair_counts: &'a Array<u32>,
    /// Status array; after an overflow no Gaussian has pairs.
    pub status: &'a Array<u32>,
    /// Sums \[pairs, 9\].
    pub sums: &'a Array<R>,
    /// λ_o of the mean opacity.
    pub lambda_opacity: f64,
    /// λ_s of the mean scale, per local unit.
    pub lambda_scale: f64,
    /// The Gaussians whose gradients are wanted; starts at a multiple of 16.
    pub block: Range<usize>,
    /// Gaussians that a plane of `grads` has room for, a multiple of 16.
    pub grad_stride: usize,
    /// Out \[planes, grad_stride\].
    pub grads: &'a Array<R>,
}

impl ProjectGrad {
    /// Builds the kernel.
    ///
    /// # Errors
    /// A build failure.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let [kernel] = kernels.build::<R, 1>("project_grad", ["project_grad"])?;
        let defines = kernels.defines();
        Ok(Self {
            kernel,
            local: defines.tuning.lane_local(),
            lanes: defines.tuning.vector_width as usize,
            planes: Plane::count(defines.sh_degree),
            anti_alias: defines.anti_alias,
        })
    }

    /// Enqueues the stage.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn run<R: Real>(&self, a: &ProjectGradArgs<'_, R>) -> Result<()> {
        let n = a.count.max(1) as f64;
        let mut launch = self
            .kernel
            .launch()
            .array(a.params, self.planes * a.stride)
            .value(a.stride as u32)
            .value(a.count as u32);
        if self.anti_alias {
            launch = launch.array(a.filter, a.stride);
        }
        launch
            .value(a.block.start as u32)
            .value(a.grad_stride as u32)
            .value(*a.camera)
            .array(a.pair_start, a.count)
            .array(a.pair_counts, a.count)
            .array(a.status, SLOTS)
            .array(a.sums, 1)
            .value(R::of(a.lambda_opacity / n))
            .value(R::of(a.lambda_scale / (3.0 * n)))
            .array(a.grads, self.planes * a.grad_stride)
            .run([a.block.len().div_ceil(self.lanes), 1], [self.local, 1])
    }
}
