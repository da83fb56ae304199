//! The tuning of kernels for the device at hand: measured once for runs of a size, kept, and looked up from then on.
//!
//! A choice is kept per platform, device, driver, kernels and [`SizeClass`] in `mhsplat/tuning-*.json` under `$XDG_CACHE_HOME` or
//! `~/.cache`; a file that cannot be read or does not fit the device is measured anew. Which lanes are added in which order
//! depends on the choice, and with it the last bits of a scene. So that machines of one kind agree, a candidate replaces
//! the default of the device's class only where it is clearly faster ([`CLEARLY`]). In the group style candidates change one size each, or two that belong together, of
//! kernels that take their time one after the other: what the winners change is measured together, too.
//!
//! `MHSPLAT_TUNING` overrules: `default` is the class default, `measure` measures again, and
//! `vector-width=8,block-width=4` changes single values of the default.

use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::{Deserialize, Serialize};

use crate::base::error::{Error, Result};
use crate::capture::Dataset;
use crate::config::TrainConfig;
use crate::device::tuning::Tuning;
use crate::device::{Device, DeviceInfo, DeviceKind};
use crate::lab::bench::scene;
use crate::lab::cache;
use crate::lab::stats::Spread;
use crate::train::{Plan, Trainer};

/// Environment variable that overrides the choice.
pub const VARIABLE: &str = "MHSPLAT_TUNING";
/// Largest share of the default's time with which a candidate replaces it: on CPUs, whose neighbours' load makes times vary, and in the group
/// style, where they differ by less than a hundredth from run to run and every size changes one kernel or two (docs/results/gpu-measured.md).
pub const CLEARLY: [f64; 2] = [0.85, 0.98];
/// Most samples of every candidate, one after the other in turns, and the fewest.
const ROUNDS: [usize; 2] = [3, 7];
/// Seconds after which there are no more samples than the fewest.
const LONG: f64 = 2.0;
/// Views of the scene that candidates run on: a sample is an iteration with each.
const VIEWS: usize = 2;
/// Memory of a device below which it tunes for no large runs: all candidates hold their scenes at once.
const ROOMY: u64 = 12 << 30;

/// Class of runs by their size, for each of which a device has a tuning of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum SizeClass {
    /// Some ten thousand Gaussians, small photos.
    Small,
    /// Some hundred thousand Gaussians.
    Medium,
    /// Millions of Gaussians, large photos.
    Large,
}

impl SizeClass {
    const ALL: [Self; 3] = [Self::Small, Self::Medium, Self::Large];

    /// Gaussians and picture side of the scene that candidates run on.
    #[must_use]
    pub fn case(self) -> [usize; 2] {
        match self {
            Self::Small => [10_000, 320],
            Self::Medium => [100_000, 800],
            Self::Large => [1_000_000, 1600],
        }
    }

    /// The class of a scene of so many Gaussians in pictures of so many pixels: the larger one of both.
    #[must_use]
    pub fn of(gaussians: usize, pixels: usize) -> Self {
        let mut found = Self::Small;
        for [below, above] in [[Self::Small, Self::Medium], [Self::Medium, Self::Large]] {
            let [n, side] = below.case();
            let [more, longer] = above.case();
            // From halfway on, by ratio.
            if gaussians.pow(2) >= n * more || pixels >= side * longer {
                found = above;
            }
        }
        found
    }

    /// The class of a run, by its sparse points, which become many more or fewer, and its largest photo.
    #[must_use]
    pub fn of_run(dataset: &Dataset, config: &TrainConfig) -> Self {
        let points = dataset.points.positions.len();
        let pixels = |v: &crate::capture::View| v.camera.width as usize * v.camera.height as usize;
        let pixels = dataset.train.iter().map(pixels).max();
        Self::of(
            points.min(config.max_gaussians.unwrap_or(points)),
            pixels.unwrap_or(0),
        )
    }

    /// The classes that a device tells apart, the smallest first.
    #[must_use]
    pub fn told_apart(info: &DeviceInfo) -> &'static [Self] {
        match info.kind {
            // The best vectors are the same for larger scenes, which take ten times as long (docs/results/speed.md).
            DeviceKind::Cpu => &Self::ALL[..1],
            _ if info.global_memory < ROOMY => &Self::ALL[..2],
            _ => &Self::ALL,
        }
    }

    /// The class in whose place this one is measured on a device.
    fn on(self, info: &DeviceInfo) -> Self {
        let all = Self::told_apart(info);
        self.min(all[all.len() - 1])
    }
}

/// Origin of a tuning.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Origin {
    /// The default of the device's class.
    Default,
    /// Measured before.
    Measured,
    /// Supplied by the user.
    UserSupplied,
}

/// A measurement that is kept.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct CachedTuning {
    tuning: Tuning,
    /// Milliseconds of a passage through all stages, by candidate; the class default is the first.
    milliseconds: Vec<(Tuning, Spread)>,
}

/// The device with the tuning that the user, an earlier measurement or a measurement now says for runs of a size. `note` receives one
/// line when something is measured.
///
/// # Errors
/// An invalid value of `MHSPLAT_TUNING`. A measurement that fails leaves the default.
pub fn tuned(device: Device, size: SizeClass, note: &mut dyn FnMut(&str)) -> Result<Device> {
    let info = device.info();
    let size = size.on(info);
    if let Some((tuning, _)) = known(info, size)? {
        return Ok(device.with_tuning(tuning));
    }
    let of = match SizeClass::told_apart(info).len() {
        1 => String::new(),
        _ => {
            let [gaussians, side] = size.case();
            format!(" with {gaussians} Gaussians at {side} pixels")
        }
    };
    note(&format!(
        "measuring how kernels suit this device{of} (once)"
    ));
    let Some(kept) = measure(&device, size) else {
        return Ok(device);
    };
    if let (Some(file), Ok(text)) = (file(info, size), serde_json::to_vec_pretty(&kept)) {
        cache::keep(&file, &text);
    }
    Ok(device.with_tuning(kept.tuning))
}

/// The device for runs of another size: [`tuned`], where the device tells sizes apart, else as it is.
///
/// # Errors
/// See [`tuned`].
pub fn suited(device: &Device, size: SizeClass, note: &mut dyn FnMut(&str)) -> Result<Device> {
    match SizeClass::told_apart(device.info()).len() {
        1 => Ok(device.clone()),
        _ => tuned(device.clone(), size, note),
    }
}

/// The device with each tuning that it is known to have for runs of some size, every one once; the first is the one that it has.
///
/// # Errors
/// An invalid value of `MHSPLAT_TUNING`.
pub fn variants(device: &Device) -> Result<Vec<Device>> {
    let mut all = vec![device.clone()];
    for size in SizeClass::told_apart(device.info()) {
        let other = known(device.info(), *size)?.map(|(tuning, _)| tuning);
        let new = other.filter(|tuning| all.iter().all(|d| d.tuning() != *tuning));
        all.extend(new.map(|tuning| device.clone().with_tuning(tuning)));
    }
    Ok(all)
}

/// The tuning of a device for runs of a size without measuring; `None` if it has to be measured.
///
/// # Errors
/// An invalid value of `MHSPLAT_TUNING`.
pub fn known(info: &DeviceInfo, size: SizeClass) -> Result<Option<(Tuning, Origin)>> {
    let asked = std::env::var(VARIABLE).unwrap_or_default();
    Ok(match asked.as_str() {
        "measure" => None,
        "default" => Some((Tuning::for_device(info), Origin::Default)),
        "" => file(info, size)
            .and_then(|f| read(&f, info))
            .map(|tuning| (tuning, Origin::Measured)),
        _ => Some((given(&asked, info)?, Origin::UserSupplied)),
    })
}

/// The class default with the values of `name=value,name=value`.
fn given(asked: &str, info: &DeviceInfo) -> Result<Tuning> {
    let wrong = |what: String| Error::config(VARIABLE, what);
    let mut value = serde_json::to_value(Tuning::for_device(info))
        .map_err(|e| wrong(format!("the default cannot be written: {e}")))?;
    for part in asked.split(',') {
        let (name, text) = part.split_once('=').unwrap_or((part, ""));
        let old = value.get_mut(name.trim());
        let new = serde_json::from_str(text.trim()).ok();
        match (old, new) {
            (Some(old), Some(new)) => *old = new,
            _ => {
                return Err(wrong(format!(
                    "{part:?}; `default`, `measure` or name=value,... expected, with the names that `mhsplat devices` shows"
                )));
            }
        }
    }
    let mut tuning: Tuning = serde_json::from_value(value).map_err(|e| wrong(e.to_string()))?;
    let names_tile = asked.split(',').any(|part| part.trim().starts_with("tile"));
    if tuning.group_style && !names_tile {
        tuning.tile = Tuning::GPU.tile;
    }
    match tuning.fault(info) {
        Some(fault) => Err(wrong(format!("{asked:?}; {fault}"))),
        None => Ok(tuning),
    }
}

/// True if a measured tuning of a device is kept for runs of a size.
#[must_use]
pub fn is_kept(info: &DeviceInfo, size: SizeClass) -> bool {
    file(info, size).and_then(|f| read(&f, info)).is_some()
}

/// The file of a device and a size; `None` if the system has no place for it.
fn file(info: &DeviceInfo, size: SizeClass) -> Option<PathBuf> {
    cache::file("tuning", info, (size.on(info).case(), candidates(info)))
}

/// The tuning in a file, if that fits the device.
#[doc(hidden)]
#[must_use]
pub fn read(file: &Path, info: &DeviceInfo) -> Option<Tuning> {
    let kept: CachedTuning = serde_json::from_slice(&std::fs::read(file).ok()?).ok()?;
    kept.tuning.fault(info).is_none().then_some(kept.tuning)
}

/// Alternatives to a class default, itself among them: in the group style one size after the other is another.
#[must_use]
pub fn alternatives(own: Tuning) -> Vec<Tuning> {
    if own.group_style {
        let locals = [64, 128, 256].map(|local| Tuning { local, ..own });
        let chunks = [512, 1024, 2048].map(|chunks| Tuning { chunks, ..own });
        // Fewer bits take more passes: with 6 the sort has 26 launches where 8 have 17.
        let bits = [7, 8].map(|radix_bits| Tuning { radix_bits, ..own });
        let groups = [64, 128, 256].map(|splat_group| Tuning { splat_group, ..own });
        let sums = [(64, 5), (64, 2), (128, 3), (128, 2)];
        let sums = sums.map(|(grad_group, grad_sums)| Tuning {
            grad_group,
            grad_sums,
            ..own
        });
        let segments = [64, 128, 256].map(|grad_segment| Tuning {
            grad_segment,
            ..own
        });
        [&locals[..], &chunks, &bits, &groups, &sums, &segments].concat()
    } else {
        let widths = [(16, 4), (16, 8), (8, 4), (4, 4)];
        let width = |(vector_width, block_width)| Tuning {
            vector_width,
            block_width,
            ..own
        };
        widths.map(width).to_vec()
    }
}

/// The class default of a device and the alternatives that fit it.
#[doc(hidden)]
#[must_use]
pub fn candidates(info: &DeviceInfo) -> Vec<Tuning> {
    let own = Tuning::for_device(info);
    // Half the width can win where wide units are slow; a quarter never did.
    let fits =
        |t: &Tuning| *t != own && 2 * t.vector_width >= own.vector_width && t.fault(info).is_none();
    std::iter::once(own)
        .chain(alternatives(own).into_iter().filter(fits))
        .collect()
}

/// A candidate in training, and its samples.
struct Run {
    tuning: Tuning,
    trainer: Trainer,
    milliseconds: Vec<f64>,
}

impl Run {
    /// A sample: milliseconds of device time in an iteration; `None` if it fails.
    fn sample(&mut self) -> Option<f64> {
        let seconds = |trainer: &Trainer| -> f64 {
            let times = trainer.stage_times().into_iter();
            times.map(|(_, t)| t.seconds).sum()
        };
        let before = seconds(&self.trainer);
        let until = self.trainer.iteration() + VIEWS as u32;
        self.trainer.advance_to(until).ok()?;
        Some(1e3 / VIEWS as f64 * (seconds(&self.trainer) - before))
    }
}

/// Runs every candidate in turns, and after them what the best of them change together; `None` if even the default fails.
fn measure(device: &Device, size: SizeClass) -> Option<CachedTuning> {
    let own = Tuning::for_device(device.info());
    let mut milliseconds = samples(device, size, candidates(device.info()))?;
    let mut tuning = chosen(&milliseconds, own)?;
    if let Some(together) = together(&milliseconds, own)
        // In turns with the others again: a device is not as warm as it was.
        && let Some(again) = samples(device, size, vec![own, tuning, together])
        && let Some(best) = chosen(&again, own)
    {
        tuning = best;
        milliseconds.retain(|(one, _)| again.iter().all(|(other, _)| one != other));
        milliseconds.splice(0..0, again);
    }
    Some(CachedTuning {
        tuning,
        milliseconds,
    })
}

/// Milliseconds of an iteration with each tuning that can be built, of runs in turns.
fn samples(
    device: &Device,
    size: SizeClass,
    tunings: Vec<Tuning>,
) -> Option<Vec<(Tuning, Spread)>> {
    let [gaussians, side] = size.case();
    // Higher bands take most of the compiler's time and change little of what is compared.
    let splats = scene::cloud(gaussians).with_sh_degree(0).ok()?;
    let data = scene::dataset(&scene::circle(side as u32)[..VIEWS]);
    let plan = Plan::new(&data, &scene::still(0)).ok()?;
    let begin = |tuning| {
        let device = device.clone().with_tuning(tuning);
        let mut trainer = Trainer::new(&device, &data, &plan, &splats).ok()?;
        trainer.time_every_iteration();
        let mut run = Run {
            tuning,
            trainer,
            milliseconds: Vec::new(),
        };
        // The first one is not like the others.
        run.sample().map(|_| run)
    };
    let mut runs: Vec<Run> = tunings.into_iter().filter_map(begin).collect();
    let (began, [fewest, most]) = (Instant::now(), ROUNDS);
    for round in 0..most {
        if round >= fewest && began.elapsed().as_secs_f64() > LONG {
            break;
        }
        for run in &mut runs {
            let sample = run.sample();
            run.milliseconds.extend(sample);
        }
    }
    device.time_launches(false).ok()?;
    let spread = |run: Run| Some((run.tuning, Spread::of(&run.milliseconds)?));
    Some(runs.into_iter().filter_map(spread).collect())
}

/// True if a candidate is clearly faster than the default: by its median and by its best, and in the group style by each of its samples.
fn clearly(own: &Tuning, candidate: &Spread, default: &Spread) -> bool {
    let most = CLEARLY[usize::from(own.group_style)];
    candidate.median < most * default.median
        && candidate.min < most * default.min
        && (!own.group_style || candidate.max < default.min)
}

/// The default with the changes of every candidate that is clearly faster, of two that change the same sizes those of the faster one; `None`
/// unless it is another than all of them.
#[doc(hidden)]
#[must_use]
pub fn together(measured: &[(Tuning, Spread)], own: Tuning) -> Option<Tuning> {
    let (_, default) = measured.iter().find(|(t, _)| *t == own)?;
    let mut winners: Vec<_> = measured
        .iter()
        .filter(|(_, s)| own.group_style && clearly(&own, s, default))
        .collect();
    winners.sort_by(|a, b| b.1.median.total_cmp(&a.1.median));
    let mut all = own;
    for (t, _) in winners {
        let mut change = |of: &[fn(&mut Tuning) -> &mut u32]| {
            let (mut from, mut usual) = (*t, own);
            if of.iter().any(|f| f(&mut from) != f(&mut usual)) {
                of.iter().for_each(|f| *f(&mut all) = *f(&mut from));
            }
        };
        change(&[|t| &mut t.radix_bits]);
        change(&[|t| &mut t.splat_group]);
        change(&[|t| &mut t.grad_segment]);
        change(&[|t| &mut t.grad_group, |t| &mut t.grad_sums]);
        if t.local != own.local {
            all.local = t.local;
        }
        if t.chunks != own.chunks {
            all.chunks = t.chunks;
        }
    }
    measured.iter().all(|(t, _)| *t != all).then_some(all)
}

/// The choice among measured candidates: the fastest if it is clearly faster than the default, else the default.
#[doc(hidden)]
#[must_use]
pub fn chosen(measured: &[(Tuning, Spread)], own: Tuning) -> Option<Tuning> {
    let (_, default) = measured.iter().find(|(t, _)| *t == own)?;
    let fastest = measured
        .iter()
        .filter(|(_, s)| clearly(&own, s, default))
        .min_by(|a, b| a.1.median.total_cmp(&b.1.median));
    Some(fastest.map_or(own, |(t, _)| *t))
}
