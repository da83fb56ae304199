//! [`Arguments`]: arguments that many kernels share, taken from the buffers.

use crate::device::tuning::status::SLOTS;
use crate::device::{Array, CameraArg, Launch, Real};
use crate::pipeline::buffers::{GaussianBuffers, ViewBuffers};
use crate::scene::Plane;

/// Arguments in the order in which the kernels take them.
pub(super) trait Arguments: Sized {
    /// The first planes of the raw parameters, their stride, and the number of Gaussians.
    fn scene<R: Real>(self, scene: &GaussianBuffers<R>, planes: usize) -> Self;

    /// The raw parameters of the SH degree that the kernel is built for, and, with anti-aliasing, their 3D filter.
    fn gaussians<R: Real>(self, scene: &GaussianBuffers<R>) -> Self;

    /// The first planes of the raw parameters and of both moments, to be changed.
    fn state<R: Real>(
        self,
        scene: &GaussianBuffers<R>,
        moments: [&Array<R>; 2],
        planes: usize,
    ) -> Self;

    /// The counters.
    fn status<R: Real>(self, view: &ViewBuffers<R>) -> Self;

    /// First pair and number of pairs of each of `count` Gaussians.
    fn intersection_ranges<R: Real>(self, view: &ViewBuffers<R>, count: usize) -> Self;

    /// Records, and the pairs of each tile from front to back.
    fn tile_lists<R: Real>(self, view: &ViewBuffers<R>, camera: &CameraArg<R>) -> Self;
}

impl Arguments for Launch<'_> {
    fn scene<R: Real>(self, scene: &GaussianBuffers<R>, planes: usize) -> Self {
        self.array(&scene.params, planes * scene.stride)
            .uints([scene.stride, scene.count])
    }

    fn gaussians<R: Real>(self, scene: &GaussianBuffers<R>) -> Self {
        let (planes, filtered) = (
            Plane::count(self.defines().sh_degree),
            self.defines().anti_alias,
        );
        let launch = self.scene(scene, planes);
        if filtered {
            launch.array(&scene.filter, scene.stride)
        } else {
            launch
        }
    }

    fn state<R: Real>(
        self,
        scene: &GaussianBuffers<R>,
        moments: [&Array<R>; 2],
        planes: usize,
    ) -> Self {
        let len = planes * scene.stride;
        self.array(&scene.params, len)
            .array(moments[0], len)
            .array(moments[1], len)
    }

    fn status<R: Real>(self, view: &ViewBuffers<R>) -> Self {
        self.array(&view.status, SLOTS)
    }

    fn intersection_ranges<R: Real>(self, view: &ViewBuffers<R>, count: usize) -> Self {
        self.array(&view.isect_start, count)
            .array(&view.isect_counts, count)
    }

    fn tile_lists<R: Real>(self, view: &ViewBuffers<R>, camera: &CameraArg<R>) -> Self {
        self.array(&view.records, 1)
            .array(&view.isect_owner, 1)
            .array(view.order.sorted_values(), 1)
            .array(&view.tile_start, camera.tile_count() + 1)
    }
}
