//! [`Arguments`]: arguments that many kernels share, taken from the buffers.

use crate::device::tuning::status::SLOTS;
use crate::device::{ImageSize, Launch, Real};
use crate::pipeline::buffers::{GaussianBuffers, ViewBuffers};
use crate::pipeline::photo_array::PhotoArray;
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
    /// All of a photo, with the planes that the kernel is built for, and its size.
    fn photo(self, photo: &PhotoArray, size: ImageSize) -> Self;
    /// The rows of a photo that there are, with the planes that the kernel is built for; its size, the first row and their number.
    fn photo_rows(self, photo: &PhotoArray, size: ImageSize) -> Self;
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
            .array(&view.tile_start, view.camera.image().tile_count() + 1)
    }

    fn photo(self, photo: &PhotoArray, size: ImageSize) -> Self {
        let planes = self.defines().photo_planes();
        // A part is shorter, and refused for that.
        self.array(photo, planes * size.pixels[0] * size.pixels[1])
            .ints(size.pixels)
    }

    fn photo_rows(self, photo: &PhotoArray, size: ImageSize) -> Self {
        let (planes, rows) = (self.defines().photo_planes(), photo.rows());
        self.array(photo, planes * size.pixels[0] * rows.len())
            .ints(size.pixels)
            .ints([rows.start, rows.len()])
    }
}
