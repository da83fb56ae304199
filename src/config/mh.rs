//! Settings of Metropolis–Hastings density control, each with its equation in \[MH\].

use serde::{Deserialize, Serialize};

use crate::base::error::{Error, Result};
use crate::config::choices::{Acceptance, Birth, Surrogate, ViewSubset};
use crate::config::samplers::DensityTimes;

/// First iteration with births where points show what is where.
const BIRTHS_FROM: u32 = 2_500;

/// Metropolis–Hastings density control (\[MH\] §4, Alg. 1). Iteration numbers are for a run of 30,000 iterations; of two
/// values the first is for η = 0 and the second for η = 1, linear in between.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, rename_all = "kebab-case", deny_unknown_fields)]
pub struct MhConfig {
    /// Form of ρ (Eq. 18–20, Alg. 1).
    pub acceptance: Acceptance,
    /// Estimate of a birth's loss change in ρ.
    pub surrogate: Surrogate,
    /// Number of views that births are estimated in, those that training takes next (only for `surrogate = "probe"`); all if
    /// there are fewer.
    pub probe_views: u32,
    /// Opacity and scale of a birth, and its source (§4.3). `None`: see [`MhConfig::form`].
    pub birth: Option<Birth>,
    /// Upper bound of the opacity of a faint birth.
    pub birth_opacity: f64,
    /// Scale of a faint birth over that of its source.
    pub birth_scale: f64,
    /// Distance of the two parts of a split source from its centre, in its standard deviations along the axis of the split; at most 0.95, for parts of opaque
    /// sources would paint ever less. Below 0.87 parts of faint sources are fainter than these.
    pub split_distance: f64,
    /// λ_v of the voxel prior (Eq. 7); 0 switches the prior off: every D and every exact ratio is 1.
    pub lambda_voxel: f64,
    /// Temperature T of the acceptance: a birth is accepted with probability ρ^{1/T}. 1 is the paper's; larger values accept
    /// more. Of no effect if `target_acceptance` is set.
    pub temperature: [f64; 2],
    /// Target share of accepted births: each phase takes the T at which the mean of ρ^{1/T} over its own proposals is this share,
    /// instead of `temperature`. 0: `temperature` is used.
    pub target_acceptance: [f64; 2],
    /// Importance sampling: sources are drawn by importance and I is in ρ (Eq. 12, 13). If off, sources are drawn uniformly,
    /// I = ½, and no error map is made.
    pub importance: bool,
    /// Weight of the opacity, less its mean over its standard deviation, in the importance (Eq. 13); 0 leaves the cue out.
    pub weight_opacity: f64,
    /// Weight of 1 − SSIM; 0 leaves the cue out.
    pub weight_ssim: f64,
    /// Weight of L1; 0 leaves the cue out.
    pub weight_l1: f64,
    /// Views that the error maps are of (Eq. 10), limited to those rendered since the last step.
    pub view_subset: ViewSubset,
    /// Relocation of dead Gaussians to alive ones (Eq. 17) once `deaths-until-iteration` is over. If off, the dead are removed at
    /// every step.
    pub relocation: bool,
    /// First iteration with density control.
    pub from_iteration: u32,
    /// Iteration until which dead Gaussians are removed with `relocation`, too: what is not seen costs nothing to take away (ΔL ≈ 0, and the prior gains), while fog that is relocated keeps its number. 0: never removed, as in \[MH\].
    pub deaths_until_iteration: u32,
    /// First iteration with births: a step before it has none, and costs no error map and no proposal. `None`: the first step where
    /// the first Gaussians are random, else 2500. Gaussians born while the photos are coarse and those of points still move into
    /// place cost time in every later iteration; where nothing is in place they find it.
    pub births_from_iteration: Option<u32>,
    /// Last iteration with density control; η runs from 0 to 1 over the span.
    pub until_iteration: u32,
    /// Iterations between two density steps; fewer in short runs, see `Schedule::density_interval`.
    pub interval: u32,
    /// Coarse proposals per step at η = 0 (Eq. 15); 0 leaves the phase out. With `turnover`, and without `relocation`, all numbers of proposals are those of each of 15 steps: where there are n > 15 each has
    /// 15/n times as many, a rate over η as that of deaths.
    pub coarse_proposals: u32,
    /// Fine proposals per step at η = 0 (Eq. 16), as `coarse_proposals`; 0 leaves the phase out.
    pub fine_proposals: u32,
    /// Standard deviations of a coarse birth about its source (one that does not split) over the source's own, along each of its axes (Eq. 15: 10 to 5): at 1 births are where
    /// the source itself is dense. Farther ones are at places that nothing has shown to be on a surface, and training fits them to single photos.
    pub coarse_spread: [f64; 2],
    /// The same of a fine birth (Eq. 16: 2 to 1).
    pub fine_spread: [f64; 2],
    /// Voxel edge s of Eq. 7, in local units (scene extent 1; the papers' scenes have 1–10 units).
    pub voxel_edge: [f64; 2],
    /// Distance from the nearest camera centre, local units, beyond which the voxel edge grows: at distance d it is
    /// s·2^⌊log2(d / this)⌋. 0: the edge is s everywhere, as in Eq. 7.
    pub voxel_growth_from: f64,
    /// Births proposed in image space per step at η = 0, as `coarse_proposals`, at pixels drawn ∝ e·(τ + s·(1−τ)) with L1 error e, remaining
    /// transmittance τ and s = `pixel-surface`, times the share Σ e·(τ + s·(1−τ)) / Σ e of the error that is drawn from: all
    /// of it at s = 1, none at s = 0 in a scene without voids. 0 leaves them out. They reach places too far from every
    /// Gaussian for a copy of one, and are not in the paper.
    pub pixel_proposals: u32,
    /// Number of views whose pixels are drawn from, and which have to agree: those that training takes next.
    pub pixel_views: u32,
    /// Standard deviation of such a birth, pixels.
    pub pixel_scale: f64,
    /// Opacity of such a birth.
    pub pixel_opacity: f64,
    /// s: 1 draws pixels ∝ error alone, 0 only in proportion to the transmittance that is left beyond the rendered surface.
    pub pixel_surface: f64,
    /// Relative difference of rendered depths up to which two views show the same surface. A birth lies on a rendered surface
    /// only where another of the views shows the same one and none shows something behind it; 0 does not ask.
    pub pixel_tolerance: f64,
    /// Depth of a birth beyond the rendered surface, where it lies with probability τ/(τ + s·(1−τ)): log-uniform between these
    /// two, local units, and no nearer than the rendered mean depth, which the other births have.
    pub pixel_far: [f64; 2],
    /// Lower bound of the depth of such a birth, local units: one close to a camera is seen by that camera alone, and hides
    /// what others see.
    pub pixel_near: f64,
    /// Pixels per Gaussian in the bound on births: with V opaque training photos of p pixels in all, no births beyond the largest of
    /// p·(V − 1)/2 over this, p/64 and the number of sparse points (those found in the photos do not count), because more overfit few photos; 0 for no bound. `--max-gaussians`
    /// replaces it. Transparent and masked photos, random starts and starts from a file have none.
    pub pair_pixels: f64,
    /// Noise on the positions between the steps, per unit of the position's learning rate, with \[MCMC\]'s gate as for
    /// `mcmc.noise-rate`; 0 for none, as in \[MH\]. It moves faint Gaussians, and so clears the fog of a random start.
    pub noise_rate: f64,
    /// Opacity at or below which a Gaussian is dead.
    pub dead_opacity: f64,
    /// Rate over η at which Gaussians that are not dead die, those of least opacity first: a step Δη after the one before removes the
    /// share 1 − exp(−turnover·Δη) of them, at most 0.15. A run of more steps removes no more of them. From
    /// `births-from-iteration` on, at the last step, too; none with `relocation` or without proposals.
    pub turnover: f64,
}

impl Default for MhConfig {
    fn default() -> Self {
        Self {
            acceptance: Acceptance::Eq20,
            surrogate: Surrogate::Importance,
            probe_views: 4,
            birth: None,
            birth_opacity: 0.1,
            birth_scale: 0.6,
            split_distance: 0.9,
            lambda_voxel: 5.0,
            temperature: [1.0, 1.0],
            target_acceptance: [0.5, 0.95],
            importance: true,
            weight_opacity: 0.8,
            weight_ssim: 0.5,
            weight_l1: 0.5,
            view_subset: ViewSubset::Shrinking,
            relocation: false,
            from_iteration: 500,
            deaths_until_iteration: 6_000,
            births_from_iteration: None,
            until_iteration: 20_000,
            interval: 100,
            coarse_proposals: 0,
            fine_proposals: 22_500,
            coarse_spread: [1.0, 1.0],
            fine_spread: [1.0, 1.0],
            voxel_edge: [0.02, 0.005],
            voxel_growth_from: 0.0,
            pixel_proposals: 7_500,
            pixel_views: 4,
            pixel_scale: 2.0,
            pixel_opacity: 0.1,
            pixel_surface: 1.0,
            pixel_tolerance: 0.1,
            pixel_far: [2.0, 20.0],
            pixel_near: 0.3,
            pair_pixels: 700.0,
            noise_rate: 5e5,
            dead_opacity: 0.005,
            turnover: 1.6,
        }
    }
}

impl MhConfig {
    /// Returns the defaults with the paper's own numbers (\[MH\] §4, Alg. 1).
    #[must_use]
    pub fn paper() -> Self {
        Self {
            birth: Some(Birth::Copy),
            relocation: true,
            turnover: 0.0,
            target_acceptance: [0.0, 0.0],
            deaths_until_iteration: 0,
            births_from_iteration: Some(500),
            until_iteration: 15_000,
            coarse_proposals: 4_500,
            fine_proposals: 16_000,
            coarse_spread: [10.0, 5.0],
            fine_spread: [2.0, 1.0],
            pixel_proposals: 0,
            pair_pixels: 0.0,
            noise_rate: 0.0,
            ..Self::default()
        }
    }

    /// Checks every value's domain.
    ///
    /// # Errors
    /// The first option that is out of its domain.
    pub fn validate(&self) -> Result<()> {
        let above_zero = |v: &f64| v.is_finite() && *v > 0.0;
        let not_below = |v: &f64| v.is_finite() && *v >= 0.0;
        let faint = |o: f64| o > self.dead_opacity && o < 1.0;
        let check =
            |good, option: &str, what: &str| Error::unless(good, &format!("mh.{option}"), what);
        let lengths = self.voxel_edge.iter().all(above_zero);
        check(lengths, "voxel-edge", "two lengths above 0 expected")?;
        let mut spreads = self.coarse_spread.iter().chain(&self.fine_spread);
        let options = "coarse-spread, mh.fine-spread";
        check(spreads.all(not_below), options, "0 or more expected")?;
        for (value, option) in [
            (self.lambda_voxel, "lambda-voxel"),
            (self.voxel_growth_from, "voxel-growth-from"),
            (self.noise_rate, "noise-rate"),
            (self.pair_pixels, "pair-pixels"),
        ] {
            check(not_below(&value), option, "a finite value >= 0 expected")?;
        }
        let good = self.temperature.iter().all(above_zero);
        check(good, "temperature", "two values above 0 expected")?;
        let target = self.target_acceptance;
        let good = target.iter().all(|r| *r > 0.0 && *r < 1.0) || target == [0.0, 0.0];
        let what = "two shares between 0 and 1, or [0, 0] for none, expected";
        check(good, "target-acceptance", what)?;
        let opacity = "more than dead-opacity and less than 1 expected";
        check(faint(self.birth_opacity), "birth-opacity", opacity)?;
        let good = self.birth_scale > 0.0 && self.birth_scale <= 1.0;
        check(good, "birth-scale", "more than 0 and at most 1 expected")?;
        let good = self.split_distance > 0.0 && self.split_distance <= 0.95;
        check(
            good,
            "split-distance",
            "more than 0 and at most 0.95 expected",
        )?;
        let good = self
            .births_from_iteration
            .is_none_or(|from| from <= self.until_iteration);
        let what = "no more than mh.until-iteration expected";
        check(good, "births-from-iteration", what)?;
        if self.pixel_proposals > 0 {
            let [near, far] = self.pixel_far;
            let depths = near > 0.0 && far >= near && far.is_finite();
            let good = self.pixel_views > 0 && above_zero(&self.pixel_scale) && depths;
            let options = "pixel-views, mh.pixel-scale, mh.pixel-far";
            let what = "values above 0, and a far depth not below the near one, expected";
            check(good, options, what)?;
            let good = not_below(&self.pixel_near);
            check(good, "pixel-near", "0 or more expected")?;
            let good = (0.0..=1.0).contains(&self.pixel_surface);
            check(good, "pixel-surface", "0 to 1 expected")?;
            let good = (0.0..1.0).contains(&self.pixel_tolerance);
            check(
                good,
                "pixel-tolerance",
                "0 or more and less than 1 expected",
            )?;
            let asks = self.pixel_tolerance > 0.0 && self.pixel_surface > 0.0;
            let what = "1; with a pixel-tolerance above 0 at least 2 expected: another view has to show the same surface";
            check(self.pixel_views > 1 || !asks, "pixel-views", what)?;
            check(faint(self.pixel_opacity), "pixel-opacity", opacity)?;
        }
        if self.surrogate == Surrogate::Probe {
            let what = "0; at least 1 expected";
            check(self.probe_views > 0, "probe-views", what)?;
            // The other forms weigh I in other ways, and there is no I in ρ.
            let other = matches!(self.acceptance, Acceptance::Alg1 | Acceptance::Centred);
            let what = "\"probe\" goes with the acceptance \"eq20\" (or \"exact-prior\", where nothing is estimated)";
            check(!other, "surrogate", what)?;
            let what = "\"probe\" judges births that leave their sources as they are: mh.birth \"faint\" or \"copy\" expected";
            let moves = self.form() == Birth::Split && self.estimate_views() > 0;
            check(!moves, "surrogate", what)?;
        }
        let what = "0 or more expected";
        check(not_below(&self.turnover), "turnover", what)?;
        let weights = [self.weight_opacity, self.weight_ssim, self.weight_l1];
        let finite = weights.iter().all(|w| w.is_finite());
        let good = finite && (0.0..1.0).contains(&self.dead_opacity);
        let what = "finite weights and a dead-opacity in [0, 1) expected";
        check(good, "weight-*, mh.dead-opacity", what)?;
        self.times().validate("mh")
    }

    /// True if Gaussians die that are not dead: there is a turnover, no relocation, and births are proposed.
    #[must_use]
    pub fn turns_over(&self) -> bool {
        let kinds = [
            self.coarse_proposals,
            self.fine_proposals,
            self.pixel_proposals,
        ];
        self.turnover > 0.0 && !self.relocation && kinds.iter().any(|n| *n > 0)
    }

    /// Returns the number of views that the births of a step are estimated in; 0 if ρ does not use them.
    #[must_use]
    pub fn estimate_views(&self) -> usize {
        match (self.surrogate, self.acceptance) {
            (Surrogate::Importance, _) | (_, Acceptance::ExactPrior) => 0,
            (Surrogate::Probe, _) => self.probe_views as usize,
        }
    }

    /// Returns the form of births: unless one is chosen they split their sources, or are faint where they are estimated, because an estimate is
    /// of a birth that leaves its source as it is.
    #[must_use]
    pub fn form(&self) -> Birth {
        self.birth.unwrap_or(match self.estimate_views() {
            0 => Birth::Split,
            _ => Birth::Faint,
        })
    }

    /// True if a step at progress η has births.
    #[must_use]
    pub fn births_enabled(&self, progress: f64) -> bool {
        // Where density control ends before, they begin with it.
        let usual = match self.until_iteration > BIRTHS_FROM {
            true => BIRTHS_FROM,
            false => self.from_iteration,
        };
        self.passed(self.births_from_iteration.unwrap_or(usual), progress)
    }

    /// True if a step at progress η removes dead Gaussians.
    #[must_use]
    pub fn removes_dead(&self, progress: f64) -> bool {
        !self.passed(self.deaths_until_iteration, progress)
    }

    fn passed(&self, iteration: u32, progress: f64) -> bool {
        let span = f64::from(self.until_iteration) - f64::from(self.from_iteration);
        let start = f64::from(iteration) - f64::from(self.from_iteration);
        // η is a quotient: a step at the start may come out a little below it.
        progress * span + 1e-6 >= start
    }

    /// True if the importance uses error maps.
    #[must_use]
    pub fn wants_errors(&self) -> bool {
        self.importance && (self.weight_ssim != 0.0 || self.weight_l1 != 0.0)
    }

    /// Returns when density control acts.
    pub(super) fn times(&self) -> DensityTimes {
        DensityTimes {
            from: self.from_iteration,
            until: self.until_iteration,
            interval: self.interval,
            after_from: false,
        }
    }
}
