//! Loss weights and the optimiser.

use serde::{Deserialize, Serialize};

use crate::base::error::{Error, Result};

/// Loss weights (\[MH\] Eq. 4).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, rename_all = "kebab-case", deny_unknown_fields)]
pub struct LossConfig {
    /// λ: share of 1 − SSIM against L1.
    pub lambda_ssim: f64,
    /// λ_o: weight of the mean opacity.
    pub lambda_opacity: f64,
    /// λ_s: weight of the mean scale, in local units (scene extent 1). The papers' 0.01 is per world unit, and their scenes
    /// have an extent of about five.
    pub lambda_scale: f64,
}

impl Default for LossConfig {
    fn default() -> Self {
        Self {
            lambda_ssim: 0.2,
            lambda_opacity: 0.01,
            lambda_scale: 0.05,
        }
    }
}

/// Adam's constants and learning rates (\[MH\] §5.1, \[3DGS\] §7.1).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, rename_all = "kebab-case", deny_unknown_fields)]
pub struct OptimizerConfig {
    /// Decay of the first moment.
    pub beta1: f64,
    /// Decay of the second moment in a run of 30,000 iterations, and of the colour transforms in any; with `lr-scales-with-run` shorter ones forget sooner (see `Schedule::beta2`).
    pub beta2: f64,
    /// ε, added to the root of the second moment.
    pub epsilon: f64,
    /// Learning rate of the positions at the start, per unit of scene extent.
    pub lr_position: f64,
    /// Learning rate of the positions at the end (log-linear in between).
    pub lr_position_final: f64,
    /// Learning rate of SH degree 0.
    pub lr_sh0: f64,
    /// Learning rate of the higher SH bands.
    pub lr_sh: f64,
    /// Learning rate of the opacity logit, for every sampler (\[3DGS\] as published, \[MCMC\]; \[MH\] and later versions of \[3DGS\]: 0.025).
    pub lr_opacity: f64,
    /// Learning rate of the log-scale; short runs with mh take a larger multiple of it than others, see `Schedule::rates`.
    pub lr_scale: f64,
    /// Learning rate of the quaternion.
    pub lr_rotation: f64,
    /// Learning rate of the photos' colour transforms at the start (\[3DGS\], later versions).
    pub lr_exposure: f64,
    /// Learning rate of the photos' colour transforms at the end (log-linear in between).
    pub lr_exposure_final: f64,
    /// Larger steps and a shorter memory of the second moment in runs shorter than the papers' 30,000 iterations (see `Schedule::rates`, `Schedule::beta2`).
    pub lr_scales_with_run: bool,
    /// Factor on the rates of all but the positions at the end of a run; 1 for none, as in the papers. It is reached
    /// log-linearly from `lr_settle_from` on: steps as large as in the middle of a run leave a picture that flickers from one
    /// iteration to the next.
    pub lr_settle: f64,
    /// Iteration from which rates settle, of 30,000.
    pub lr_settle_from: u32,
    /// Iterations between two SH bands, for 30,000 iterations (scales with the run).
    pub sh_interval: u32,
}

impl Default for OptimizerConfig {
    fn default() -> Self {
        Self {
            beta1: 0.9,
            beta2: 0.999,
            epsilon: 1e-15,
            lr_position: 1.6e-4,
            lr_position_final: 1.6e-6,
            lr_sh0: 2.5e-3,
            lr_sh: 1.25e-4,
            lr_opacity: 0.05,
            lr_scale: 5e-3,
            lr_rotation: 1e-3,
            lr_exposure: 0.01,
            lr_exposure_final: 0.001,
            lr_scales_with_run: true,
            lr_settle: 0.1,
            lr_settle_from: 25_000,
            sh_interval: 1000,
        }
    }
}

impl OptimizerConfig {
    /// Checks every value's domain.
    pub(super) fn validate(&self) -> Result<()> {
        let o = self;
        let rates = [
            o.lr_position,
            o.lr_position_final,
            o.lr_sh0,
            o.lr_sh,
            o.lr_opacity,
            o.lr_scale,
            o.lr_rotation,
            o.lr_exposure,
            o.lr_exposure_final,
        ];
        let share = |v: f64| (0.0..1.0).contains(&v);
        let good = rates.iter().all(|v| v.is_finite() && *v >= 0.0);
        let what = "a learning rate that is negative or not finite";
        Error::unless(good, "optimizer", what)?;
        let good = o.lr_settle > 0.0 && o.lr_settle <= 1.0;
        let what = "more than 0 and no more than 1 expected";
        Error::unless(good, "optimizer.lr-settle", what)?;
        let good = share(o.beta1) && share(o.beta2) && o.epsilon > 0.0 && o.epsilon.is_finite();
        let what = "beta1 and beta2 in [0, 1) and a finite epsilon > 0 expected";
        Error::unless(good, "optimizer", what)
    }
}

impl LossConfig {
    /// Checks every value's domain.
    pub(super) fn validate(&self) -> Result<()> {
        let l = self;
        let shares = (0.0..=1.0).contains(&l.lambda_ssim);
        let weights = [l.lambda_opacity, l.lambda_scale];
        let good = shares && weights.iter().all(|w| w.is_finite() && *w >= 0.0);
        let what = "lambda-ssim in [0, 1] and other weights >= 0 expected";
        Error::unless(good, "loss", what)
    }
}
