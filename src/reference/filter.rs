//! Twin of `kernels/filter.cl` (Mip-Splatting, Yu et al. 2024, Eq. 6 to 8).

use super::{Camera64, FILTER_MARGIN, FILTER_VARIANCE};

/// Standard deviation of the 3D filter of a Gaussian at every position, local units \[N\]: √0.2 over the highest sampling rate f/z, f being the
/// larger focal length, of the views whose image (widened) has its centre; the largest of the others for a Gaussian that no
/// view sees, 0 for all if none is seen.
#[must_use]
pub fn filter(positions: impl Iterator<Item = [f64; 3]>, cameras: &[Camera64]) -> Vec<f64> {
    let own: Vec<Option<f64>> = positions
        .map(|x| {
            let rates = cameras.iter().filter_map(|c| rate(x, c));
            rates
                .reduce(f64::max)
                .map(|rate| FILTER_VARIANCE.sqrt() / rate)
        })
        .collect();
    let largest = own.iter().flatten().copied().fold(0.0, f64::max);
    own.into_iter().map(|v| v.unwrap_or(largest)).collect()
}

/// Samples per local unit that a view takes at a point, if it sees it.
#[must_use]
pub fn rate(x: [f64; 3], camera: &Camera64) -> Option<f64> {
    let t = camera.apply(x);
    let inside = |k: usize| {
        let (p, size) = (
            camera.focal[k] * t[k] / t[2] + camera.principal[k],
            f64::from(camera.size[k]),
        );
        p >= -FILTER_MARGIN * size && p <= (1.0 + FILTER_MARGIN) * size
    };
    let seen = t[2] > camera.near && inside(0) && inside(1);
    seen.then(|| camera.focal[0].max(camera.focal[1]) / t[2])
}
