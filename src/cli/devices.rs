//! `mhsplat devices`.

use serde_json::json;

use crate::cli::common::{Common, Outcome, tested};
use crate::cli::output;
use mhsplat::base::cores::Cores;
use mhsplat::base::error::{Error, Result};
use mhsplat::device::tuning::Tuning;
use mhsplat::device::{Device, DeviceInfo, DeviceKind};
use mhsplat::lab::tune;
use mhsplat::lab::tune::{Origin, SizeClass};

/// Arguments.
#[derive(clap::Args)]
pub struct DevicesArgs {
    /// Measure now, and not at first use, how kernels suit a device with scenes of every size, and test it, as far as that has not been done:
    /// that of MHSPLAT_DEVICE, else the default.
    #[arg(long)]
    tune: bool,
}

/// Lists the devices, with the default marked and explained.
pub fn run(common: &Common, args: &DevicesArgs) -> Result<Outcome> {
    if args.tune {
        measure_tunings()?;
    }
    let list = Device::list()?;
    let default = Device::default_of(&list).map(|d| d.index);
    let why = "the first GPU, else the first accelerator, else the first CPU";
    let tunings = list.iter().map(tunings).collect::<Result<Vec<_>>>()?;
    if common.json {
        let tunings: Vec<_> = tunings
            .iter()
            .map(|of| of.iter().map(object).collect::<Vec<_>>())
            .collect();
        output::json(
            &json!({ "devices": list, "tunings": tunings, "default": default, "why": why }),
        )?;
        return Ok(Outcome::Done);
    }
    for (d, tunings) in list.iter().zip(&tunings) {
        let mark = if Some(d.index) == default { "*" } else { " " };
        output::line(&format!(
            "{mark} {}  {} [{:?}, {}, f32 x {}, {}f64, {} MiB, buffers to {} MiB]\n     {}, driver {}",
            d.index,
            d.name,
            d.kind,
            d.units(),
            d.vector_width,
            if d.fp64 { "" } else { "no " },
            d.global_memory >> 20,
            d.max_alloc >> 20,
            d.platform,
            d.driver,
        ));
        if d.kind == DeviceKind::Cpu && d.cores as usize > Cores::allowed().count() {
            output::line(&format!(
                "     all of them are taken, though this process may use {}: the driver cannot divide the device (set its own variable, \
                 POCL_MAX_PTHREAD_COUNT for PoCL)",
                Cores::allowed().count()
            ));
        }
        for tuning in tunings {
            output::line(&format!("     {}", tuning_line(tuning)));
        }
    }
    output::line(&format!(
        "* is the default: {why}. Select with --device or MHSPLAT_DEVICE."
    ));
    Ok(Outcome::Done)
}

/// Measures and keeps the tunings of the selected device that are not known, and tests it with each.
fn measure_tunings() -> Result<()> {
    if !matches!(
        std::env::var(tune::VARIABLE).as_deref(),
        Err(_) | Ok("" | "measure")
    ) {
        return Err(Error::config(
            tune::VARIABLE,
            "it says which sizes are taken, so that --tune has nothing to measure; unset it",
        ));
    }
    let selector = std::env::var("MHSPLAT_DEVICE").ok();
    let device = Device::open(selector.as_deref().filter(|selector| !selector.is_empty()))?;
    for size in SizeClass::told_apart(device.info()) {
        tested(device.clone(), *size)?;
        if !tune::is_kept(device.info(), *size) {
            return Err(Error::config(
                "--tune",
                "nothing could be measured and kept; there must be a folder for it (XDG_CACHE_HOME, else ~/.cache) that can be written",
            ));
        }
    }
    Ok(())
}

/// Tuning for scenes of a size, as far as it is known; without a size it is for all.
struct Known {
    size: Option<SizeClass>,
    tuning: Option<(Tuning, Origin)>,
}

/// The tunings of a device: one for each size that it tells apart, unless all have the same.
fn tunings(info: &DeviceInfo) -> Result<Vec<Known>> {
    let sizes = SizeClass::told_apart(info);
    let known = |size: &SizeClass| {
        Ok(Known {
            size: (sizes.len() > 1).then_some(*size),
            tuning: tune::known(info, *size)?,
        })
    };
    let mut all = sizes.iter().map(known).collect::<Result<Vec<_>>>()?;
    if let [first, others @ ..] = all.as_mut_slice()
        && others.iter().all(|other| other.tuning == first.tuning)
    {
        first.size = None;
        all.truncate(1);
    }
    Ok(all)
}

/// A tuning as JSON; a size or a tuning that there is not is null.
fn object(known: &Known) -> serde_json::Value {
    let (tuning, origin) = known.tuning.unzip();
    json!({ "size": known.size, "tuning": tuning, "origin": origin })
}

/// Formats a tuning in the syntax of `MHSPLAT_TUNING`.
fn tuning_line(known: &Known) -> String {
    let of = known.size.map_or_else(String::new, |size| {
        let [gaussians, side] = size.case();
        format!(" with {gaussians} Gaussians at {side} pixels")
    });
    let Some((tuning, origin)) = known.tuning else {
        return format!("tuning{of}: measured at first use");
    };
    let from = match origin {
        Origin::Default => "default of its class",
        Origin::Measured => "measured",
        Origin::UserSupplied => "given",
    };
    format!("tuning{of} ({from}): {tuning}")
}
