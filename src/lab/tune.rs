//! The tuning of kernels for the device at hand: measured once, kept, and looked up from then on.
//!
//! A choice is kept per platform, device, driver and kernels in `mhsplat/tuning-*.json` under `$XDG_CACHE_HOME` or
//! `~/.cache`; a file that cannot be read or does not fit the device is measured anew. Which lanes are added in which order
//! depends on the choice, and with it the last bits of a scene. So that machines of one kind agree, a candidate replaces
//! the default of the device's class only where it is clearly faster ([`CLEARLY`]).
//!
//! `MHSPLAT_TUNING` overrules: `default` is the class default, `measure` measures again, and
//! `vector-width=8,block-width=4` changes single values of the default.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::base::constants::ALPHA_MIN;
use crate::base::error::{Error, Result};
use crate::device::tuning::Tuning;
use crate::device::{Device, DeviceInfo};
use crate::lab::bench::scene;
use crate::lab::cache;
use crate::lab::stats::Spread;
use crate::lab::verify::pass;

/// Environment variable that overrides the choice.
pub const VARIABLE: &str = "MHSPLAT_TUNING";
/// Largest share of the default's time with which a candidate replaces it.
pub const CLEARLY: f64 = 0.85;
/// Gaussians and picture side of the scene that candidates run on.
const CASE: (usize, u32) = (10_000, 320);
/// Passages of every candidate, one after the other in turns.
const ROUNDS: usize = 7;

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

/// The device with the tuning that the user, an earlier measurement or a measurement now says. `note` receives one line
/// when something is measured.
///
/// # Errors
/// An invalid value of `MHSPLAT_TUNING`. A measurement that fails leaves the default.
pub fn tuned(device: Device, note: &mut dyn FnMut(&str)) -> Result<Device> {
    if let Some((tuning, _)) = known(device.info())? {
        return Ok(device.with_tuning(tuning));
    }
    note("measuring how kernels suit this device (once)");
    let Some(kept) = measure(&device) else {
        return Ok(device);
    };
    if let (Some(file), Ok(text)) = (file(device.info()), serde_json::to_vec_pretty(&kept)) {
        cache::keep(&file, &text);
    }
    Ok(device.with_tuning(kept.tuning))
}

/// The tuning of a device without measuring; `None` if it has to be measured.
///
/// # Errors
/// An invalid value of `MHSPLAT_TUNING`.
pub fn known(info: &DeviceInfo) -> Result<Option<(Tuning, Origin)>> {
    let asked = std::env::var(VARIABLE).unwrap_or_default();
    Ok(match asked.as_str() {
        "measure" => None,
        "default" => Some((Tuning::for_device(info), Origin::Default)),
        "" => file(info)
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
    let tuning: Tuning = serde_json::from_value(value).map_err(|e| wrong(e.to_string()))?;
    match tuning.fault(info) {
        Some(fault) => Err(wrong(format!("{asked:?}; {fault}"))),
        None => Ok(tuning),
    }
}

/// The file of a device; `None` if the system has no place for it.
fn file(info: &DeviceInfo) -> Option<PathBuf> {
    cache::file("tuning", info, candidates(info))
}

/// The tuning in a file, if that fits the device.
#[doc(hidden)]
#[must_use]
pub fn read(file: &Path, info: &DeviceInfo) -> Option<Tuning> {
    let kept: CachedTuning = serde_json::from_slice(&std::fs::read(file).ok()?).ok()?;
    kept.tuning.fault(info).is_none().then_some(kept.tuning)
}

/// The class default and its alternatives.
fn candidates(info: &DeviceInfo) -> Vec<Tuning> {
    let own = Tuning::for_device(info);
    let others = if own.group_style {
        [(64, 2048), (256, 2048), (128, 512), (128, 8192)].map(|(local, chunks)| Tuning {
            local,
            chunks,
            ..own
        })
    } else {
        [(16, 4), (16, 8), (8, 4), (4, 4)].map(|(vector_width, block_width)| Tuning {
            vector_width,
            block_width,
            ..own
        })
    };
    // Half the width can win where wide units are slow; a quarter never did.
    let fits =
        |t: &Tuning| *t != own && 2 * t.vector_width >= own.vector_width && t.fault(info).is_none();
    std::iter::once(own)
        .chain(others.into_iter().filter(fits))
        .collect()
}

/// Runs every candidate in turns; `None` if even the default fails.
fn measure(device: &Device) -> Option<CachedTuning> {
    let mut case = scene::case(CASE.0, CASE.1, ALPHA_MIN);
    // Higher bands take most of the compiler's time and change little of what is compared.
    case.splats = case.splats.with_sh_degree(0).ok()?;
    case.sh_degree = 0;
    let milliseconds = |tuning: Tuning| {
        let out = pass::run::<f32>(device, tuning, &case, None).ok()?;
        Some(1e3 * out.seconds.iter().map(|(_, s)| s).sum::<f64>())
    };
    // The first passage may wait for the compiler.
    let all = candidates(device.info()).into_iter();
    let all: Vec<Tuning> = all.filter(|t| milliseconds(*t).is_some()).collect();
    let mut samples = vec![Vec::new(); all.len()];
    for _ in 0..ROUNDS {
        for (tuning, samples) in all.iter().zip(&mut samples) {
            samples.extend(milliseconds(*tuning));
        }
    }
    let spreads = all.into_iter().zip(&samples);
    let milliseconds: Vec<(Tuning, Spread)> = spreads
        .filter_map(|(tuning, samples)| Some((tuning, Spread::of(samples)?)))
        .collect();
    Some(CachedTuning {
        tuning: chosen(&milliseconds, Tuning::for_device(device.info()))?,
        milliseconds,
    })
}

/// The choice among measured candidates: the fastest if it is clearly faster than the default, by its median and by its best, else the default.
#[doc(hidden)]
#[must_use]
pub fn chosen(measured: &[(Tuning, Spread)], own: Tuning) -> Option<Tuning> {
    let (_, default) = measured.iter().find(|(t, _)| *t == own)?;
    let clearly = |(_, s): &&(Tuning, Spread)| {
        s.median < CLEARLY * default.median && s.min < CLEARLY * default.min
    };
    let fastest = measured
        .iter()
        .filter(clearly)
        .min_by(|a, b| a.1.median.total_cmp(&b.1.median));
    Some(fastest.map_or(own, |(t, _)| *t))
}
