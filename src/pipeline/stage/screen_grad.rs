//! Gradients with respect to the projected centres, added up over iterations (`kernels/screen_grad.cl`): 3DGS, Kerbl et al. 2023,
//! section 5.2.

use crate::base::constants::SUMS;
use crate::base::error::Result;
use crate::device::{Array, Program, Real};
use crate::pipeline::buffers::{GaussianBuffers, ViewBuffers};
use crate::pipeline::launch::Arguments;
use crate::pipeline::reference::{Camera64, Scene64};
use crate::pipeline::stage::project::{Shape64, shape};

/// Adds the norms of one iteration, whose stage project_grad has run, to `statistics`; after an overflow in the view nothing changes.
pub fn add_norms<R: Real>(
    stage: &Program,
    scene: &GaussianBuffers<R>,
    view: &ViewBuffers<R>,
    statistics: &Array<R>,
) -> Result<()> {
    stage
        .launch("screen_grad")
        .array(&view.records, scene.count)
        .uints([scene.stride, scene.count])
        .arrays([&view.isect_start, &view.isect_counts], scene.count)
        .array(&view.sums, SUMS)
        .ints(view.camera.image().pixels)
        .status(view)
        .array(statistics, 2 * scene.stride)
        .over_items([scene.count, 1])
}

// Definition in f64.

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

/// Norm of the loss gradient with respect to the projected centre of Gaussian `i` in normalised device coordinates; `None` for
/// a culled Gaussian.
#[must_use]
pub fn screen_grad(scene: &Scene64, i: usize, camera: &Camera64, sums: &[f64; 9]) -> Option<f64> {
    let [x, y] = mean_gradient(&shape(scene, i, camera)?, sums);
    let [half_width, half_height] = camera.size.map(|s| 0.5 * f64::from(s));
    Some((x * half_width).hypot(y * half_height))
}
