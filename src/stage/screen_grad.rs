//! Gradients by the projected centres, added up over iterations (`kernels/screen_grad.cl`).

use crate::error::Result;
use crate::gpu::tuning::SUMS;
use crate::gpu::tuning::status::SLOTS;
use crate::gpu::{Array, Kernel, Kernels, Real, Record};

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
