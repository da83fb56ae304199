//! What the views show of each Gaussian (`kernels/weight.cl`).

use crate::error::Result;
use crate::gpu::tuning::{SUMS, TILE};
use crate::gpu::{Array, Kernel, Kernels, Real};

/// The weight stage.
#[derive(Debug)]
pub struct Weight {
    kernel: Kernel,
    local: usize,
}

/// Arguments of [`Weight::run`].
#[derive(Debug)]
pub struct WeightArgs<'a, R: Real> {
    /// Gaussians.
    pub count: usize,
    /// First pair of each Gaussian \[count\].
    pub pair_start: &'a Array<u32>,
    /// Pairs of each Gaussian \[count\].
    pub pair_counts: &'a Array<u32>,
    /// Sums of splat_grad, with dL/dC 1 in red \[pairs, 9\].
    pub sums: &'a Array<R>,
    /// In/out \[count\]: the largest sum of α·T over the pixels of a view so far, pixels.
    pub most: &'a Array<R>,
}

/// dL/dC that makes splat_grad add up weights: 1 in red within an image of `size` (width, height), else 0
/// \[3, rows, stride\].
#[must_use]
pub fn red_image<R: Real>(size: [usize; 2]) -> Vec<R> {
    let [stride, rows] = size.map(|s| s.next_multiple_of(TILE as usize));
    let mut image = vec![R::of(0.0); 3 * stride * rows];
    for row in image.chunks_exact_mut(stride).take(size[1]) {
        row[..size[0]].fill(R::of(1.0));
    }
    image
}

impl Weight {
    /// Builds the kernel.
    ///
    /// # Errors
    /// A build failure.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let [kernel] = kernels.build::<R, 1>("weight", ["weight"])?;
        Ok(Self {
            kernel,
            local: kernels.defines().tuning.local,
        })
    }

    /// Enqueues the stage for one view.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn run<R: Real>(&self, a: &WeightArgs<'_, R>) -> Result<()> {
        self.kernel
            .launch()
            .value(a.count as u32)
            .array(a.pair_start, a.count)
            .array(a.pair_counts, a.count)
            .array(a.sums, SUMS)
            .array(a.most, a.count)
            .run([a.count, 1], [self.local, 1])
    }
}
