//! [`Plan`]: every decision about a run that dataset and configuration allow, taken once before training, with its reason.
//!
//! Nothing else decides: the trainer, the run folder and the report go by the plan. What only training can tell (whether photos
//! differ in brightness, which Gaussians no view shows) is added to it as [`Learned`].

use std::fmt;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::base::error::{Error, Result};
use crate::capture::{Alpha, Dataset, PhotoSource, View};
use crate::config::{
    AntiAliasing, Background, ExposureChoice, Init, Length, Sampler, TrainConfig, WorkConfig,
};
use crate::density::{self, DensityControl};
use crate::device::{Device, DeviceKind};
use crate::scene::{formats, morton};
use crate::train::background::background;
use crate::train::bound::most_gaussians;
use crate::train::brightness::GainSpread;
use crate::train::clearance::clearance;
use crate::train::reasons::{Decided, NO_CAMERA_SAW, Part, Why};
use crate::train::sampling_rates::Spreads;
use crate::train::schedule::{Schedule, most_halvings};
use crate::train::sizes;

/// Per-image exposure compensation over a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Exposure {
    /// No photo has a colour transform.
    Off,
    /// Every training photo has one, from [`Schedule::exposure_from`] on.
    On,
    /// Photos are compared with their renders then; [`Learned::gains`] decides.
    Compare,
}

/// Findings of training that belong to the plan.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Learned {
    /// Brightness of the photos over their renders; `None` until they are compared.
    pub gains: Option<GainSpread>,
    /// First iteration with exposure compensation; `None` so far without it.
    #[serde(default)]
    pub exposed_from: Option<u32>,
    /// Gaussians removed at the end because no training view shows them.
    pub removed: u64,
    /// Iteration after which the run was finished; a run that continues from there is finished again.
    pub finished: Option<u32>,
}

/// A decision that training added to the plan.
#[derive(Debug, Clone, PartialEq)]
pub enum Decision {
    /// Exposure compensation, where the configuration leaves it open.
    Exposure(Decided<Exposure>),
    /// Gaussians removed because no training view shows them.
    Unseen(Decided<u64>),
}

impl fmt::Display for Decision {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (part, kept, why) = match self {
            Self::Exposure(d) => (Part::Exposure, d.value != Exposure::Off, &d.why),
            Self::Unseen(d) => (Part::Unseen, false, &d.why),
        };
        let verb = if kept { "on" } else { "left out" };
        write!(f, "{part} is {verb}: {why}")
    }
}

/// Decisions of a run that has begun, which are taken once per run; `None` for those that are to be taken.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Begun {
    /// [`Plan::anti_aliasing`].
    pub anti_aliasing: Option<bool>,
    /// [`Plan::detail`].
    pub detail: Option<Vec<f32>>,
    /// [`Plan::clearance`].
    pub clearance: Option<Vec<f32>>,
    /// [`Plan::background`].
    pub background: Option<[f32; 3]>,
}

/// Iterations that a GPU does while a density step is decided on the host, which takes it about as long (docs/results/gpu.md).
const DENSITY_LAG: u32 = 16;

/// Decisions of one run.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Configuration that the plan is made from.
    pub config: TrainConfig,
    /// Meaning of the photos' alpha plane.
    pub alpha: Alpha,
    /// Another background colour in each iteration.
    pub random_background: Decided<bool>,
    /// Background colour of evaluations, and of training unless that has another one in each iteration; RGB in \[0, 1\].
    pub background: Decided<[f32; 3]>,
    /// Mip-Splatting's 2D and 3D filters.
    pub anti_aliasing: Decided<bool>,
    /// Detail lost by the smaller sizes at the start of the run ([`sizes::detail`]); empty for full size throughout.
    pub detail: Decided<Vec<f32>>,
    /// Radii of the space about each training camera that density steps keep free of Gaussians, local units; empty without it.
    pub clearance: Decided<Vec<f32>>,
    /// Per-image exposure compensation.
    pub exposure: Decided<Exposure>,
    /// Highest SH degree.
    pub sh_degree: Decided<u32>,
    /// Number of Gaussians beyond which none is born; `None` without a bound.
    pub most_gaussians: Decided<Option<usize>>,
    /// Iterations that training does while a density step is decided, where its interval has room for so many.
    pub density_lag: Decided<u32>,
    /// Loss left out of tiles that are blank in render and photo.
    pub skip_blank: Decided<bool>,
    /// Direction that is up, after which rows are ordered; [`morton::NO_UP`] if the cameras agree on none.
    pub up: [f32; 3],
    /// Gaussians removed at the end because no training view shows them; `None` before the end, and where all are shown.
    pub unseen: Option<Decided<u64>>,
    /// [`Dataset::swept`].
    pub swept: Option<usize>,
    /// True if the first Gaussians are random.
    pub(crate) random_start: bool,
    /// Reason for a largest size of the photos below the size asked for; `None` where they have that.
    smaller: Option<Why>,
    /// Kind of the leader's device in the plan of a rank that does not lead.
    leader: Option<DeviceKind>,
    /// Parts that dataset or configuration switch and nobody else asks for.
    facts: Vec<(Part, Decided<bool>)>,
}

impl Plan {
    /// The plan with what depends on the device, for the strategy that the configuration names; see [`Plan::with_strategy`].
    #[must_use]
    pub fn on_device(self, device: &Device) -> Self {
        let strategy = self.strategy();
        self.with_strategy(device.info().kind, strategy.as_ref())
    }

    /// The strategy that the configuration names.
    #[must_use]
    pub fn strategy(&self) -> Arc<dyn DensityControl> {
        density::make(&self.density_config())
    }

    /// The plan of a rank whose leader has a device of this kind: what depends on the kind is as the leader has it.
    #[must_use]
    pub fn led_by(mut self, kind: DeviceKind) -> Self {
        self.leader = Some(kind);
        self
    }

    /// The plan for a kind of device and a strategy: a density step is decided while training goes on unless that takes the same
    /// processor, or the strategy asks the device for estimates meanwhile.
    #[must_use]
    pub fn with_strategy(mut self, kind: DeviceKind, strategy: &dyn DensityControl) -> Self {
        let kind = self.leader.unwrap_or(kind);
        self.density_lag = match self.config.work.density_lag {
            _ if strategy.estimate_views() > 0 => Decided::new(0, Why::EstimatesNeedDevice),
            Some(0) => Decided::new(0, Why::Off("work.density-lag")),
            Some(lag) => Decided::new(lag, Why::TrainsOn(lag)),
            None if kind == DeviceKind::Cpu => Decided::new(0, Why::SameProcessor),
            None => {
                let first = DENSITY_LAG.min(Schedule::new(&self.config).most_lag(0));
                Decided::new(DENSITY_LAG, Why::TrainsOn(first.max(1)))
            }
        };
        self
    }

    /// The schedules of the run.
    #[must_use]
    pub fn schedule(&self) -> Schedule {
        Schedule::new(&self.config)
            .with_density_lag(self.density_lag.value)
            .with_background(self.background.value)
    }

    /// The colour behind the scene that files are to show, too: the background of photos that are neither transparent nor masked, unless it is
    /// black.
    #[must_use]
    pub fn behind(&self) -> Option<[f32; 3]> {
        let color = self.background.value;
        let shown = self.alpha == Alpha::None && !self.random_background.value;
        (shown && color != [0.0; 3]).then_some(color)
    }

    /// Decides for a dataset and a configuration.
    ///
    /// # Errors
    /// An invalid configuration, or exposure transforms asked for transparent photos.
    pub fn new(dataset: &Dataset, config: &TrainConfig) -> Result<Self> {
        Self::begun(dataset, config, &Begun::default())
    }

    /// The plan of a run that has begun already: what is decided once per run is as it was, and no photo is read for it.
    ///
    /// # Errors
    /// See [`Plan::new`].
    pub fn begun(dataset: &Dataset, config: &TrainConfig, begun: &Begun) -> Result<Self> {
        config.validate()?;
        let (batch, views) = (config.batch, dataset.train.len());
        let what = format!("{batch}; no more than the {views} training views expected");
        Error::unless(batch as usize <= views.max(1), "--batch", &what)?;
        let alpha = Alpha::common(dataset.train.iter().map(|v| v.photo.alpha()));
        let mut plan = Self {
            alpha,
            random_background: random_background(config, alpha == Alpha::Transparency),
            background: background(dataset, config, alpha, begun.background)?,
            anti_aliasing: match begun.anti_aliasing {
                // By points that nobody has any more.
                Some(value) if dataset.forgot_points() => Decided::new(value, Why::Checkpoint),
                known => as_begun(anti_aliasing(dataset, config), known),
            },
            detail: detail(dataset, config, begun.detail.as_ref())?,
            clearance: clearance(dataset, config, begun.clearance.as_ref())?,
            exposure: exposure(config, alpha)?,
            sh_degree: match config.sh_degree {
                0 => Decided::new(0, Why::NoBands),
                degree => Decided::new(degree, Why::BandByBand(degree)),
            },
            most_gaussians: most_gaussians(dataset, config, alpha),
            // As on a CPU, until the device is known.
            density_lag: Decided::new(0, Why::SameProcessor),
            skip_blank: skip_blank(&config.work, alpha),
            up: dataset.up().map_or(morton::NO_UP, |up| up.as_vec3().into()),
            unseen: None,
            swept: dataset.swept,
            random_start: match config.init {
                Init::Points => dataset.point_count() == 0,
                Init::Random => true,
                Init::File(_) => false,
            },
            smaller: None,
            leader: None,
            facts: Vec::new(),
            config: config.clone(),
        };
        plan.smaller = plan.smaller();
        plan.photos(dataset);
        plan.work();
        plan.density_control();
        plan.start(dataset);
        let strategy = density::make(&plan.density_config());
        Ok(plan.with_strategy(DeviceKind::Cpu, strategy.as_ref()))
    }

    /// The plan for a strategy of the caller's own, which the photos do not bound.
    pub(super) fn without_photo_bound(mut self) -> Self {
        if self.config.max_gaussians.is_none() {
            let why = Why::Criterion("density control is the caller's own");
            self.most_gaussians = Decided::new(None, why);
        }
        self
    }

    /// Sets the length of the run from an iteration on, and the largest size of its photos.
    pub(super) fn set_length(&mut self, length: Length) {
        self.config.set_length(length);
        self.smaller = self.smaller();
    }

    /// Iterations after which as much is left to be learnt of these photos as 3/4 of their size loses. Transparent ones lose more
    /// (docs/results/budgets.md).
    fn even_iterations(&self) -> u32 {
        let all = self.config.work.resolution_iterations;
        all / if self.alpha == Alpha::Transparency {
            2
        } else {
            1
        }
    }

    /// The configuration with the iterations of these photos in `work.resolution_iterations`.
    #[must_use]
    pub fn for_budgets(&self) -> TrainConfig {
        let mut config = self.config.clone();
        config.work.resolution_iterations = self.even_iterations();
        config
    }

    /// The reason for photos below the size asked for, if the run ends with such.
    fn smaller(&self) -> Option<Why> {
        let size = self.config.last_size();
        (!size.is_full()).then(|| Why::LeastError(size, self.even_iterations()))
    }

    /// The configuration with what the start decides about density control.
    pub(super) fn density_config(&self) -> TrainConfig {
        let mut config = self.config.clone();
        if self.random_start {
            let first = config.mh.from_iteration;
            config.mh.births_from_iteration.get_or_insert(first);
        }
        config
    }

    /// Takes over the findings of training so far, in the order in which training made them.
    pub fn learn(&mut self, learned: &Learned) -> Vec<Decision> {
        let mut decisions = Vec::new();
        if let (Some(gains), Exposure::Compare) = (learned.gains, self.exposure.value) {
            let value = match gains.varies() {
                true => Exposure::On,
                false => Exposure::Off,
            };
            self.exposure = Decided::new(value, Why::Gains(gains));
            decisions.push(Decision::Exposure(self.exposure.clone()));
        }
        if learned.finished.is_some() {
            let removed = learned.removed;
            let unseen = (removed > 0).then(|| Decided::new(removed, Why::Removed(removed)));
            if self.unseen != unseen {
                decisions.extend(unseen.clone().map(Decision::Unseen));
            }
            self.unseen = unseen;
        }
        decisions
    }

    /// Parts of the work with whether they are kept and why, in the order of a run.
    #[must_use]
    pub fn parts(&self) -> Vec<(Part, bool, &Why)> {
        let fact = |part: Part| {
            let found = self.facts.iter().find(|(p, _)| *p == part);
            found.map(|(p, d)| (*p, d.value, &d.why))
        };
        let on = |part, d: &'_ Decided<bool>| -> (Part, bool) { (part, d.value) };
        let typed = |(part, kept): (Part, bool), why| Some((part, kept, why));
        let exposed = self.exposure.value == Exposure::On;
        let all = [
            fact(Part::Transparency),
            typed(
                on(Part::RandomBackground, &self.random_background),
                &self.random_background.why,
            ),
            typed(
                (Part::Background, self.background.value != [0.0; 3]),
                &self.background.why,
            ),
            fact(Part::Masks),
            fact(Part::Undistortion),
            fact(Part::Prefetch),
            typed(
                (Part::ViewDependentColor, self.sh_degree.value > 0),
                &self.sh_degree.why,
            ),
            typed(
                on(Part::AntiAliasing, &self.anti_aliasing),
                &self.anti_aliasing.why,
            ),
            typed(
                (Part::ProgressiveResolution, !self.detail.value.is_empty()),
                &self.detail.why,
            ),
            self.smaller
                .as_ref()
                .map(|why| (Part::FullSize, false, why)),
            fact(Part::MortonOrder),
            fact(Part::BlockCulling),
            typed(on(Part::SkipBlank, &self.skip_blank), &self.skip_blank.why),
            fact(Part::RemoveUnseen),
            fact(Part::ErrorDensityControl),
            fact(Part::DensityControl),
            fact(Part::McmcDensityControl),
            fact(Part::AdaptiveDensityControl),
            fact(Part::ErrorStatistics),
            fact(Part::BirthEstimates),
            (self.config.sampler != Sampler::None).then_some((
                Part::Lag,
                self.density_lag.value > 0,
                &self.density_lag.why,
            )),
            fact(Part::Noise),
            fact(Part::EarlyBirths),
            fact(Part::PixelBirths),
            (self.config.sampler == Sampler::Mh).then_some((
                Part::Bound,
                self.most_gaussians.value.is_some(),
                &self.most_gaussians.why,
            )),
            (self.config.sampler != Sampler::None).then_some((
                Part::Clearance,
                !self.clearance.value.is_empty(),
                &self.clearance.why,
            )),
            typed((Part::Exposure, exposed), &self.exposure.why),
            fact(Part::HeldOut),
            fact(Part::SparsePoints),
            self.unseen.as_ref().map(|d| (Part::Unseen, false, &d.why)),
        ];
        all.into_iter().flatten().collect()
    }

    fn fact(&mut self, part: Part, value: bool, why: Why, why_not: Why) {
        let why = if value { why } else { why_not };
        self.facts.push((part, Decided::new(value, why)));
    }

    fn photos(&mut self, dataset: &Dataset) {
        let transparent = self.alpha == Alpha::Transparency;
        self.fact(
            Part::Transparency,
            transparent,
            Why::Transparent,
            Why::Opaque,
        );
        let masked = self.alpha == Alpha::Mask;
        self.fact(Part::Masks, masked, Why::Masked, Why::NoMask);
        let n = dataset.undistorted;
        self.fact(Part::Undistortion, n > 0, Why::Distorted(n), Why::Pinholes);
        let bytes = dataset.photo_bytes();
        self.fact(
            Part::Prefetch,
            dataset.photos_on_demand(),
            Why::OverBudget(bytes, dataset.image_budget),
            Why::InMemory(bytes),
        );
    }

    fn work(&mut self) {
        let work = self.config.work;
        let off = Why::Off("work.morton-order");
        self.fact(Part::MortonOrder, work.morton_order, Why::Locality, off);
        let off = Why::Off("work.cull-chunks");
        self.fact(Part::BlockCulling, work.cull_chunks, Why::UnseenBlocks, off);
        if !work.remove_unseen {
            let off = Why::Off("work.remove-unseen");
            self.fact(Part::RemoveUnseen, false, off.clone(), off);
        }
    }

    fn density_control(&mut self) {
        let config = &self.config;
        match config.sampler {
            Sampler::Mh => self.metropolis_hastings(),
            Sampler::Mcmc => {
                let cap = config.max_gaussians.unwrap_or(config.mcmc.cap);
                let why = Why::McmcCap(cap);
                self.fact(Part::McmcDensityControl, true, why.clone(), why);
                let why = Why::Criterion("the MCMC sampler draws by opacity");
                self.fact(Part::ErrorStatistics, false, why.clone(), why);
            }
            Sampler::Adc => {
                let why = Why::NeededBy("ADC");
                self.fact(Part::AdaptiveDensityControl, true, why.clone(), why);
                let why = Why::Criterion("the ADC sampler goes by screen-space gradients");
                self.fact(Part::ErrorStatistics, false, why.clone(), why);
            }
            Sampler::None => {
                let why = Why::FixedSet;
                self.fact(Part::ErrorDensityControl, false, why.clone(), why);
            }
        }
    }

    fn metropolis_hastings(&mut self) {
        let mh = self.config.mh;
        let sampler = Why::NeededBy("Metropolis-Hastings");
        if mh.wants_errors() {
            self.fact(Part::ErrorDensityControl, true, sampler.clone(), sampler);
        } else {
            self.fact(Part::DensityControl, true, sampler.clone(), sampler);
            let why = Why::Criterion("mh.importance is off, or no cue of errors has a weight");
            self.fact(Part::ErrorStatistics, false, why.clone(), why);
        }
        if mh.estimate_views() > 0 {
            let why = Why::EstimatedIn(mh.probe_views);
            self.fact(Part::BirthEstimates, true, why.clone(), why);
        }
        let off = Why::Criterion("mh.noise-rate is 0");
        self.fact(Part::Noise, mh.noise_rate > 0.0, Why::NoiseMovesFaint, off);
        if mh.births_from_iteration.is_none() {
            let random = Why::Criterion("the first Gaussians are random");
            let placed = Why::Criterion("the first Gaussians are placed by points or a file");
            self.fact(Part::EarlyBirths, self.random_start, random, placed);
        }
        self.fact(
            Part::PixelBirths,
            mh.pixel_proposals > 0,
            Why::PixelViews(mh.pixel_views, mh.pixel_surface, mh.pixel_tolerance > 0.0),
            Why::Criterion("mh.pixel-proposals is 0"),
        );
    }

    fn start(&mut self, dataset: &Dataset) {
        let held_out = dataset.test.len();
        self.fact(
            Part::HeldOut,
            held_out > 0,
            Why::Views(held_out),
            Why::NoHeldOut,
        );
        let points = dataset.point_count();
        let asked = self.config.init == Init::Points;
        let why = match dataset.swept {
            Some(found) => Why::Swept(found),
            None => Why::Points(points),
        };
        let why_not = match (asked, dataset.swept) {
            (true, Some(_)) => Why::NothingAgrees,
            (true, None) => Why::NoPoints,
            (false, _) => Why::AnotherAskedFor,
        };
        self.fact(Part::SparsePoints, asked && points > 0, why, why_not);
    }
}

fn random_background(config: &TrainConfig, transparent: bool) -> Decided<bool> {
    let on = config.background.changes(transparent);
    let asked = config.background != Background::Auto;
    let why = match (on, asked) {
        (true, true) => Why::AskedFor,
        (true, false) => Why::Fog,
        (false, true) => Why::OneColor(config.background),
        (false, false) => Why::Opaque,
    };
    Decided::new(on, why)
}

fn anti_aliasing(dataset: &Dataset, config: &TrainConfig) -> Decided<bool> {
    match (config.anti_aliasing, &config.init) {
        (AntiAliasing::On, _) => Decided::new(true, Why::On("anti-aliasing")),
        (AntiAliasing::Off, _) => Decided::new(false, Why::Off("anti-aliasing")),
        (AntiAliasing::Auto, Init::File(path)) if formats::is_anti_aliased(path) => {
            Decided::new(true, Why::FiltersInFile)
        }
        (AntiAliasing::Auto, _) => {
            let spreads = Spreads::of(dataset);
            Decided::new(spreads.ask_for_filters(), Why::Rates(spreads))
        }
    }
}

fn detail(
    dataset: &Dataset,
    config: &TrainConfig,
    begun: Option<&Vec<f32>>,
) -> Result<Decided<Vec<f32>>> {
    let levels = config.work.resolution_levels;
    if levels == 0 {
        let why = Why::Criterion("work.resolution-levels is 0");
        return Ok(as_begun(Decided::new(Vec::new(), why), begun.cloned()));
    }
    let most = |v: &View| most_halvings([v.camera.width, v.camera.height].map(|s| s as usize));
    let levels = levels.min(dataset.train.iter().map(most).max().unwrap_or(0));
    let photos: Vec<&PhotoSource> = dataset.train.iter().map(|v| &v.photo).collect();
    let detail = match begun {
        Some(detail) => detail.clone(),
        None => sizes::detail(&photos, levels)?,
    };
    let why = match detail.is_empty() {
        true if levels == 0 => Why::SmallPhotos,
        // The run began without smaller sizes.
        true => Why::Checkpoint,
        false => Why::Detail(detail.clone()),
    };
    Ok(Decided::new(detail, why))
}

/// A decision with the value that the run began with, if that is another one.
fn as_begun<T: PartialEq>(decided: Decided<T>, begun: Option<T>) -> Decided<T> {
    match begun {
        Some(value) if value != decided.value => Decided::new(value, Why::Checkpoint),
        _ => decided,
    }
}

fn exposure(config: &TrainConfig, alpha: Alpha) -> Result<Decided<Exposure>> {
    let from = Schedule::new(config).exposure_from(0);
    let transparent = alpha == Alpha::Transparency;
    Ok(match config.exposure {
        ExposureChoice::On if transparent => {
            let fix = "leave it to auto or off, or, if their alpha says what counts, give --alpha-is-mask";
            return Err(Error::config(
                "--exposure",
                format!("on; {NO_CAMERA_SAW}: {fix}"),
            ));
        }
        ExposureChoice::On => Decided::new(Exposure::On, Why::On("exposure")),
        ExposureChoice::Off => Decided::new(Exposure::Off, Why::Off("exposure")),
        ExposureChoice::Auto if transparent => {
            Decided::new(Exposure::Off, Why::NoCameraSawBackground)
        }
        ExposureChoice::Auto if from >= config.iterations_at(0) => {
            Decided::new(Exposure::Off, Why::TooShort)
        }
        ExposureChoice::Auto => Decided::new(Exposure::Compare, Why::ComparedFirst),
    })
}

fn skip_blank(work: &WorkConfig, alpha: Alpha) -> Decided<bool> {
    match alpha {
        Alpha::None => Decided::new(false, Why::NoAlpha),
        _ if work.skip_blank => Decided::new(true, Why::NoGradient),
        _ => Decided::new(false, Why::Off("work.skip-blank")),
    }
}
