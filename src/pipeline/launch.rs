//! [`Arguments`]: arguments that many kernels share, taken from the buffers.

use crate::device::tuning::status::SLOTS;
use crate::device::{Array, ImageSize, Launch, Real};
use crate::pipeline::buffers::{GaussianBuffers, ViewBuffers};
use crate::scene::Plane;

/// Arguments in the order in which the kernels take them.
pub(super) trait Arguments: Sized {
    /// The first planes of the raw parameters, their stride, and the number of Gaussians.
    fn scene<R: Real>(self, scene: &GaussianBuffers<R>, planes: usize) -> Self;
    /// The raw parameters of the SH degree that the kernel is built for, their stride, the Gaussian after the last that the kernel takes,
    /// and, with anti-aliasing, their 3D filter.
    fn gaussians<R: Real>(self, scene: &GaussianBuffers<R>, end: usize) -> Self;
    /// The counters.
    fn status<R: Real>(self, view: &ViewBuffers<R>) -> Self;
    /// Records, and the pairs of each tile from front to back.
    fn tile_lists<R: Real>(self, view: &ViewBuffers<R>) -> Self;
    /// A photo with the planes that the kernel is built for, and its size.
    fn photo(self, photo: &Array<u8>, size: ImageSize) -> Self;
}

impl Arguments for Launch<'_> {
    fn scene<R: Real>(self, scene: &GaussianBuffers<R>, planes: usize) -> Self {
        self.array(&scene.params, planes * scene.stride)
            .uints([scene.stride, scene.count])
    }

    fn gaussians<R: Real>(self, scene: &GaussianBuffers<R>, end: usize) -> Self {
        let defines = *self.defines();
        let planes = Plane::count(defines.sh_degree);
        let launch = self.array(&scene.params, planes * scene.stride);
        let launch = launch.uints([scene.stride, end]);
        if defines.anti_alias {
            launch.array(&scene.filter, scene.stride)
        } else {
            launch
        }
    }

    fn status<R: Real>(self, view: &ViewBuffers<R>) -> Self {
        self.array(&view.status, SLOTS)
    }

    fn tile_lists<R: Real>(self, view: &ViewBuffers<R>) -> Self {
        self.array(&view.records, 1)
            .arrays([&view.isect_owner, view.order()], 1)
            .array(&view.tile_start, view.camera.tile_count() + 1)
    }

    fn photo(self, photo: &Array<u8>, size: ImageSize) -> Self {
        let planes = self.defines().photo_planes();
        self.array(photo, planes * size.0[0] * size.0[1])
            .ints(size.0)
    }
}
