//! Noise on the positions (`kernels/noise.cl`).

use crate::error::Result;
use crate::gpu::tuning::status::SLOTS;
use crate::gpu::{Array, Kernel, Kernels, Real};
use crate::model::Plane;

/// The noise stage.
#[derive(Debug)]
pub struct Noise {
    kernel: Kernel,
    local: usize,
    lanes: usize,
}

/// Arguments of [`Noise::run`].
#[derive(Debug)]
pub struct NoiseArgs<'a, R: Real> {
    /// Gaussians allocated.
    pub stride: usize,
    /// Gaussians.
    pub count: usize,
    /// Seed of the run.
    pub seed: u64,
    /// Stream of random numbers (see `Purpose::stream`).
    pub stream: u64,
    /// Factor on Σ·ξ, local units.
    pub rate: f64,
    /// Steepness of the gate.
    pub steepness: f64,
    /// Opacity at which the gate is one half.
    pub opacity: f64,
    /// Status array; after an overflow nothing is changed.
    pub status: &'a Array<u32>,
    /// In/out \[planes, stride\].
    pub params: &'a Array<R>,
}

impl Noise {
    /// Builds the kernel.
    ///
    /// # Errors
    /// A build failure.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let [kernel] = kernels.build::<R, 1>("noise", ["noise"])?;
        let tuning = kernels.defines().tuning;
        Ok(Self {
            kernel,
            local: tuning.lane_local(),
            lanes: tuning.vector_width as usize,
        })
    }

    /// Enqueues one step.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn run<R: Real>(&self, a: &NoiseArgs<'_, R>) -> Result<()> {
        self.kernel
            .launch()
            .value(a.stride as u32)
            .value(a.count as u32)
            .value(a.seed as u32)
            .value((a.seed >> 32) as u32)
            .value(a.stream as u32)
            .value((a.stream >> 32) as u32)
            .value(R::of(a.rate))
            .value(R::of(a.steepness))
            .value(R::of(a.opacity))
            .array(a.status, SLOTS)
            .array(a.params, (Plane::OPACITY + 1) * a.stride)
            .run([a.count.div_ceil(self.lanes), 1], [self.local, 1])
    }
}
