//! Error cues per Gaussian (`kernels/importance.cl`).

use crate::error::Result;
use crate::gpu::tuning::TILE;
use crate::gpu::tuning::status::SLOTS;
use crate::gpu::{Array, CameraArg, Kernel, Kernels, Real};

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
