//! Quantities that change linearly with the progress η of density control.

/// max(1, ⌊count·(1−η)⌋); 0 stays 0, so that a phase can be switched off. The small allowance keeps 10·(1−0.4) at 6.
pub(super) fn shrinking(count: usize, eta: f64) -> usize {
    let left = (count as f64 * (1.0 - eta.clamp(0.0, 1.0)) + 1e-9).floor() as usize;
    left.clamp(1.min(count), count)
}

/// Linear interpolation between the values at η = 0 and η = 1.
pub(crate) fn lerp([start, end]: [f64; 2], eta: f64) -> f64 {
    start + (end - start) * eta
}
