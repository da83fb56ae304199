//! The 3D filter of every Gaussian (`kernels/filter.cl`): Mip-Splatting, Yu et al. 2024, eq. 6 to 8.

use crate::base::constants::FILTER_CHUNKS;
use crate::base::error::Result;
use crate::device::{Array, CameraArg, Kernel, Kernels, Real};
use crate::pipeline::buffers::{GaussianBuffers, ViewBuffers};
use crate::pipeline::launch::Arguments;
use crate::scene::Plane;

/// The kernels.
#[derive(Debug)]
pub struct Filter {
    views: Kernel,
    largest: Kernel,
    unseen: Kernel,
}

impl Filter {
    /// Builds the kernels.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let names = ["filter_views", "filter_largest", "filter_unseen"];
        let [views, largest, unseen] = kernels.build::<R, 3>("filter", names)?;
        Ok(Self {
            views,
            largest,
            unseen,
        })
    }

    /// Fills in the filter of a scene from the cameras of the training views; `largest` is scratch. After an overflow in
    /// the view nothing changes.
    pub fn run<R: Real>(
        &self,
        scene: &GaussianBuffers<R>,
        view: &ViewBuffers<R>,
        cameras: &Array<CameraArg<R>>,
        largest: &Array<R>,
    ) -> Result<()> {
        let chunks = FILTER_CHUNKS as usize;
        self.views
            .launch()
            .scene(scene, Plane::LOG_SCALE)
            .array(cameras, cameras.len())
            .uints([cameras.len()])
            .status(view)
            .array(&scene.filter, scene.stride)
            .over_gaussians(scene.count)?;
        self.largest
            .launch()
            .uints([scene.count])
            .status(view)
            .array(&scene.filter, scene.stride)
            .array(largest, chunks)
            .over_chunks([chunks, 1])?;
        self.unseen
            .launch()
            .uints([scene.count])
            .status(view)
            .array(largest, chunks)
            .array(&scene.filter, scene.stride)
            .over_gaussians(scene.count)
    }
}

// Definition in f64: that of the host.

pub use crate::scene::filters as filter;
