//! Noise on the positions (`kernels/noise.cl`).

use crate::base::constants::LOG_SCALE;
use crate::base::error::Result;
use crate::base::math::sigmoid;
use crate::base::rng::Philox;
use crate::density::NoiseLaw;
use crate::device::tuning::status::SLOTS;
use crate::device::{Array, Kernel, Kernels, Real};
use crate::pipeline::reference::{Scene64, product, rotation, transpose, unit_quaternion};
use crate::scene::Plane;

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

/// Displacement of Gaussian `i`: rate·Σ·ξ·σ(−k·(o − x₀)), ξ the first three of the host's normal numbers at (seed, stream, i).
#[must_use]
pub fn noise(scene: &Scene64, i: usize, law: &NoiseLaw, seed: u64, stream: u64) -> [f64; 3] {
    let [x, y, z, _] = Philox::normal(seed, stream, i as u64);
    let (q, _) = unit_quaternion(scene.gather(Plane::ROTATION, i));
    let rot = rotation(q);
    let scale: [f64; 3] = scene.gather(Plane::LOG_SCALE, i);
    let scale = scale.map(|l| l.clamp(LOG_SCALE[0], LOG_SCALE[1]).exp());
    let rs: [[f64; 3]; 3] = std::array::from_fn(|r| std::array::from_fn(|k| rot[r][k] * scale[k]));
    let sigma = product(&rs, &transpose(&rs));
    let opacity = sigmoid(scene.planes[Plane::OPACITY][i]);
    let gate = sigmoid(-law.steepness * (opacity - law.opacity));
    product(&sigma, &[[x], [y], [z]]).map(|[v]| law.rate * gate * v)
}
