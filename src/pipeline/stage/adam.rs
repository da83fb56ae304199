//! Optimiser of the raw parameters (`kernels/adam.cl`): Adam, Kingma and Ba 2015, algorithm 1.

use crate::base::error::Result;
use crate::device::{Array, Program, Real};
use crate::pipeline::buffers::{GaussianBuffers, GradientBlock, ViewBuffers};
use crate::pipeline::launch::Arguments;

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

impl LearningRates {
    /// Rates that are `factor` times as large.
    #[must_use]
    pub fn times(self, factor: f64) -> Self {
        Self {
            position: factor * self.position,
            scale: factor * self.scale,
            rotation: factor * self.rotation,
            opacity: factor * self.opacity,
            sh0: factor * self.sh0,
            sh: factor * self.sh,
        }
    }
}

/// Constants of one step, of one plane or (with [`LearningRates`]) of all.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step<T = f64> {
    /// Learning rate.
    pub rate: T,
    /// β₁, β₂, ε.
    pub constants: [f64; 3],
    /// Number of the step: from 1 for the parameters; for colour transforms the run's iteration, from 0.
    pub t: u32,
}

impl<T> Step<T> {
    /// β₁, β₂, ε and the two bias corrections, for kernels of precision `R`. The corrections come from the rounded constants: 1 − β₂
    /// of 0.999 in f32 is off by 1.3e-5 of itself, and the corrections must be off by the same.
    pub(super) fn arguments<R: Real>(&self) -> [f64; 5] {
        let [beta1, beta2, epsilon] = self.constants.map(|c| R::of(c).into());
        let t = f64::from(self.t);
        let first = 1.0 / (1.0 - beta1.powf(t));
        let second = 1.0 / (1.0 - beta2.powf(t)).sqrt();
        [beta1, beta2, epsilon, first, second]
    }
}

impl Step<LearningRates> {
    /// The rates, then [`Step::arguments`].
    pub(super) fn numbers<R: Real>(&self) -> impl Iterator<Item = f64> + use<R> {
        let r = &self.rate;
        let rates = [r.position, r.scale, r.rotation, r.opacity, r.sh0, r.sh];
        rates.into_iter().chain(self.arguments::<R>())
    }
}

/// Enqueues one step of the Gaussians of a block with the mean gradient of its views; after an overflow in the view nothing changes.
pub fn update<R: Real>(
    stage: &Program,
    scene: &GaussianBuffers<R>,
    [m, v]: [&Array<R>; 2],
    grads: &GradientBlock<'_, R>,
    step: &Step<LearningRates>,
    view: &ViewBuffers<R>,
) -> Result<()> {
    let [first, end] =
        [grads.rows.start, grads.rows.end].map(|row| stage.vectors(row - grads.first));
    stage
        .launch("adam")
        .array(grads.values, grads.planes * grads.stride)
        .uints([grads.stride, grads.first, end])
        .reals::<R>([1.0 / grads.views as f64])
        .array(&scene.params, grads.planes * scene.stride)
        .uints([scene.stride])
        .reals::<R>(step.numbers::<R>())
        .arrays([m, v], grads.planes * scene.stride)
        .status(view)
        .starting_at([first, 0])
        .over_items([end - first, grads.planes])
}

// Definition in f64.

/// Takes one step of one plane and returns the number of gradients that are not finite (or whose square would not be, in
/// f32); they count as 0.
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
