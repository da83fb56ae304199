//! Gradients by the projected centres, added up over iterations (`kernels/screen_grad.cl`).

use crate::base::constants::SUMS;
use crate::base::error::Result;
use crate::device::tuning::status::SLOTS;
use crate::device::{Array, Kernel, Kernels, Real, Record};
use crate::pipeline::reference::{Camera64, Scene64};
use crate::pipeline::stage::project::{Shape64, shape};

/// The screen_grad stage.
#[derive(Debug)]
pub struct ScreenGrad {
    kernel: Kernel,
    local: usize,
}

/// Arguments of [`ScreenGrad::run`].
#[derive(Debug)]
pub struct ScreenGradArgs<'a, R: Real> {
    /// Records \[count\].
    pub records: &'a Array<Record<R>>,
    /// Gaussians allocated.
    pub stride: usize,
    /// Gaussians.
    pub count: usize,
    /// First pair of each Gaussian \[count\].
    pub pair_start: &'a Array<u32>,
    /// Pairs of each Gaussian \[count\].
    pub pair_counts: &'a Array<u32>,
    /// Sums of splat_grad \[pairs, 9\].
    pub sums: &'a Array<R>,
    /// Width and height of the image, pixels.
    pub size: [i32; 2],
    /// Status array; after an overflow the iteration does not count.
    pub status: &'a Array<u32>,
    /// In/out \[2, stride\]: sums of norms, iterations that saw the Gaussian.
    pub cues: &'a Array<R>,
}

impl ScreenGrad {
    /// Builds the kernel.
    ///
    /// # Errors
    /// A build failure.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let [kernel] = kernels.build::<R, 1>("screen_grad", ["screen_grad"])?;
        Ok(Self {
            kernel,
            local: kernels.defines().tuning.local,
        })
    }

    /// Enqueues the stage for one iteration.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn run<R: Real>(&self, a: &ScreenGradArgs<'_, R>) -> Result<()> {
        self.kernel
            .launch()
            .array(a.records, a.count)
            .value(a.stride as u32)
            .value(a.count as u32)
            .array(a.pair_start, a.count)
            .array(a.pair_counts, a.count)
            .array(a.sums, SUMS)
            .value(a.size[0])
            .value(a.size[1])
            .array(a.status, SLOTS)
            .array(a.cues, 2 * a.stride)
            .run([a.count, 1], [self.local, 1])
    }
}

/// dL/dmean, per pixel, from the nine sums of a Gaussian: K·Σ g·(dx, dy), K the inverse covariance and dx = u + r·dy.
#[must_use]
pub fn mean_gradient(o: &Shape64, s: &[f64; 9]) -> [f64; 2] {
    let k = [
        [o.cov[1][1] / o.det, -o.cov[0][1] / o.det],
        [-o.cov[0][1] / o.det, o.cov[0][0] / o.det],
    ];
    let r = o.cov[0][1] / o.cov[1][1];
    let first = [s[1] + r * s[2], s[2]];
    std::array::from_fn(|a| k[a][0] * first[0] + k[a][1] * first[1])
}

/// Norm of the loss gradient by the projected centre of Gaussian `i` in normalised device coordinates; none for a culled
/// Gaussian.
#[must_use]
pub fn screen_grad(scene: &Scene64, i: usize, camera: &Camera64, sums: &[f64; 9]) -> Option<f64> {
    let [x, y] = mean_gradient(&shape(scene, i, camera)?, sums);
    let [half_width, half_height] = camera.size.map(|s| 0.5 * f64::from(s));
    Some((x * half_width).hypot(y * half_height))
}
