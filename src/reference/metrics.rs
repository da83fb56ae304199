//! Twin of `kernels/metrics.cl`.

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
