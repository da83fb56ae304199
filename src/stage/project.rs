//! Raw Gaussians → records of one camera (`kernels/project.cl`).

use crate::error::Result;
use crate::gpu::{Array, CameraArg, Kernel, Kernels, Real, Record};
use crate::model::Plane;

/// The project stage, specialised for one SH degree.
#[derive(Debug)]
pub struct Project {
    kernel: Kernel,
    local: usize,
    lanes: usize,
    planes: usize,
    anti_alias: bool,
}

/// Arguments of [`Project::run`].
#[derive(Debug)]
pub struct ProjectArgs<'a, R: Real> {
    /// Raw parameters \[planes, stride\].
    pub params: &'a Array<R>,
    /// Gaussians allocated.
    pub stride: usize,
    /// Gaussians.
    pub count: usize,
    /// Standard deviations of the 3D filter, local units \[stride\]; not looked at unless the kernels are built with `anti_alias`.
    pub filter: &'a Array<R>,
    /// Camera.
    pub camera: &'a CameraArg<R>,
    /// Composite the depth (local units) in place of the colour.
    pub depth_as_color: bool,
    /// Out \[stride\].
    pub records: &'a Array<Record<R>>,
    /// Out \[stride\]: depth bits, or culled.
    pub keys: &'a Array<u32>,
    /// Out \[stride\]: zeroed.
    pub pair_counts: &'a Array<u32>,
}

impl Project {
    /// Builds the kernel.
    ///
    /// # Errors
    /// A build failure.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let [kernel] = kernels.build::<R, 1>("project", ["project"])?;
        let defines = kernels.defines();
        Ok(Self {
            kernel,
            local: defines.tuning.lane_local(),
            lanes: defines.tuning.vector_width as usize,
            planes: Plane::count(defines.sh_degree),
            anti_alias: defines.anti_alias,
        })
    }

    /// Enqueues the stage.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn run<R: Real>(&self, a: &ProjectArgs<'_, R>) -> Result<()> {
        let mut launch = self
            .kernel
            .launch()
            .array(a.params, self.planes * a.stride)
            .value(a.stride as u32)
            .value(a.count as u32);
        if self.anti_alias {
            launch = launch.array(a.filter, a.stride);
        }
        launch
            .value(*a.camera)
            .value(i32::from(a.depth_as_color))
            .array(a.records, a.count)
            .array(a.keys, a.count)
            .array(a.pair_counts, a.count)
            .run([a.count.div_ceil(self.lanes), 1], [self.local, 1])
    }
}
