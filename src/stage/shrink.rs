//! Photos at a fraction of their size (`kernels/shrink.cl`).

use crate::error::Result;
use crate::gpu::tuning::SHRINK_RUN;
use crate::gpu::{Array, Kernel, Kernels, Real};

/// The shrink stage.
#[derive(Debug)]
pub struct Shrink {
    kernel: Kernel,
    local: usize,
    photo_planes: usize,
}

impl Shrink {
    /// Builds the kernel.
    ///
    /// # Errors
    /// A build failure.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let [kernel] = kernels.build::<R, 1>("shrink", ["shrink"])?;
        Ok(Self {
            kernel,
            local: kernels.defines().tuning.coarse_local(),
            photo_planes: kernels.defines().photo_planes(),
        })
    }

    /// `photo` \[3 or 4, height, width\] at 1/`factor` of its size into `small` \[3 or 4, ⌊height/factor⌋, ⌊width/factor⌋\].
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn run(
        &self,
        photo: &Array<u8>,
        [width, height]: [usize; 2],
        factor: usize,
        small: &Array<u8>,
    ) -> Result<()> {
        let ([w, h], planes) = ([width / factor, height / factor], self.photo_planes);
        self.kernel
            .launch()
            .array(photo, planes * width * height)
            .value(width as i32)
            .value(height as i32)
            .value(planes as i32)
            .value(factor as i32)
            .array(small, planes * w * h)
            .run(
                [w.div_ceil(SHRINK_RUN as usize), planes * h],
                [self.local, 1],
            )
    }
}
