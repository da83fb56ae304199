//! Error statistics of each Gaussian: the error maps of a view under the projected centre (`kernels/importance.cl`; \[MH\] Eq. 11, 13).

use crate::base::error::Result;
use crate::device::{Array, Program, Real};
use crate::pipeline::buffers::{GaussianBuffers, ViewBuffers};
use crate::pipeline::launch::Arguments;
use crate::pipeline::reference::{Camera64, Scene64};

/// Adds the errors of a view to `statistics`, which `first_view` sets to zero before; `maps` are those of
/// [`crate::pipeline::stage::loss::Loss::error_maps`], of so many planes. After an overflow in the view nothing changes.
pub fn add_errors<R: Real>(
    stage: &Program,
    scene: &GaussianBuffers<R>,
    view: &ViewBuffers<R>,
    (maps, planes): (&Array<R>, usize),
    first_view: bool,
    statistics: &Array<R>,
) -> Result<()> {
    let size = view.camera.image();
    stage
        .launch("importance")
        .scene(scene, 3)
        .value(view.camera)
        .array(maps, planes * size.plane())
        .ints(size.padded())
        .value(i32::from(first_view))
        .status(view)
        .array(statistics, 3 * scene.stride)
        .over_gaussians(scene.count)
}

// Definition in f64.

/// Values of two error maps \[height, width\] at the pixel under the projected centre of Gaussian `i`, `None` if that is
/// behind the camera or outside of the image.
#[must_use]
pub fn importance(
    scene: &Scene64,
    i: usize,
    camera: &Camera64,
    maps: [&[f64]; 2],
) -> Option<[f64; 2]> {
    let t = camera.apply(scene.position(i));
    if t[2].is_nan() || t[2] <= camera.near {
        return None;
    }
    let pixel: [f64; 2] =
        std::array::from_fn(|k| (camera.focal[k] * t[k] / t[2] + camera.principal[k]).floor());
    let inside = (0..2).all(|k| pixel[k] >= 0.0 && pixel[k] < f64::from(camera.size[k]));
    inside.then(|| {
        let at = pixel[1] as usize * camera.size[0] as usize + pixel[0] as usize;
        maps.map(|m| m[at])
    })
}
