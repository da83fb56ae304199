//! Photos at a fraction of their size (`kernels/shrink.cl`).

use crate::base::constants::SHRINK_RUN;
use crate::base::error::Result;
use crate::capture::Photo;
use crate::device::{Array, Kernel, Kernels, Real};

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

/// The photo at 1/`factor` of its size: means of `factor` × `factor` pixels, rounded to nearest; what does not fill a pixel
/// is left out.
#[must_use]
pub fn shrink(photo: &Photo, factor: u32) -> Photo {
    let (width, height) = (photo.width / factor, photo.height / factor);
    let mut data = Vec::new();
    for plane in 0..photo.alpha.planes() as u32 {
        for y in 0..height {
            for x in 0..width {
                let cell = (0..factor * factor).map(|k| {
                    let (px, py) = (x * factor + k % factor, y * factor + k / factor);
                    f64::from(photo.data[((plane * photo.height + py) * photo.width + px) as usize])
                });
                let mean = cell.sum::<f64>() / f64::from(factor * factor);
                data.push((mean + 0.5).floor() as u8);
            }
        }
    }
    Photo {
        width,
        height,
        alpha: photo.alpha,
        data,
    }
}
