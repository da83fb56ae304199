//! Twin of `kernels/metrics.cl`.

/// Squared error of an image clamped to [0, 1].
#[must_use]
pub fn squared_error(image: &[f64], photo: &[f64]) -> f64 {
    image
        .iter()
        .zip(photo)
        .map(|(x, y)| (x.clamp(0.0, 1.0) - y).powi(2))
        .sum()
}
