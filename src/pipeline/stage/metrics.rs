//! Squared error and SSIM of a clamped render (`kernels/metrics.cl`).

use crate::base::error::Result;
use crate::device::{Array, Kernel, Kernels, Real};
use crate::pipeline::stage::loss::ImagePair;

/// The metrics stage.
#[derive(Debug)]
pub struct Metrics {
    squared: Kernel,
    ssim: Kernel,
    local: usize,
    photo_planes: usize,
}

impl Metrics {
    /// Builds the kernels.
    ///
    /// # Errors
    /// A build failure.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let [squared, ssim] = kernels.build::<R, 2>("metrics", ["metrics", "metrics_ssim"])?;
        Ok(Self {
            squared,
            ssim,
            local: kernels.defines().tuning.coarse_local(),
            photo_planes: kernels.defines().photo_planes(),
        })
    }

    /// Clamps the render in place and writes the squared error of each row (all channels) and the number of its pixels
    /// that count into rows 0 and 1 of `score` \[≥ 2, height\].
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn run<R: Real>(&self, pair: &ImagePair<'_, R>, score: &Array<R>) -> Result<()> {
        let ([w, h], [stride, rows], bg) = (pair.size, pair.padded(), pair.background_real());
        self.squared
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
            .array(score, 2 * h)
            .run([h, 1], [self.local, 1])
    }

    /// Sums 1 − SSIM of each row, as far as its pixels count, into row 2 of `score` \[3, height\]; `maps` is what
    /// [`crate::pipeline::stage::loss::Loss::errors`] left of the clamped render.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn dissimilarity<R: Real>(
        &self,
        pair: &ImagePair<'_, R>,
        maps: &Array<R>,
        score: &Array<R>,
    ) -> Result<()> {
        let ([w, h], [stride, _]) = (pair.size, pair.padded());
        self.ssim
            .launch()
            .array(maps, pair.plane())
            .array(pair.photo, self.photo_planes * w * h)
            .value(w as i32)
            .value(h as i32)
            .value(stride as i32)
            .array(score, 3 * h)
            .run([h, 1], [self.local, 1])
    }
}

/// Squared error of an image \[3, height, width\] clamped to [0, 1], as far as its pixels count.
#[must_use]
pub fn squared_error(image: &[f64], photo: &[f64], mask: Option<&[f64]>) -> f64 {
    let counts = |at: usize| mask.map_or(1.0, |m| m[at % m.len()]);
    image
        .iter()
        .zip(photo)
        .enumerate()
        .map(|(at, (x, y))| (counts(at) * x.clamp(0.0, 1.0) - y).powi(2))
        .sum()
}

/// Sum over the pixels of a map \[height, width\], as far as they count. Of 1 − SSIM of the masked pictures it is Σ m (1 − SSIM);
/// SSIM of the picture is 1 less that over Σ m.
#[must_use]
pub fn sum_counted(map: &[f64], mask: Option<&[f64]>) -> f64 {
    let counts = |at: usize| mask.map_or(1.0, |m| m[at]);
    map.iter().enumerate().map(|(at, v)| counts(at) * v).sum()
}
