//! [`TrainConfig`]: every number of a run, with the paper's defaults.
//!
//! \[MH\] = Kim, Jung, Park, NeurIPS 2025 (arXiv 2506.12945); \[3DGS\] = Kerbl et al. 2023; \[MCMC\] = Kheradmand et al. 2024.

mod anti_aliasing;
mod choices;
mod mh;
mod samplers;
mod values;
mod work;

pub use crate::config::anti_aliasing::AntiAliasing;
pub use crate::config::choices::{Acceptance, Birth, Surrogate, ViewSubset};
pub use crate::config::mh::MhConfig;
pub use crate::config::samplers::{AdcConfig, DensityTimes, McmcConfig, Sampler};
pub use crate::config::values::{Background, ExposureChoice, Init, parse_bytes, parse_duration};
pub use crate::config::work::WorkConfig;

use serde::{Deserialize, Serialize};

use crate::base::error::{Error, Result};
use crate::config::values::{bytes_or_number, duration_or_number};

/// Loss weights (\[MH\] Eq. 4).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, rename_all = "kebab-case", deny_unknown_fields)]
pub struct LossConfig {
    /// λ: share of 1 − SSIM against L1.
    pub lambda_ssim: f32,
    /// λ_o: weight of the mean opacity.
    pub lambda_opacity: f32,
    /// λ_s: weight of the mean scale, in local units (scene extent 1). The papers' 0.01 is per world unit, and their scenes
    /// have an extent of about five.
    pub lambda_scale: f32,
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
    pub beta1: f32,
    /// Decay of the second moment.
    pub beta2: f32,
    /// ε.
    pub epsilon: f32,
    /// Position, at the start, per unit of scene extent.
    pub lr_position: f32,
    /// Position, at the end (log-linear in between).
    pub lr_position_final: f32,
    /// SH degree 0.
    pub lr_sh0: f32,
    /// Higher SH bands.
    pub lr_sh: f32,
    /// Opacity logit, for every sampler (\[3DGS\] as published, \[MCMC\]; \[MH\] and later versions of \[3DGS\]: 0.025).
    pub lr_opacity: f32,
    /// Log-scale.
    pub lr_scale: f32,
    /// Quaternion.
    pub lr_rotation: f32,
    /// Entries of the photos' colour transforms, at the start (\[3DGS\], later versions).
    pub lr_exposure: f32,
    /// Entries of the photos' colour transforms, at the end (log-linear in between).
    pub lr_exposure_final: f32,
    /// Whether runs shorter than the papers' 30,000 iterations take larger steps (see `Schedule::rates`).
    pub lr_scales_with_run: bool,
    /// Factor on the rates of all but the positions at the end of a run; 1 for none, as in the papers. It is reached
    /// log-linearly from `lr_settle_from` on: steps as large as in the middle of a run leave a picture that flickers from one
    /// iteration to the next.
    pub lr_settle: f32,
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

/// Everything a run depends on beside the dataset and the device.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, rename_all = "kebab-case", deny_unknown_fields)]
pub struct TrainConfig {
    /// Density control.
    pub sampler: Sampler,
    /// Iterations; every schedule scales with it (the papers': 30,000).
    pub iterations: u32,
    /// Stop after this many seconds of training.
    #[serde(deserialize_with = "duration_or_number")]
    pub time_budget: Option<f64>,
    /// Stop when so many evaluations in a row found the training loss no lower than before them by 0.1 % (none: never).
    pub patience: Option<u32>,
    /// Longest image side in pixels; larger photos are area-filtered down.
    pub max_size: u32,
    /// Bytes that the decoded photos may take; what does not fit is decoded on demand, which changes no result (none: half of
    /// the memory available at the start).
    #[serde(deserialize_with = "bytes_or_number")]
    pub image_budget: Option<u64>,
    /// Upper bound of the number of Gaussians, for every sampler (none: no bound, but for mcmc `McmcConfig::cap`).
    pub max_gaussians: Option<usize>,
    /// SH degree, 0 to 3.
    pub sh_degree: u32,
    /// Seed of every random number.
    pub seed: u64,
    /// Iterations between two evaluations of the held-out views (0: only at the end; none: a twentieth of the run).
    pub eval_every: Option<u32>,
    /// Every n-th image by name is held out (0: none).
    pub test_every: u32,
    /// Iterations between two exports of the scene (0: only at the end).
    pub export_every: u32,
    /// Iterations between two checkpoints (0: only on Ctrl-C).
    pub checkpoint_every: u32,
    /// Where the first Gaussians come from.
    pub init: Init,
    /// Whether the photos' alpha is a mask of what counts, not transparency.
    pub alpha_is_mask: bool,
    /// What lies behind the scene.
    pub background: Background,
    /// Mip-Splatting's filters.
    pub anti_aliasing: AntiAliasing,
    /// Whether every training photo has a colour transform of its own, x' = A x + b, between render and loss.
    pub exposure: ExposureChoice,
    /// Loss weights.
    pub loss: LossConfig,
    /// Optimiser.
    pub optimizer: OptimizerConfig,
    /// Metropolis–Hastings density control.
    pub mh: MhConfig,
    /// Ways to do less work.
    pub work: WorkConfig,
    /// MCMC density control.
    pub mcmc: McmcConfig,
    /// Adaptive density control.
    pub adc: AdcConfig,
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            sampler: Sampler::Mh,
            iterations: 30_000,
            time_budget: None,
            patience: None,
            max_size: 1600,
            image_budget: None,
            max_gaussians: None,
            sh_degree: 3,
            seed: 0,
            eval_every: None,
            test_every: 8,
            export_every: 0,
            checkpoint_every: 1000,
            init: Init::Points,
            alpha_is_mask: false,
            background: Background::Auto,
            anti_aliasing: AntiAliasing::Auto,
            exposure: ExposureChoice::Auto,
            loss: LossConfig::default(),
            optimizer: OptimizerConfig::default(),
            mh: MhConfig::default(),
            work: WorkConfig::default(),
            mcmc: McmcConfig::default(),
            adc: AdcConfig::default(),
        }
    }
}

impl TrainConfig {
    /// Checks every value's domain.
    ///
    /// # Errors
    /// The first option that is out of its domain.
    pub fn validate(&self) -> Result<()> {
        let fail = |option: &str, what: String| Err(Error::config(option, what));
        if self.iterations == 0 {
            return fail("--iterations", "0; at least 1 expected".into());
        }
        if self.sh_degree > 3 {
            return fail(
                "--sh-degree",
                format!("{}; 0 to 3 expected", self.sh_degree),
            );
        }
        if self.max_size < 16 || self.max_size > 65_535 {
            return fail(
                "--max-size",
                format!("{}; 16 to 65535 expected", self.max_size),
            );
        }
        if self.image_budget == Some(0) {
            return fail("--image-budget", "0; at least 1 byte expected".into());
        }
        if self.max_gaussians == Some(0) {
            return fail("--max-gaussians", "0; at least 1 expected".into());
        }
        if let Some(t) = self.time_budget
            && !(t.is_finite() && t > 0.0)
        {
            return fail("--time-budget", format!("{t} s; a positive time expected"));
        }
        if self.patience.is_some() && (self.patience == Some(0) || self.eval_every == Some(0)) {
            let what = "at least 1 evaluation, and some during the run (--eval-every), expected";
            return fail("--patience", what.into());
        }
        if let Background::Color(c) = self.background
            && !c.iter().all(|v| (0.0..=1.0).contains(v))
        {
            return fail("--background", format!("{c:?}; R,G,B in 0 to 1 expected"));
        }
        self.work.validate()?;
        self.optimizer.validate()?;
        self.loss.validate()?;
        self.mh.validate()?;
        self.mcmc.validate()?;
        self.adc.validate()
    }
}

impl OptimizerConfig {
    fn validate(&self) -> Result<()> {
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
        if !rates.iter().all(|v| v.is_finite() && *v >= 0.0) {
            return Err(Error::config(
                "optimizer",
                "a learning rate that is negative or not finite",
            ));
        }
        if !(o.lr_settle > 0.0 && o.lr_settle <= 1.0) {
            return Err(Error::config(
                "optimizer.lr-settle",
                "more than 0 and no more than 1 expected",
            ));
        }
        if !((0.0..1.0).contains(&o.beta1) && (0.0..1.0).contains(&o.beta2) && o.epsilon > 0.0) {
            return Err(Error::config(
                "optimizer",
                "beta1 and beta2 in [0, 1) and epsilon > 0 expected",
            ));
        }
        Ok(())
    }
}

impl LossConfig {
    fn validate(&self) -> Result<()> {
        let l = self;
        let shares = (0.0..=1.0).contains(&l.lambda_ssim);
        let weights = [l.lambda_opacity, l.lambda_scale];
        if !(shares && weights.iter().all(|w| w.is_finite() && *w >= 0.0)) {
            return Err(Error::config(
                "loss",
                "lambda-ssim in [0, 1] and other weights >= 0 expected",
            ));
        }
        Ok(())
    }
}
