//! Error cues per Gaussian (`kernels/importance.cl`).

use crate::base::constants::TILE;
use crate::base::error::Result;
use crate::device::tuning::status::SLOTS;
use crate::device::{Array, CameraArg, Kernel, Kernels, Real};
use crate::pipeline::reference::{Camera64, Scene64};

/// The importance stage.
#[derive(Debug)]
pub struct Importance {
    kernel: Kernel,
    local: usize,
    lanes: usize,
}

/// Arguments of [`Importance::run`].
#[derive(Debug)]
pub struct ImportanceArgs<'a, R: Real> {
    /// Raw parameters \[planes, stride\].
    pub params: &'a Array<R>,
    /// Gaussians allocated.
    pub stride: usize,
    /// Gaussians.
    pub count: usize,
    /// Camera.
    pub camera: &'a CameraArg<R>,
    /// Error maps \[2, rows, stride\]: 1 − SSIM, |x − y|.
    pub maps: &'a Array<R>,
    /// Start the sums with this view.
    pub first_view: bool,
    /// Status array; after an overflow the view does not count.
    pub status: &'a Array<u32>,
    /// In/out \[3, stride\]: sums of 1 − SSIM and |x − y|, views that see the centre.
    pub cues: &'a Array<R>,
}

impl Importance {
    /// Builds the kernel.
    ///
    /// # Errors
    /// A build failure.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let [kernel] = kernels.build::<R, 1>("importance", ["importance"])?;
        Ok(Self {
            kernel,
            local: kernels.defines().tuning.lane_local(),
            lanes: kernels.defines().tuning.vector_width as usize,
        })
    }

    /// Enqueues the stage for one view.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn run<R: Real>(&self, a: &ImportanceArgs<'_, R>) -> Result<()> {
        let [stride, rows] = a.camera.tiles.map(|t| t * TILE as i32);
        self.kernel
            .launch()
            .array(a.params, 3 * a.stride)
            .value(a.stride as u32)
            .value(a.count as u32)
            .value(*a.camera)
            .array(a.maps, 2 * (stride * rows) as usize)
            .value(stride)
            .value(rows)
            .value(i32::from(a.first_view))
            .array(a.status, SLOTS)
            .array(a.cues, 3 * a.stride)
            .run([a.count.div_ceil(self.lanes), 1], [self.local, 1])
    }
}

/// Values of two error maps \[height, width\] at the pixel under the projected centre of Gaussian `i`, if it is in front
/// of the camera and inside the image.
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
