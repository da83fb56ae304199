//! [`Plan`]: every decision about a run that dataset and configuration allow, taken once before training, with its reason.
//!
//! Nothing else decides: the trainer, the run folder and the report go by the plan. What only training can tell (whether photos
//! differ in brightness, which Gaussians no view shows) is added to it as [`Learned`].

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::base::error::{Error, Result};
use crate::capture::{Alpha, Dataset, View};
use crate::config::{
    AntiAliasing, Background, ExposureChoice, Init, Sampler, TrainConfig, WorkConfig,
};
use crate::scene::ply;
use crate::train::brightness::GainSpread;
use crate::train::sampling_rates::Spreads;
use crate::train::schedule::Schedule;

/// Part that a checkpoint may decide.
const ANTI_ALIASING: &str = "anti-aliasing";
/// Part that a checkpoint may decide.
const PROGRESSIVE: &str = "progressive resolution";
/// Part that training may decide.
const EXPOSURE: &str = "per-image exposure";
/// Reason why transparent photos have no exposure transforms.
const NO_CAMERA_SAW: &str = "no camera saw the background that transparent photos are composited over, and a transform would change it, too";

/// A part of the work with the reason why the plan keeps it or leaves it out.
#[derive(Debug, Clone, PartialEq)]
pub struct Part {
    /// Name of the part.
    pub name: &'static str,
    /// True if it is computed; otherwise it costs nothing.
    pub kept: bool,
    /// Reason.
    pub why: String,
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let verb = if self.kept { "on" } else { "left out" };
        write!(f, "{} is {verb}: {}", self.name, self.why)
    }
}

/// Per-image exposure compensation over a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Exposure {
    /// No photo has a colour transform.
    Off,
    /// Every training photo has one from this iteration on.
    From(u32),
    /// Photos are compared with their renders after this iteration; [`Learned::gains`] decides then.
    Compare(u32),
}

/// Findings of training that belong to the plan.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Learned {
    /// Brightness of the photos over their renders; `None` until they are compared.
    pub gains: Option<GainSpread>,
    /// Gaussians removed at the end because no training view shows them.
    pub removed: u64,
    /// Iteration after which the run was finished; a run that continues from there is finished again.
    pub finished: Option<u32>,
}

/// Decisions of one run.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Configuration that the plan is made from.
    pub config: TrainConfig,
    /// Meaning of the photos' alpha plane.
    pub alpha: Alpha,
    /// Another background colour in each iteration.
    pub random_background: bool,
    /// Mip-Splatting's 2D and 3D filters.
    pub anti_aliasing: bool,
    /// Halvings of the photos at the start of the run.
    pub halvings: u32,
    /// Per-image exposure compensation.
    pub exposure: Exposure,
    /// Highest SH degree.
    pub sh_degree: u32,
    /// Loss left out of tiles that are blank in render and photo.
    pub skip_blank: bool,
    /// Parts of the work, in the order of a run.
    parts: Vec<Part>,
}

impl Plan {
    /// Decides for a dataset and a configuration.
    ///
    /// # Errors
    /// An invalid configuration, or exposure transforms asked for transparent photos.
    pub fn new(dataset: &Dataset, config: &TrainConfig) -> Result<Self> {
        config.validate()?;
        let alpha = alpha(dataset);
        let (anti_aliasing, filtered) = anti_aliasing(dataset, config);
        let (halvings, halved) = halvings(dataset, config);
        let (exposure, exposed) = exposure(config, alpha)?;
        let mut plan = Self {
            alpha,
            random_background: config.background.changes(alpha == Alpha::Transparency),
            anti_aliasing,
            halvings,
            exposure,
            sh_degree: config.sh_degree,
            skip_blank: alpha != Alpha::None && config.work.skip_blank,
            parts: Vec::new(),
            config: config.clone(),
        };
        plan.photos(dataset);
        let degree = plan.sh_degree;
        plan.either(
            "view-dependent colour",
            degree > 0,
            format!("SH degree {degree}, one band after the other"),
            "SH degree 0 asked for",
        );
        plan.part(ANTI_ALIASING, anti_aliasing, filtered);
        plan.part(PROGRESSIVE, halvings > 0, halved);
        plan.work(config.work);
        plan.density_control();
        plan.part(EXPOSURE, matches!(exposure, Exposure::From(_)), exposed);
        plan.start(dataset);
        Ok(plan)
    }

    /// The plan with anti-aliasing and progressive resolution as the run began: both are decided once per run.
    #[must_use]
    pub fn begun_with(mut self, anti_aliasing: bool, halvings: u32) -> Self {
        if self.anti_aliasing != anti_aliasing {
            self.anti_aliasing = anti_aliasing;
            self.part(ANTI_ALIASING, anti_aliasing, "as in the checkpoint");
        }
        if self.halvings != halvings {
            self.halvings = halvings;
            self.part(PROGRESSIVE, halvings > 0, "as in the checkpoint");
        }
        self
    }

    /// Takes over the findings of training so far, in the order in which training made them, and returns the parts that they
    /// change.
    pub fn learn(&mut self, learned: &Learned) -> Vec<Part> {
        let mut changed = Vec::new();
        if let (Some(gains), Exposure::Compare(_)) = (learned.gains, self.exposure) {
            let varies = gains.varies();
            self.exposure = match varies {
                true => Exposure::From(gains.iteration),
                false => Exposure::Off,
            };
            changed.extend(self.part(EXPOSURE, varies, gains.to_string()));
        }
        if learned.finished.is_some() && self.config.work.remove_unseen {
            let removed = learned.removed;
            let why = format!(
                "{removed} removed at the end; the training views stay the same to the bit"
            );
            changed.extend(self.part("Gaussians that no training view shows", false, why));
        }
        changed
    }

    /// Parts of the work with whether they are kept and why, in the order of a run.
    #[must_use]
    pub fn parts(&self) -> &[Part] {
        &self.parts
    }

    /// Adds a part, or puts it in the place of the one of that name; returns it if that changes anything.
    fn part(&mut self, name: &'static str, kept: bool, why: impl Into<String>) -> Option<Part> {
        let why = why.into();
        let part = Part { name, kept, why };
        match self.parts.iter_mut().find(|p| p.name == name) {
            Some(earlier) if *earlier == part => return None,
            Some(earlier) => *earlier = part.clone(),
            None => self.parts.push(part.clone()),
        }
        Some(part)
    }

    /// Adds a part with the reason to keep it or the one to leave it out.
    fn either(&mut self, name: &'static str, kept: bool, why: impl Into<String>, why_not: &str) {
        let why = if kept { why.into() } else { why_not.into() };
        self.part(name, kept, why);
    }

    fn photos(&mut self, dataset: &Dataset) {
        let transparent = self.alpha == Alpha::Transparency;
        self.either(
            "photo alpha over the background",
            transparent,
            "photos have transparent pixels",
            "no photo is transparent",
        );
        let asked = self.config.background;
        let why = match (self.random_background, asked) {
            (true, Background::Auto) => {
                "photos are transparent: over one colour a scene keeps fog of it".into()
            }
            (true, _) => "asked for".into(),
            (false, Background::Auto) => "no photo is transparent".into(),
            (false, color) => format!("one colour asked for: {color}"),
        };
        let name = "random background in each iteration";
        self.part(name, self.random_background, why);
        self.either(
            "masks",
            self.alpha == Alpha::Mask,
            "render and photo are compared where masks are not black; black tiles get no Gaussians",
            "there is no mask",
        );
        let n = dataset.undistorted;
        let why = format!("{n} photos have lens distortion");
        self.either("undistortion", n > 0, why, "every camera is a pinhole");
        let mebibytes = |bytes: u64| format!("{:.0} MiB", bytes as f64 / f64::from(1 << 20));
        let [bytes, budget] = [dataset.photo_bytes(), dataset.image_budget].map(mebibytes);
        self.either(
            "photo prefetch",
            dataset.photos_on_demand(),
            format!("the photos take {bytes}, and their budget is {budget}"),
            &format!("all photos fit in memory ({bytes})"),
        );
    }

    fn work(&mut self, work: WorkConfig) {
        self.either(
            "Morton order",
            work.morton_order,
            "neighbours in space share cache lines and are culled together",
            "work.morton-order is off",
        );
        self.either(
            "block culling",
            work.cull_chunks,
            "blocks that a view cannot see cost next to nothing",
            "work.cull-chunks is off",
        );
        self.either(
            "loss skipped in blank tiles",
            self.skip_blank,
            "no gradient comes from clear or masked tiles that no Gaussian reaches",
            match self.alpha {
                Alpha::None => "no photo is transparent or masked",
                _ => "work.skip-blank is off",
            },
        );
        if !work.remove_unseen {
            let name = "removal of Gaussians that no training view shows";
            self.part(name, false, "work.remove-unseen is off");
        }
    }

    fn density_control(&mut self) {
        let statistics = "importance pass";
        match self.config.sampler {
            Sampler::Mh => self.metropolis_hastings(),
            Sampler::Mcmc => {
                let cap = self.config.max_gaussians.unwrap_or(self.config.mcmc.cap);
                let why = format!("MCMC sampler, at most {cap} Gaussians");
                self.part("noise on positions, relocation, growth", true, why);
                self.part(statistics, false, "the MCMC sampler draws by opacity");
            }
            Sampler::Adc => {
                let name = "screen-space gradients, clone, split, prune, opacity reset";
                self.part(name, true, "ADC sampler");
                let why = "the ADC sampler goes by screen-space gradients";
                self.part(statistics, false, why);
            }
            Sampler::None => {
                let name = "importance pass and density control";
                self.part(name, false, "a fixed set of Gaussians asked for");
            }
        }
    }

    fn metropolis_hastings(&mut self) {
        let mh = self.config.mh;
        let sampler = "Metropolis-Hastings sampler";
        if mh.wants_errors() {
            self.part("importance pass and density control", true, sampler);
        } else {
            self.part("density control", true, sampler);
            let why = "mh.importance is off, or no cue of errors has a weight";
            self.part("importance pass", false, why);
        }
        if mh.probed_views() > 0 {
            let why = format!("births are estimated in {} views", mh.probe_views);
            self.part("first-order birth estimates", true, why);
        }
        self.either(
            "noise on positions",
            mh.noise_rate > 0.0,
            "mh.noise-rate moves faint Gaussians",
            "mh.noise-rate is 0",
        );
        let why = format!(
            "{} views are rendered for each step; {:.0} % of the births lie on the rendered surface",
            mh.pixel_views,
            100.0 * mh.pixel_surface
        );
        self.either(
            "births in image space",
            mh.pixel_proposals > 0,
            why,
            "mh.pixel-proposals is 0",
        );
    }

    fn start(&mut self, dataset: &Dataset) {
        let n = dataset.test.len();
        let why = format!("{n} views are held out");
        self.either("held-out evaluation", n > 0, why, "no view is held out");
        let n = dataset.points.positions.len();
        let asked = self.config.init == Init::Points;
        self.either(
            "initial Gaussians from sparse points",
            asked && n > 0,
            format!("{n} points"),
            match asked {
                true => "the dataset has no points; random initialisation",
                false => "another initialisation asked for",
            },
        );
    }
}

/// Meaning of the alpha plane of the training photos.
fn alpha(dataset: &Dataset) -> Alpha {
    let mut found = dataset.train.iter().map(|v| v.photo.alpha());
    found.find(|a| *a != Alpha::None).unwrap_or_default()
}

fn anti_aliasing(dataset: &Dataset, config: &TrainConfig) -> (bool, String) {
    match (config.anti_aliasing, &config.init) {
        (AntiAliasing::On, _) => (true, "anti-aliasing is on".into()),
        (AntiAliasing::Off, _) => (false, "anti-aliasing is off".into()),
        (AntiAliasing::Auto, Init::File(path)) if ply::is_anti_aliased(path) => {
            (true, "the initial Gaussians were trained with it".into())
        }
        (AntiAliasing::Auto, _) => {
            let spreads = Spreads::of(dataset);
            (spreads.ask_for_filters(), spreads.to_string())
        }
    }
}

fn halvings(dataset: &Dataset, config: &TrainConfig) -> (u32, String) {
    let levels = config.work.resolution_levels;
    if levels == 0 {
        return (0, "work.resolution-levels is 0".into());
    }
    if config.time_budget.is_some() {
        let why = "a time budget may end the run before photos have their full size";
        return (0, why.into());
    }
    let schedule = Schedule::new(config);
    let first = |v: &View| {
        let size = [v.camera.width as usize, v.camera.height as usize];
        schedule.shrink_factor(levels, 0, size)
    };
    match dataset.train.iter().map(first).max() {
        Some(divisor) if divisor > 1 => {
            let gain = "most errors are reached 1.1 to 1.8 times sooner";
            let why = format!("1/{divisor} of the photos' size at first: {gain}");
            (levels, why)
        }
        _ => (0, "the photos are too small to be halved".into()),
    }
}

fn exposure(config: &TrainConfig, alpha: Alpha) -> Result<(Exposure, &'static str)> {
    let from = Schedule::new(config).exposure_from();
    let transparent = alpha == Alpha::Transparency;
    Ok(match config.exposure {
        ExposureChoice::On if transparent => {
            let fix = "leave it to auto or off, or, if their alpha says what counts, give --alpha-is-mask";
            return Err(Error::config(
                "--exposure",
                format!("on; {NO_CAMERA_SAW}: {fix}"),
            ));
        }
        ExposureChoice::On => (Exposure::From(from), "exposure is on"),
        ExposureChoice::Off => (Exposure::Off, "exposure is off"),
        ExposureChoice::Auto if transparent => (Exposure::Off, NO_CAMERA_SAW),
        ExposureChoice::Auto if from >= config.iterations => {
            let why = "the run is too short to tell whether it is needed";
            (Exposure::Off, why)
        }
        ExposureChoice::Auto => {
            let why = "photos are compared with their renders first: on if their brightness varies";
            (Exposure::Compare(from), why)
        }
    })
}
