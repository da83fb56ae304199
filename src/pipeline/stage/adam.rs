//! The optimiser (`kernels/adam.cl`).

use std::ops::Range;

use crate::base::error::Result;
use crate::device::tuning::status::SLOTS;
use crate::device::{Array, Kernel, Kernels, Real};

/// The adam stage.
#[derive(Debug)]
pub struct Adam {
    kernel: Kernel,
    vector_width: usize,
    local: usize,
}

/// Learning rates of one iteration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LearningRates {
    /// Position, local units.
    pub position: f64,
    /// Log-scale.
    pub scale: f64,
    /// Quaternion.
    pub rotation: f64,
    /// Opacity logit.
    pub opacity: f64,
    /// SH degree 0.
    pub sh0: f64,
    /// Higher SH bands.
    pub sh: f64,
}

/// Arguments of [`Adam::run`].
#[derive(Debug)]
pub struct AdamArgs<'a, R: Real> {
    /// Gradients of the block \[planes, grad_stride\].
    pub grads: &'a Array<R>,
    /// Gaussians that a plane of `grads` has room for.
    pub grad_stride: usize,
    /// The Gaussians to step; starts at a multiple of 16.
    pub block: Range<usize>,
    /// Gaussians allocated, a multiple of 16.
    pub stride: usize,
    /// Planes in use (those of the SH degree in use).
    pub planes: usize,
    /// Learning rates.
    pub rates: LearningRates,
    /// β₁, β₂, ε.
    pub constants: [f64; 3],
    /// Step, from 1.
    pub step: u32,
    /// In/out \[planes, stride\].
    pub params: &'a Array<R>,
    /// In/out \[planes, stride\].
    pub moment1: &'a Array<R>,
    /// In/out \[planes, stride\].
    pub moment2: &'a Array<R>,
    /// Status array.
    pub status: &'a Array<u32>,
}

impl Adam {
    /// Builds the kernel.
    ///
    /// # Errors
    /// A build failure.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let [kernel] = kernels.build::<R, 1>("adam", ["adam"])?;
        let tuning = kernels.defines().tuning;
        Ok(Self {
            kernel,
            vector_width: tuning.vector_width as usize,
            local: tuning.local,
        })
    }

    /// Enqueues one step.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn run<R: Real>(&self, a: &AdamArgs<'_, R>) -> Result<()> {
        let len = a.planes * a.stride;
        let groups = a.block.len().div_ceil(self.vector_width);
        // As the kernel has them: 1 − β₂ of 0.999 in f32 is off by 1.3e-5 of itself, and the corrections must be off likewise.
        let [beta1, beta2, epsilon] = a.constants.map(R::of);
        let left = |beta: R| 1.0 - Into::<f64>::into(beta).powf(f64::from(a.step));
        let r = &a.rates;
        self.kernel
            .launch()
            .array(a.grads, a.planes * a.grad_stride)
            .value(a.grad_stride as u32)
            .value(a.block.start as u32)
            .value(groups as u32)
            .value(a.stride as u32)
            .value(R::of(r.position))
            .value(R::of(r.scale))
            .value(R::of(r.rotation))
            .value(R::of(r.opacity))
            .value(R::of(r.sh0))
            .value(R::of(r.sh))
            .value(beta1)
            .value(beta2)
            .value(epsilon)
            .value(R::of(1.0 / left(beta1)))
            .value(R::of(1.0 / left(beta2).sqrt()))
            .array(a.params, len)
            .array(a.moment1, len)
            .array(a.moment2, len)
            .array(a.status, SLOTS)
            .run([groups, a.planes], [self.local, 1])
    }
}

/// Constants of one step of one plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// Learning rate.
    pub rate: f64,
    /// β₁, β₂, ε.
    pub constants: [f64; 3],
    /// Step, from 1.
    pub t: u32,
}

/// One step of one plane; a gradient that is not finite (or whose square would not be, in f32) counts as 0. Returns how
/// many did.
pub fn adam(grads: &[f64], step: &Step, params: &mut [f64], m: &mut [f64], v: &mut [f64]) -> u32 {
    let [beta1, beta2, epsilon] = step.constants;
    let t = f64::from(step.t);
    let mut bad = 0;
    for (i, raw) in grads.iter().enumerate() {
        let good = raw.abs() < 1e18;
        bad += u32::from(!good);
        let g = if good { *raw } else { 0.0 };
        m[i] = beta1 * m[i] + (1.0 - beta1) * g;
        v[i] = beta2 * v[i] + (1.0 - beta2) * g * g;
        let m_hat = m[i] / (1.0 - beta1.powf(t));
        let v_hat = v[i] / (1.0 - beta2.powf(t));
        params[i] -= step.rate * m_hat / (v_hat.sqrt() + epsilon);
    }
    bad
}
