//! Squared error and SSIM of a clamped render (`kernels/metrics.cl`).

use crate::base::error::Result;
use crate::device::{Array, Program, Real};
use crate::pipeline::launch::Arguments;
use crate::pipeline::stage::loss::ImagePair;

/// Clamps the render in place and writes the squared error of each row (all channels) and the number of its pixels
/// that count to rows 0 and 1 of `score`.
pub fn score<R: Real>(stage: &Program, pair: &ImagePair<'_, R>, score: &Array<R>) -> Result<()> {
    let [_, h] = pair.size.pixels;
    pair.images(stage.launch("metrics"))
        .reals::<R>(pair.background.map(f64::from))
        .array(score, 2 * h)
        .over_groups(h)
}

/// Sums 1 − SSIM of each row over its pixels that count into row 2 of `score`; `maps` are those of
/// [`crate::pipeline::stage::loss::Loss::error_maps`] of the clamped render, of so many planes.
pub fn sum_dissimilarity<R: Real>(
    stage: &Program,
    pair: &ImagePair<'_, R>,
    (maps, planes): (&Array<R>, usize),
    score: &Array<R>,
) -> Result<()> {
    let h = pair.size.pixels[1];
    stage
        .launch("metrics_ssim")
        .array(maps, planes * pair.size.plane())
        .photo(pair.photo, pair.size)
        .ints(pair.size.padded())
        .array(score, 3 * h)
        .over_groups(h)
}

// Definition in f64.

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
