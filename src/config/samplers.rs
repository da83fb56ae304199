//! The samplers and their own settings. Everything else of a run is the same for all of them, but the rate of scales in short runs (`Schedule::rates`).

use serde::{Deserialize, Serialize};

use crate::base::error::{Error, Result};

/// Density control: `mh` is \[MH\] §4, `mcmc` is \[MCMC\] §3, `adc` is \[3DGS\] §5.2.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Sampler {
    /// Metropolis-Hastings births and relocation.
    #[default]
    Mh,
    /// Noise on the positions, relocation, 5 % growth per step up to a cap (3DGS-MCMC).
    Mcmc,
    /// Clone, split, prune, opacity reset (3DGS).
    Adc,
    /// A fixed set of Gaussians.
    None,
}

/// MCMC density control (\[MCMC\] §3 and its released implementation). Iteration numbers are for a run of 30,000 iterations.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, rename_all = "kebab-case", deny_unknown_fields)]
pub struct McmcConfig {
    /// Noise per unit of the position's learning rate (released code, `noise_lr`): x += Σ·ξ·gate·noise-rate·lr. It has the
    /// unit of an inverse squared length; see `world_extent`.
    pub noise_rate: f64,
    /// Scene extent, in the units that `noise_rate` is for. In local units, in which the extent is 1, Σ shrinks by e² while
    /// position and learning rate shrink by e each: the noise of a scene of extent e is e² times as strong as the same
    /// formula says here. 1 takes the formula as it stands, as gsplat does in its own normalised units; the released code's
    /// scenes come to about 5 in theirs (measured on one indoor scene at 1,500 and 3,000 iterations, one run each: 28.8 and
    /// 29.9 dB with 5, 29.3 and 30.0 dB with 1).
    pub world_extent: f64,
    /// k of the gate σ(−k·(o − x₀)), which spares opaque Gaussians (\[MCMC\] Eq. 8).
    pub noise_steepness: f64,
    /// x₀ of the gate, the opacity at which it is one half.
    pub noise_opacity: f64,
    /// Opacity at or below which a Gaussian is dead, and relocated (\[MCMC\] §3.2).
    pub dead_opacity: f64,
    /// Gaussians after a step over those before it, until the cap (\[MCMC\] §4: 5 % more).
    pub growth: f64,
    /// Upper bound of the number of Gaussians if `max-gaussians` is not set. The released code demands a cap; gsplat's default
    /// is this.
    pub cap: usize,
    /// Density steps come after this iteration (released code, `densify_from_iter`).
    pub from_iteration: u32,
    /// Density steps come before this iteration (`densify_until_iter`); the noise goes on to the end.
    pub until_iteration: u32,
    /// Iterations between two density steps (`densification_interval`).
    pub interval: u32,
}

impl Default for McmcConfig {
    fn default() -> Self {
        Self {
            noise_rate: 5e5,
            world_extent: 1.0,
            noise_steepness: 100.0,
            noise_opacity: 0.005,
            dead_opacity: 0.005,
            growth: 1.05,
            cap: 1_000_000,
            from_iteration: 500,
            until_iteration: 25_000,
            interval: 100,
        }
    }
}

impl McmcConfig {
    pub(super) fn validate(&self) -> Result<()> {
        let rates = [self.noise_rate, self.world_extent, self.noise_steepness];
        let good = rates.iter().all(|v| v.is_finite() && *v >= 0.0);
        let what = "noise-rate, world-extent and noise-steepness of 0 or more expected";
        Error::unless(good, "mcmc", what)?;
        let mut opacities = [self.noise_opacity, self.dead_opacity].into_iter();
        let good = opacities.all(|o| (0.0..1.0).contains(&o));
        let what = "noise-opacity and dead-opacity in [0, 1) expected";
        Error::unless(good, "mcmc", what)?;
        let good = (1.0..=2.0).contains(&self.growth) && self.cap > 0;
        let what = "growth from 1 to 2 and a cap of at least 1 expected";
        Error::unless(good, "mcmc", what)?;
        self.times().validate("mcmc")
    }

    pub(super) fn times(&self) -> DensityTimes {
        DensityTimes {
            from: self.from_iteration,
            until: self.until_iteration,
            interval: self.interval,
            after_from: true,
        }
    }
}

/// Adaptive density control (\[3DGS\] §5.2 and its released implementation). Iteration numbers are for a run of 30,000
/// iterations; lengths are in local units, in which the scene extent is 1, so that its fractions of the extent stand as they
/// are.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, rename_all = "kebab-case", deny_unknown_fields)]
pub struct AdcConfig {
    /// Threshold above which a Gaussian is cloned or split: the mean norm of the gradient of its projected centre, in normalised device
    /// coordinates (−1 to 1 over the image), over the iterations that saw it (τ_pos, \[3DGS\] §5.2).
    pub grad_threshold: f64,
    /// Largest scale of a Gaussian that is cloned; above it, it is split (released code, `percent_dense`).
    pub clone_scale: f64,
    /// Scale of a Gaussian over that of the two it is split into (φ, \[3DGS\] §5.2).
    pub split_shrink: f64,
    /// Opacity below which a Gaussian is pruned (released code, `min_opacity`).
    pub prune_opacity: f64,
    /// Largest scale that is not pruned after the first opacity reset (released code, `big_points_ws`). The released code
    /// also compares the largest radius in pixels with 20, but sets those radii to zero just before, so that nothing is
    /// pruned by them: they are not kept here.
    pub prune_scale: f64,
    /// Upper bound of the opacities after a reset (released code, `reset_opacity`).
    pub reset_opacity: f64,
    /// Iterations between two opacity resets (N, \[3DGS\] §5.2), each at the first density step from then on.
    pub reset_interval: u32,
    /// Density steps come after this iteration (released code, `densify_from_iter`).
    pub from_iteration: u32,
    /// Density steps come before this iteration (`densify_until_iter`).
    pub until_iteration: u32,
    /// Iterations between two density steps (`densification_interval`).
    pub interval: u32,
}

impl Default for AdcConfig {
    fn default() -> Self {
        Self {
            grad_threshold: 2e-4,
            clone_scale: 0.01,
            split_shrink: 1.6,
            prune_opacity: 0.005,
            prune_scale: 0.1,
            reset_opacity: 0.01,
            reset_interval: 3000,
            from_iteration: 500,
            until_iteration: 15_000,
            interval: 100,
        }
    }
}

impl AdcConfig {
    pub(super) fn validate(&self) -> Result<()> {
        let lengths = [self.grad_threshold, self.clone_scale, self.prune_scale];
        let good = lengths.iter().all(|v| v.is_finite() && *v >= 0.0);
        let what = "grad-threshold, clone-scale and prune-scale of 0 or more expected";
        Error::unless(good, "adc", what)?;
        let good = self.split_shrink.is_finite() && self.split_shrink >= 1.0;
        Error::unless(good, "adc.split-shrink", "at least 1 expected")?;
        let reset = self.reset_opacity;
        let good = (0.0..1.0).contains(&self.prune_opacity) && reset > 0.0 && reset < 1.0;
        let what = "prune-opacity in [0, 1) and reset-opacity between 0 and 1 expected";
        Error::unless(good, "adc", what)?;
        let good = self.reset_interval > 0 && self.reset_interval >= self.from_iteration;
        let what = "at least 1, and no less than adc.from-iteration, expected";
        Error::unless(good, "adc.reset-interval", what)?;
        self.times().validate("adc")
    }

    pub(super) fn times(&self) -> DensityTimes {
        DensityTimes {
            from: self.from_iteration,
            until: self.until_iteration,
            interval: self.interval,
            after_from: true,
        }
    }
}

/// Iterations at which a sampler acts, for a run of 30,000 iterations.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DensityTimes {
    /// First iteration.
    pub from: u32,
    /// Iteration before which the last step comes.
    pub until: u32,
    /// Iterations between two steps.
    pub interval: u32,
    /// True if there is no step at `from` itself, as in the released implementations of \[3DGS\] and \[MCMC\].
    pub after_from: bool,
}

impl DensityTimes {
    pub(super) fn validate(&self, table: &str) -> Result<()> {
        let what = "from-iteration before until-iteration and an interval of at least 1 expected";
        Error::unless(self.from < self.until && self.interval > 0, table, what)
    }
}
