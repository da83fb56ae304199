//! [`TrainConfig`]: all options of a run.

use serde::{Deserialize, Serialize};

use crate::base::error::{Error, Result};
use crate::config::choices::{AntiAliasing, ExposureChoice, SceneFormat, TrainingSize};
use crate::config::mh::MhConfig;
use crate::config::optimizer::{LossConfig, OptimizerConfig};
use crate::config::samplers::{AdcConfig, DensityTimes, McmcConfig, Sampler};
use crate::config::values::{Background, Init, parse_bytes, parse_duration};
use crate::config::values::{image_budget, time_budget};
use crate::config::work::WorkConfig;

/// Iterations that the papers' schedules are written for.
pub(crate) const PAPER_ITERATIONS: f64 = 30_000.0;

/// Density steps that a run has, however short it is, unless they would lie too close; numbers of proposals are those of each of so many.
pub(crate) const DENSITY_STEPS: u32 = 15;

/// Heading of the options in `--help` that a resumed run may change; the others are those of its checkpoint.
pub const RUN_CONTROL: &str = "Run control (may change with --resume)";

/// Everything a run depends on beside the dataset and the device: the flags of `mhsplat train`, with the documentation of the
/// fields as their help, and the keys of its configuration files. The tables have no flags.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, clap::Args)]
#[serde(default, rename_all = "kebab-case", deny_unknown_fields)]
pub struct TrainConfig {
    /// Density control.
    #[arg(long, value_enum, default_value_t = Self::default().sampler)]
    pub sampler: Sampler,
    /// Iterations; every schedule scales with it. With a budget the most that the run may have; with --resume those that it is to
    /// have altogether [default: those of the preset; 30000 with a budget].
    #[arg(long, value_name = "N", default_value_t = Self::default().iterations, hide_default_value = true)]
    pub iterations: u32,
    /// Views per step of the optimiser, which takes their mean gradient at rates larger by the square root of N; an iteration is one
    /// view, so that a run sees as many for any N.
    #[arg(long, value_name = "N", default_value_t = Self::default().batch)]
    pub batch: u32,
    /// Take this long (90s, 10m, 1h30m), evaluations and report included: a whole run of as many iterations as fit.
    #[arg(long, value_name = "TIME", value_parser = parse_duration, help_heading = RUN_CONTROL)]
    #[serde(deserialize_with = "time_budget")]
    pub time_budget: Option<f64>,
    /// The same in CPU seconds of the process, for CPU devices that other programs use, too.
    #[arg(long, value_name = "TIME", value_parser = parse_duration, conflicts_with = "time_budget", help_heading = RUN_CONTROL)]
    #[serde(deserialize_with = "time_budget")]
    pub budget_cpu: Option<f64>,
    /// Stop when N evaluations in a row found the training loss no lower, by 0.1 % at least [default: never].
    #[arg(long, value_name = "N", help_heading = RUN_CONTROL)]
    pub patience: Option<u32>,
    /// Longest image side, pixels; larger photos are area-filtered down.
    #[arg(long, value_name = "PX", default_value_t = Self::default().max_size)]
    pub max_size: u32,
    /// Memory for decoded photos (512M, 4G, bytes); the rest is decoded on demand, which changes no result
    /// [default: half of the available memory].
    #[arg(long, value_name = "BYTES", value_parser = parse_bytes, help_heading = RUN_CONTROL)]
    #[serde(deserialize_with = "image_budget")]
    pub image_budget: Option<u64>,
    /// Upper bound of the number of Gaussians, for any sampler [default: of few opaque
    /// photos mh's own (mh.pair-pixels), mcmc: 1000000, else none].
    #[arg(long, value_name = "N")]
    pub max_gaussians: Option<usize>,
    /// Radius of the space about each training camera that density steps keep free of Gaussians, over the distance of the sparse points
    /// nearest to it (0: none; below 1).
    #[arg(long, value_name = "SHARE", default_value_t = Self::default().clearance)]
    pub clearance: f64,
    /// SH degree, 0 to 3.
    #[arg(long, value_name = "D", default_value_t = Self::default().sh_degree)]
    pub sh_degree: u32,
    /// Seed of every random number.
    #[arg(long, value_name = "N", default_value_t = Self::default().seed)]
    pub seed: u64,
    /// Iterations between evaluations; 0 for the end only [default: a twentieth of the run, or as many of these as keep evaluations
    /// within 5 % of its cost].
    #[arg(long, value_name = "N", help_heading = RUN_CONTROL)]
    pub eval_every: Option<u32>,
    /// Every n-th image by name is held out; 0 for none.
    #[arg(long, value_name = "N", default_value_t = Self::default().test_every)]
    pub test_every: u32,
    /// Write density-trace.csv, every birth, relocation and death with what became of it, and a section of the report. A resumed
    /// run has none.
    #[arg(long)]
    pub trace_density: bool,
    /// Iterations between exports of scene.ply beside those after evaluations and at the end; 0 for none.
    #[arg(long, value_name = "N", default_value_t = Self::default().export_every, help_heading = RUN_CONTROL)]
    pub export_every: u32,
    /// Write the scene in these formats, too, at the end: one or more, separated by commas.
    #[arg(long, value_name = "FORMAT", value_enum, value_delimiter = ',', help_heading = RUN_CONTROL)]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub export: Vec<SceneFormat>,
    /// Iterations between checkpoints; 0 for the end and Ctrl-C only.
    #[arg(long, value_name = "N", default_value_t = Self::default().checkpoint_every, help_heading = RUN_CONTROL)]
    pub checkpoint_every: u32,
    /// First Gaussians: points, random or a scene file (Gaussians, or a PLY point cloud, in the dataset's frame).
    #[arg(long, default_value_t = Self::default().init)]
    pub init: Init,
    /// Folder of the photos, in the dataset or elsewhere, like images_4 [default: where the dataset says, else found by file name].
    #[arg(long, value_name = "DIR")]
    pub images: Option<std::path::PathBuf>,
    /// Take the photos' alpha for a mask of the pixels that count, not for transparency.
    #[arg(long)]
    pub alpha_is_mask: bool,
    /// Masks are black where a photo counts: mask files, and alpha with --alpha-is-mask, are inverted.
    #[arg(long)]
    pub invert_masks: bool,
    /// black, white, R,G,B, random (another colour in each iteration, scored over black), or auto: random if photos are
    /// transparent, the mean colour of photos without transparency and masks, else black.
    #[arg(long, default_value_t = Self::default().background)]
    pub background: Background,
    /// Filters for things seen from near and far, and for views of other sizes than those trained on.
    #[arg(long, value_enum, default_value_t = Self::default().anti_aliasing)]
    pub anti_aliasing: AntiAliasing,
    /// A colour transform for every training photo, for sets whose brightness varies.
    #[arg(long, value_enum, default_value_t = Self::default().exposure)]
    pub exposure: ExposureChoice,
    /// Loss weights.
    #[arg(skip)]
    pub loss: LossConfig,
    /// Optimiser.
    #[arg(skip)]
    pub optimizer: OptimizerConfig,
    /// Metropolis–Hastings density control; its option `surrogate` has a flag of the command line.
    #[arg(skip)]
    pub mh: MhConfig,
    /// Shortcuts that leave work out.
    #[arg(skip)]
    pub work: WorkConfig,
    /// MCMC density control.
    #[arg(skip)]
    pub mcmc: McmcConfig,
    /// Adaptive density control.
    #[arg(skip)]
    pub adc: AdcConfig,
    /// Iterations of the whole run, and the size of its photos, as its time budget set them on the way; none without one. A configuration
    /// with some repeats these decisions, whatever the clock says.
    #[arg(skip)]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub lengths: Vec<Length>,
}

/// Number of iterations of a run from one of them on, and the size of its photos.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Length {
    /// First iteration of which this holds.
    pub from: u32,
    /// Iterations of the whole run.
    pub iterations: u32,
    /// Largest size of the photos.
    #[serde(default, skip_serializing_if = "TrainingSize::is_full")]
    pub size: TrainingSize,
}

impl Length {
    /// Returns a length of a run on photos of the size asked for.
    #[must_use]
    pub fn new(from: u32, iterations: u32) -> Self {
        let size = TrainingSize::Full;
        Self {
            from,
            iterations,
            size,
        }
    }
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            sampler: Sampler::Mh,
            iterations: 30_000,
            batch: 1,
            time_budget: None,
            budget_cpu: None,
            patience: None,
            max_size: 1600,
            image_budget: None,
            max_gaussians: None,
            clearance: 0.5,
            sh_degree: 3,
            seed: 0,
            eval_every: None,
            trace_density: false,
            test_every: 8,
            export_every: 0,
            export: Vec::new(),
            checkpoint_every: 1000,
            init: Init::Points,
            images: None,
            alpha_is_mask: false,
            invert_masks: false,
            background: Background::Auto,
            anti_aliasing: AntiAliasing::Auto,
            exposure: ExposureChoice::Auto,
            loss: LossConfig::default(),
            optimizer: OptimizerConfig::default(),
            mh: MhConfig::default(),
            work: WorkConfig::default(),
            mcmc: McmcConfig::default(),
            adc: AdcConfig::default(),
            lengths: Vec::new(),
        }
    }
}

impl TrainConfig {
    /// Checks every value's domain.
    ///
    /// # Errors
    /// The first option that is out of its domain.
    pub fn validate(&self) -> Result<()> {
        let check = |good, option: &str, what: &str| Error::unless(good, option, what);
        check(
            self.iterations > 0,
            "--iterations",
            "0; at least 1 expected",
        )?;
        let what = "0; at least 1 view expected";
        check(self.batch > 0, "--batch", what)?;
        let others = !self.export.contains(&SceneFormat::Ply);
        check(others, "--export", "scene.ply is written anyway")?;
        let what = format!("{}; 0 to 3 expected", self.sh_degree);
        check(self.sh_degree <= 3, "--sh-degree", &what)?;
        let what = format!("{}; 16 to 65535 expected", self.max_size);
        check((16..=65_535).contains(&self.max_size), "--max-size", &what)?;
        let what = "0; at least 1 byte expected";
        check(self.image_budget != Some(0), "--image-budget", what)?;
        let what = "0; at least 1 expected";
        check(self.max_gaussians != Some(0), "--max-gaussians", what)?;
        let what = format!("{}; 0 to less than 1 expected", self.clearance);
        let good = (0.0..1.0).contains(&self.clearance);
        check(good, "--clearance", &what)?;
        for (time, option) in [
            (self.time_budget, "--time-budget"),
            (self.budget_cpu, "--budget-cpu"),
        ] {
            let time = time.unwrap_or(1.0);
            let what = format!("{time} s; a positive time expected");
            check(time.is_finite() && time > 0.0, option, &what)?;
        }
        let both = self.time_budget.is_some() && self.budget_cpu.is_some();
        check(
            !both,
            "--budget-cpu",
            "with --time-budget; one of them expected",
        )?;
        let mut before = (None, self.iterations);
        let good = self.lengths.iter().all(|l| {
            let (from, iterations) = before;
            before = (Some(l.from), l.iterations);
            from < Some(l.from) && l.from <= iterations && l.from < l.iterations
        });
        let what = "ascending, each from within the length before it and longer than what is done by then, expected";
        check(good, "lengths", what)?;
        let never = self.patience == Some(0) || self.eval_every == Some(0);
        let what = "at least 1 evaluation, and some during the run (--eval-every), expected";
        check(self.patience.is_none() || !never, "--patience", what)?;
        if let Background::Color(c) = self.background {
            let what = format!("{c:?}; R,G,B in 0 to 1 expected");
            let inside = c.iter().all(|v| (0.0..=1.0).contains(v));
            check(inside, "--background", &what)?;
        }
        self.work.validate()?;
        self.optimizer.validate()?;
        self.loss.validate()?;
        self.mh.validate()?;
        self.mcmc.validate()?;
        self.adc.validate()
    }

    /// Returns true if a budget of time decides on the length of the run.
    #[must_use]
    pub fn has_budget(&self) -> bool {
        self.time_budget.or(self.budget_cpu).is_some()
    }

    /// Returns true if the run went on from its end.
    #[must_use]
    pub fn extended(&self) -> bool {
        let before = [self.iterations].into_iter();
        let before = before.chain(self.lengths.iter().map(|l| l.iterations));
        self.lengths
            .iter()
            .zip(before)
            .any(|(l, end)| l.from >= end)
    }

    /// Sets the length of the run from an iteration on, in place of one that held from there or later.
    pub fn set_length(&mut self, length: Length) {
        self.lengths.retain(|l| l.from < length.from);
        self.lengths.push(length);
    }

    /// Returns the iterations of the whole run as they are planned at one of them.
    #[must_use]
    pub fn iterations_at(&self, iteration: u32) -> u32 {
        let planned = self.lengths.iter().rev().find(|l| l.from <= iteration);
        planned.map_or(self.iterations, |l| l.iterations)
    }

    /// Returns the iterations of the whole run as they were planned last.
    #[must_use]
    pub fn last_iterations(&self) -> u32 {
        self.iterations_at(u32::MAX)
    }

    /// Returns the largest size of photos from an iteration on.
    #[must_use]
    pub fn size_at(&self, iteration: u32) -> TrainingSize {
        let planned = self.lengths.iter().rev().find(|l| l.from <= iteration);
        planned.map_or(TrainingSize::Full, |l| l.size)
    }

    /// Returns the largest size of photos as it was planned last.
    #[must_use]
    pub fn last_size(&self) -> TrainingSize {
        self.size_at(u32::MAX)
    }

    /// Returns when the chosen sampler acts; `None` for a fixed set of Gaussians.
    #[must_use]
    pub fn density_times(&self) -> Option<DensityTimes> {
        match self.sampler {
            Sampler::Mh => Some(self.mh.times()),
            Sampler::Mcmc => Some(self.mcmc.times()),
            Sampler::Adc => Some(self.adc.times()),
            Sampler::None => None,
        }
    }

    /// Returns the opacity at which the chosen sampler takes a Gaussian for dead.
    #[must_use]
    pub fn dead_opacity(&self) -> f64 {
        match self.sampler {
            Sampler::Mh => self.mh.dead_opacity,
            Sampler::Mcmc => self.mcmc.dead_opacity,
            Sampler::Adc => self.adc.prune_opacity,
            Sampler::None => 0.0,
        }
    }
}
