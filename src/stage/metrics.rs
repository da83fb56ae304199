//! Squared error of a clamped render (`kernels/metrics.cl`).

use super::loss::ImagePair;
use crate::error::Result;
use crate::gpu::{Array, Kernel, Kernels, Real};

/// The metrics stage.
#[derive(Debug)]
pub struct Metrics {
    kernel: Kernel,
    local: usize,
    photo_planes: usize,
}

impl Metrics {
    /// Builds the kernel.
    ///
    /// # Errors
    /// A build failure.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let [kernel] = kernels.build::<R, 1>("metrics", ["metrics"])?;
        Ok(Self {
            kernel,
            local: kernels.defines().tuning.coarse_local(),
            photo_planes: kernels.defines().photo_planes(),
        })
    }

    /// Clamps the render in place and writes the squared error of each row (all channels) and the number of its pixels
    /// that count into `squared_error` \[2, height\].
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn run<R: Real>(&self, pair: &ImagePair<'_, R>, squared_error: &Array<R>) -> Result<()> {
        let ([w, h], [stride, rows], bg) = (pair.size, pair.padded(), pair.background_real());
        self.kernel
            .launch()
            .array(pair.image, 3 * pair.plane())
            .array(pair.photo, self.photo_planes * w * h)
            .value(bg[0])
            .value(bg[1])
            .value(bg[2])
            .value(w as i32)
            .value(h as i32)
            .value(stride as i32)
            .value(rows as i32)
            .array(squared_error, 2 * h)
            .run([h, 1], [self.local, 1])
    }
}
