//! The 3D filter of every Gaussian (`kernels/filter.cl`): Mip-Splatting, Yu et al. 2024, eq. 6 to 8.

use crate::base::constants::FILTER_CHUNKS;
use crate::base::error::Result;
use crate::device::{Array, CameraArg, Launch, Program, Real};
use crate::pipeline::buffers::{GaussianBuffers, ViewBuffers};
use crate::pipeline::launch::Arguments;
use crate::scene::Plane;

/// Fills in the filter of a scene from the cameras of the training views; `largest` is scratch. After an overflow in
/// the view nothing changes.
pub fn compute<R: Real>(
    stage: &Program,
    scene: &GaussianBuffers<R>,
    view: &ViewBuffers<R>,
    cameras: &Array<CameraArg<R>>,
    largest: &Array<R>,
) -> Result<()> {
    measure(stage, scene, view, cameras, largest)?;
    fill(stage, scene, view, largest)
}

/// Writes the filter of a scene from the cameras of the training views, 0 for what none of them sees, and the largest values of its chunks
/// into `largest`. After an overflow in the view nothing changes.
pub fn measure<R: Real>(
    stage: &Program,
    scene: &GaussianBuffers<R>,
    view: &ViewBuffers<R>,
    cameras: &Array<CameraArg<R>>,
    largest: &Array<R>,
) -> Result<()> {
    stage
        .launch("filter_views")
        .scene(scene, Plane::LOG_SCALE)
        .array(cameras, cameras.len())
        .uints([cameras.len()])
        .status(view)
        .array(&scene.filter, scene.stride)
        .over_gaussians(scene.count)?;
    with_largest(stage, "filter_largest", scene, view, largest).over_groups(FILTER_CHUNKS as usize)
}

/// Gives the Gaussians that no view sees the largest filter of `largest`.
pub fn fill<R: Real>(
    stage: &Program,
    scene: &GaussianBuffers<R>,
    view: &ViewBuffers<R>,
    largest: &Array<R>,
) -> Result<()> {
    with_largest(stage, "filter_unseen", scene, view, largest).over_gaussians(scene.count)
}

fn with_largest<'a, R: Real>(
    stage: &'a Program,
    kernel: &'static str,
    scene: &GaussianBuffers<R>,
    view: &ViewBuffers<R>,
    largest: &Array<R>,
) -> Launch<'a> {
    stage
        .launch(kernel)
        .uints([scene.count])
        .status(view)
        .array(&scene.filter, scene.stride)
        .array(largest, FILTER_CHUNKS as usize)
}

// Definition in f64: that of the host.

pub use crate::scene::filters as filter;
