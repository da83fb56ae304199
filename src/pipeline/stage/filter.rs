//! The 3D filter of every Gaussian (`kernels/filter.cl`).

pub use crate::scene::filters as filter;

use crate::base::constants::FILTER_CHUNKS;
use crate::base::error::Result;
use crate::device::tuning::status::SLOTS;
use crate::device::{Array, CameraArg, Kernel, Kernels, Real};
use crate::scene::Plane;

/// The filter stage.
#[derive(Debug)]
pub struct Filter {
    views: Kernel,
    largest: Kernel,
    unseen: Kernel,
    local: usize,
    coarse_local: usize,
    lanes: usize,
}

/// Arguments of [`Filter::run`].
#[derive(Debug)]
pub struct FilterArgs<'a, R: Real> {
    /// Raw parameters \[planes, stride\]; positions are read.
    pub params: &'a Array<R>,
    /// Gaussians allocated.
    pub stride: usize,
    /// Gaussians.
    pub count: usize,
    /// Cameras of the training views.
    pub cameras: &'a Array<CameraArg<R>>,
    /// Status array; after an overflow nothing is changed.
    pub status: &'a Array<u32>,
    /// Scratch \[FILTER_CHUNKS\], local units.
    pub largest: &'a Array<R>,
    /// Out \[stride\]: standard deviation of the filter, local units.
    pub filter: &'a Array<R>,
}

impl Filter {
    /// Builds the kernels.
    ///
    /// # Errors
    /// A build failure.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let names = ["filter_views", "filter_largest", "filter_unseen"];
        let [views, largest, unseen] = kernels.build::<R, 3>("filter", names)?;
        let tuning = kernels.defines().tuning;
        Ok(Self {
            views,
            largest,
            unseen,
            local: tuning.lane_local(),
            coarse_local: tuning.coarse_local(),
            lanes: tuning.vector_width as usize,
        })
    }

    /// Enqueues the stage.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn run<R: Real>(&self, a: &FilterArgs<'_, R>) -> Result<()> {
        let vectors = [a.count.div_ceil(self.lanes), 1];
        let chunks = FILTER_CHUNKS as usize;
        self.views
            .launch()
            .array(a.params, Plane::LOG_SCALE * a.stride)
            .value(a.stride as u32)
            .value(a.count as u32)
            .array(a.cameras, a.cameras.len())
            .value(a.cameras.len() as u32)
            .array(a.status, SLOTS)
            .array(a.filter, a.stride)
            .run(vectors, [self.local, 1])?;
        self.largest
            .launch()
            .value(a.count as u32)
            .array(a.status, SLOTS)
            .array(a.filter, a.stride)
            .array(a.largest, chunks)
            .run([chunks, 1], [self.coarse_local, 1])?;
        self.unseen
            .launch()
            .value(a.count as u32)
            .array(a.status, SLOTS)
            .array(a.largest, chunks)
            .array(a.filter, a.stride)
            .run(vectors, [self.local, 1])
    }
}
