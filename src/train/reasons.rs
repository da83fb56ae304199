//! Parts of the work that a plan keeps or leaves out, and the reasons, each spelt here and nowhere else.

use std::fmt;

use crate::config::{Background, TrainingSize};
use crate::train::brightness::{GainSpread, MAX_SPREAD};
use crate::train::sampling_rates::{MIN_SPREAD, MIN_SPREAD_WITHIN, Spreads};

/// A part of the work that a plan keeps or leaves out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// Compositing of transparent photos.
    Transparency,
    /// [`crate::train::Plan::random_background`].
    RandomBackground,
    /// [`crate::train::Plan::background`].
    Background,
    /// Masks.
    Masks,
    /// Undistortion.
    Undistortion,
    /// Photos decoded on demand.
    Prefetch,
    /// SH degrees above 0.
    ViewDependentColor,
    /// [`crate::train::Plan::anti_aliasing`].
    AntiAliasing,
    /// [`crate::train::Plan::detail`].
    ProgressiveResolution,
    /// Photos of the size asked for.
    FullSize,
    /// Morton order of the Gaussians.
    MortonOrder,
    /// Culling of whole blocks of neighbours.
    BlockCulling,
    /// [`crate::train::Plan::skip_blank`].
    SkipBlank,
    /// Error statistics and density control of mh.
    ErrorDensityControl,
    /// Density control of mh without error statistics.
    DensityControl,
    /// Error statistics alone.
    ErrorStatistics,
    /// Noise, relocation and growth of mcmc.
    McmcDensityControl,
    /// Density control of adc.
    AdaptiveDensityControl,
    /// First-order estimates of births.
    BirthEstimates,
    /// [`crate::train::Plan::density_lag`].
    Lag,
    /// Noise on positions.
    Noise,
    /// Births in image space.
    PixelBirths,
    /// [`crate::train::Plan::most_gaussians`].
    Bound,
    /// [`crate::train::Plan::clearance`].
    Clearance,
    /// Births of mh from the first density step on.
    EarlyBirths,
    /// [`crate::train::Plan::exposure`].
    Exposure,
    /// Scores of held-out views.
    HeldOut,
    /// Initial Gaussians at points: sparse ones, or those found in the photos.
    SparsePoints,
    /// Removal of Gaussians that no training view shows.
    RemoveUnseen,
    /// [`crate::train::Plan::unseen`].
    Unseen,
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Transparency => "photo alpha over the background",
            Self::RandomBackground => "random background in each iteration",
            Self::Background => "background of another colour than black",
            Self::Masks => "masks",
            Self::Undistortion => "undistortion",
            Self::Prefetch => "photo prefetch",
            Self::ViewDependentColor => "view-dependent colour",
            Self::AntiAliasing => "anti-aliasing",
            Self::ProgressiveResolution => "progressive resolution",
            Self::FullSize => "photos of the size asked for",
            Self::MortonOrder => "Morton order",
            Self::BlockCulling => "block culling",
            Self::SkipBlank => "loss skipped in blank tiles",
            Self::ErrorDensityControl => "importance pass and density control",
            Self::DensityControl => "density control",
            Self::ErrorStatistics => "importance pass",
            Self::McmcDensityControl => "noise on positions, relocation, growth",
            Self::AdaptiveDensityControl => {
                "screen-space gradients, clone, split, prune, opacity reset"
            }
            Self::BirthEstimates => "first-order birth estimates",
            Self::Lag => "training while density steps are decided",
            Self::Noise => "noise on positions",
            Self::PixelBirths => "births in image space",
            Self::Bound => "bound of the number of Gaussians",
            Self::Clearance => "space about the cameras kept free",
            Self::EarlyBirths => "births from the first density step on",
            Self::Exposure => "per-image exposure",
            Self::HeldOut => "held-out evaluation",
            Self::SparsePoints => "initial Gaussians from points",
            Self::RemoveUnseen => "removal of Gaussians that no training view shows",
            Self::Unseen => "whatever no training view shows",
        })
    }
}

/// A decision and its reason.
#[derive(Debug, Clone, PartialEq)]
pub struct Decided<T> {
    /// Value to go by.
    pub value: T,
    /// Reason for it.
    pub why: Why,
}

impl<T> Decided<T> {
    pub(super) fn new(value: T, why: Why) -> Self {
        Self { value, why }
    }
}

/// The reason for a decision. [`fmt::Display`] spells it; nothing else does.
#[derive(Debug, Clone, PartialEq)]
pub enum Why {
    /// The option is on.
    On(&'static str),
    /// The option is off, or 0.
    Off(&'static str),
    /// The user asked for it.
    AskedFor,
    /// The user asked for something else.
    AnotherAskedFor,
    /// The mean colour of the photos.
    MeanColor([f32; 3]),
    /// One background colour was asked for.
    OneColor(Background),
    /// Photos have transparent pixels.
    Transparent,
    /// No photo has a transparent pixel.
    Opaque,
    /// Over one background, a scene of transparent photos keeps fog of its colour.
    Fog,
    /// Masks say which pixels count.
    Masked,
    /// There is no mask.
    NoMask,
    /// Photos of distorting lenses.
    Distorted(usize),
    /// Every camera is a pinhole.
    Pinholes,
    /// Bytes of all decoded photos, and their budget.
    OverBudget(u64, u64),
    /// Bytes of all decoded photos.
    InMemory(u64),
    /// SH degree, band by band.
    BandByBand(u32),
    /// SH degree 0 was asked for.
    NoBands,
    /// The initial Gaussians carry the filters.
    FiltersInFile,
    /// Sampling rates of the training views.
    Rates(Spreads),
    /// The checkpoint was written with it, or without it.
    Checkpoint,
    /// Detail lost by the smaller sizes, from half the size on.
    Detail(Vec<f32>),
    /// Photos are too small to be halved.
    SmallPhotos,
    /// Largest size of the photos, because what fits into the budget promises the least error at it, and the iterations after which as much is
    /// left to be learnt as 3/4 of the size loses.
    LeastError(TrainingSize, u32),
    /// Neighbours in space share cache lines.
    Locality,
    /// Blocks that a view cannot see cost next to nothing.
    UnseenBlocks,
    /// No gradient comes from blank tiles.
    NoGradient,
    /// No photo is transparent or masked.
    NoAlpha,
    /// The sampler needs it.
    NeededBy(&'static str),
    /// MCMC with this cap.
    McmcCap(usize),
    /// The sampler has another criterion.
    Criterion(&'static str),
    /// A fixed set of Gaussians was asked for.
    FixedSet,
    /// Views in which births are estimated.
    EstimatedIn(u32),
    /// Iterations between the begin of a density step and its end.
    TrainsOn(u32),
    /// The device that trains is the processor that decides.
    SameProcessor,
    /// Estimates of births, which the device computes in between.
    EstimatesNeedDevice,
    /// The noise moves faint Gaussians.
    NoiseMovesFaint,
    /// Views rendered for each density step, the weight of surfaces, and true if the views have to agree about them.
    PixelViews(u32, f64, bool),
    /// Share of the distance of the nearest points that is kept free about cameras, and the median radius, in the dataset's units.
    Free(f64, f64),
    /// Bound that was asked for.
    AtMost(usize),
    /// Bound by the photos, and the number of places that these were taken from.
    OverfitBeyond(usize, usize),
    /// Bound by the sparse points, which are more than the photos allow.
    AtPoints(usize),
    /// Transparent photos have no exposure transforms.
    NoCameraSawBackground,
    /// The run is too short for a comparison of brightness.
    TooShort,
    /// Photos are compared with their renders first.
    ComparedFirst,
    /// Gains of the photos over their renders.
    Gains(GainSpread),
    /// Held-out views.
    Views(usize),
    /// No view is held out.
    NoHeldOut,
    /// Sparse points.
    Points(usize),
    /// Points found in the photos.
    Swept(usize),
    /// The dataset has no points, and nobody has looked for some.
    NoPoints,
    /// The dataset has no points, and none were found.
    NothingAgrees,
    /// Gaussians removed; the training views keep every bit.
    Removed(u64),
}

/// Reason why transparent photos have no exposure transforms.
pub(super) const NO_CAMERA_SAW: &str = "no camera saw the background that transparent photos are composited over, and a transform would change it, too";

/// Reasons for a random start.
const NO_POINTS: &str =
    "the dataset has no points, and none were looked for in its photos; random initialisation";
const NOTHING_AGREES: &str =
    "the dataset has no points, and its photos agree in too few places; random initialisation";

fn mebibytes(bytes: u64) -> String {
    format!("{:.0} MiB", bytes as f64 / f64::from(1 << 20))
}

/// Spells the reason for free space about cameras.
fn free(f: &mut fmt::Formatter<'_>, share: f64, radius: f64) -> fmt::Result {
    let nearest = "of the distance of the sparse points nearest to it";
    let why = "what stands there, beside the photos, would veil other views";
    write!(
        f,
        "about each camera to {share} {nearest} (median {radius:.3}): {why}"
    )
}

/// Spells the reason for the photos' mean colour, RGB in \[0, 1\].
fn mean(f: &mut fmt::Formatter<'_>, [r, g, b]: [f32; 3]) -> fmt::Result {
    write!(
        f,
        "the photos' mean colour, {r:.3}, {g:.3}, {b:.3}, shows where no Gaussian does"
    )
}

impl fmt::Display for Why {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::On(option) => write!(f, "{option} is on"),
            Self::Off(option) => write!(f, "{option} is off"),
            Self::AskedFor => f.write_str("asked for"),
            Self::AnotherAskedFor => f.write_str("another initialisation asked for"),
            Self::MeanColor(color) => mean(f, *color),
            Self::OneColor(color) => {
                write!(f, "one colour asked for: {}", String::from(*color))
            }
            Self::Transparent => f.write_str("photos have transparent pixels"),
            Self::Opaque => f.write_str("no photo is transparent"),
            Self::Fog => {
                f.write_str("photos are transparent: over one colour a scene keeps fog of it")
            }
            Self::Masked => f.write_str(
                "render and photo are compared where masks are not black; black tiles get no Gaussians",
            ),
            Self::NoMask => f.write_str("there is no mask"),
            Self::Distorted(n) => write!(f, "{n} photos have lens distortion"),
            Self::Pinholes => f.write_str("every camera is a pinhole"),
            Self::OverBudget(bytes, budget) => {
                let [bytes, budget] = [*bytes, *budget].map(mebibytes);
                write!(f, "the photos take {bytes}, and their budget is {budget}")
            }
            Self::InMemory(bytes) => {
                write!(f, "all photos fit in memory ({})", mebibytes(*bytes))
            }
            Self::BandByBand(degree) => write!(f, "SH degree {degree}, one band after the other"),
            Self::NoBands => f.write_str("SH degree 0 asked for"),
            Self::FiltersInFile => f.write_str("the initial Gaussians were trained with it"),
            Self::Rates(spreads) => spelt_rates(f, spreads),
            Self::Checkpoint => f.write_str("as in the checkpoint"),
            Self::Detail(lost) => {
                write!(f, "1/{} of the photos' size at first", 1_u32 << lost.len())?;
                let grey = |lost: &f32| format!("{:.1}", 255.0 * lost);
                let grey: Vec<String> = lost.iter().rev().map(grey).collect();
                let grey = grey.join(", ");
                write!(f, ", double that when the loss is expected to be near the detail lost ({grey} grey levels)")
            }
            Self::LeastError(size, even) => spelt_size(f, *size, *even),
            Self::SmallPhotos => f.write_str("the photos are too small to be halved"),
            Self::Locality => {
                f.write_str("neighbours in space share cache lines and are culled together")
            }
            Self::UnseenBlocks => f.write_str("blocks that a view cannot see cost next to nothing"),
            Self::NoGradient => f.write_str(
                "no gradient comes from clear or masked tiles that no Gaussian reaches",
            ),
            Self::NoAlpha => f.write_str("no photo is transparent or masked"),
            Self::NeededBy(sampler) => write!(f, "{sampler} sampler"),
            Self::McmcCap(cap) => write!(f, "MCMC sampler, at most {cap} Gaussians"),
            Self::Criterion(text) => f.write_str(text),
            Self::FixedSet => f.write_str("a fixed set of Gaussians asked for"),
            Self::EstimatedIn(views) => write!(f, "births are estimated in {views} views"),
            Self::TrainsOn(lag) => write!(f, "{lag} iterations, in which the host decides"),
            Self::SameProcessor => f.write_str("the device is the processor that decides"),
            Self::EstimatesNeedDevice => f.write_str("births are estimated on the device"),
            Self::NoiseMovesFaint => f.write_str("mh.noise-rate moves faint Gaussians"),
            Self::PixelViews(views, surface, asked) => write!(
                f,
                "{views} views are rendered for each step, of weight {surface} on surfaces{}",
                if *asked { " that they agree about" } else { "" },
            ),
            Self::Free(share, radius) => free(f, *share, *radius),
            Self::AtMost(most) => write!(f, "--max-gaussians {most}"),
            Self::OverfitBeyond(most, places) => write!(
                f,
                "no births beyond {most} Gaussians: more would overfit {places} photos of this size (mh.pair-pixels)"
            ),
            Self::AtPoints(points) => write!(
                f,
                "no births beyond as many Gaussians as sparse points, {points}: more would overfit so few photos of this size (mh.pair-pixels)"
            ),
            Self::NoCameraSawBackground => f.write_str(NO_CAMERA_SAW),
            Self::TooShort => f.write_str("the run is too short to tell whether it is needed"),
            Self::ComparedFirst => f.write_str(
                "photos are compared with their renders first: on if their brightness varies",
            ),
            Self::Gains(gains) => write!(
                f,
                "after {} iterations the gains of {} photos over their renders spread by {:.1} %; on above {:.0} %",
                gains.iteration,
                gains.views,
                100.0 * f64::from(gains.spread),
                100.0 * MAX_SPREAD
            ),
            Self::Views(n) => write!(f, "{n} views are held out"),
            Self::NoHeldOut => f.write_str("no view is held out"),
            Self::Points(n) => write!(f, "{n} points"),
            Self::Swept(n) => write!(f, "the dataset has none; {n} were found where its photos agree"),
            Self::NoPoints => f.write_str(NO_POINTS),
            Self::NothingAgrees => f.write_str(NOTHING_AGREES),
            Self::Removed(n) => write!(
                f,
                "{n} removed at the end; the training views stay the same to the bit"
            ),
        }
    }
}

/// Spells the size of the photos where a smaller one promises the least error.
fn spelt_size(f: &mut fmt::Formatter<'_>, size: TrainingSize, even: u32) -> fmt::Result {
    let [num, den] = size.fraction();
    write!(
        f,
        "trained at {num}/{den} of it: of what fits into the budget that promises the least error (3/4 loses what {even} iterations leave)"
    )
}

/// Spells the spreads that decide: those that reach their bar, or all of them if none does.
fn spelt_rates(f: &mut fmt::Formatter<'_>, spreads: &Spreads) -> fmt::Result {
    let on = spreads.ask_for_filters();
    let measures = [
        (spreads.across, MIN_SPREAD, "from view to view"),
        (spreads.within, MIN_SPREAD_WITHIN, "within views"),
    ];
    let told = measures.into_iter().filter_map(|(spread, bar, place)| {
        let spread = spread.filter(|s| (*s >= bar) == on)?;
        Some(format!(
            "by a factor of {spread:.1} {place} (auto asks for {bar} or more)"
        ))
    });
    let told: Vec<String> = told.collect();
    match told.is_empty() {
        true => f.write_str("the views share no point to compare their sampling rates at"),
        false => write!(f, "sampling rates differ {}", told.join(" and ")),
    }
}
