//! The 3D filter of every Gaussian (`kernels/filter.cl`): Mip-Splatting, Yu et al. 2024, eq. 6 to 8.

use crate::base::constants::FILTER_CHUNKS;
use crate::base::error::Result;
use crate::device::{Array, CameraArg, Program, Real};
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
    let chunks = FILTER_CHUNKS as usize;
    stage
        .launch("filter_views")
        .scene(scene, Plane::LOG_SCALE)
        .array(cameras, cameras.len())
        .uints([cameras.len()])
        .status(view)
        .array(&scene.filter, scene.stride)
        .over_gaussians(scene.count)?;
    let rest = |kernel| {
        stage
            .launch(kernel)
            .uints([scene.count])
            .status(view)
            .array(&scene.filter, scene.stride)
            .array(largest, chunks)
    };
    rest("filter_largest").over_chunks([chunks, 1])?;
    rest("filter_unseen").over_gaussians(scene.count)
}

// Definition in f64: that of the host.

pub use crate::scene::filters as filter;
