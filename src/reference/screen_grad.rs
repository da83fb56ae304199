//! Twin of `kernels/screen_grad.cl` (\[3DGS\] §5.2), by the textbook's inverse covariance.

use super::project::{Shape64, shape};
use super::{Camera64, Scene64};

/// dL/dmean, per pixel, from the nine sums of a Gaussian: K·Σ g·(dx, dy), K the inverse covariance and dx = u + r·dy.
#[must_use]
pub fn mean_gradient(o: &Shape64, s: &[f64; 9]) -> [f64; 2] {
    let k = [
        [o.cov[1][1] / o.det, -o.cov[0][1] / o.det],
        [-o.cov[0][1] / o.det, o.cov[0][0] / o.det],
    ];
    let r = o.cov[0][1] / o.cov[1][1];
    let first = [s[1] + r * s[2], s[2]];
    std::array::from_fn(|a| k[a][0] * first[0] + k[a][1] * first[1])
}

/// Norm of the loss gradient by the projected centre of Gaussian `i` in normalised device coordinates; none for a culled
/// Gaussian.
#[must_use]
pub fn screen_grad(scene: &Scene64, i: usize, camera: &Camera64, sums: &[f64; 9]) -> Option<f64> {
    let [x, y] = mean_gradient(&shape(scene, i, camera)?, sums);
    let [half_width, half_height] = camera.size.map(|s| 0.5 * f64::from(s));
    Some((x * half_width).hypot(y * half_height))
}
