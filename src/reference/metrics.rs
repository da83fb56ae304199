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
