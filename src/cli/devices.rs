//! `mhsplat devices`.

use serde_json::json;

use crate::cli::common::{Common, Outcome};
use crate::cli::output;
use mhsplat::base::error::Result;
use mhsplat::device::Device;
use mhsplat::device::tuning::Tuning;
use mhsplat::lab::tune;
use mhsplat::lab::tune::Origin;

/// Lists the devices, with the default marked and explained.
pub fn run(common: &Common) -> Result<Outcome> {
    let list = Device::list()?;
    let default = Device::default_of(&list).map(|d| d.index);
    let why = "the first GPU, else the first accelerator, else the first CPU";
    let tunings = list.iter().map(tune::known).collect::<Result<Vec<_>>>()?;
    if common.json {
        let tunings: Vec<_> = tunings
            .iter()
            .map(|t| t.map(|(tuning, origin)| json!({ "tuning": tuning, "origin": origin })))
            .collect();
        output::json(
            &json!({ "devices": list, "tunings": tunings, "default": default, "why": why }),
        )?;
        return Ok(Outcome::Done);
    }
    for (d, tuning) in list.iter().zip(&tunings) {
        let mark = if Some(d.index) == default { "*" } else { " " };
        output::line(&format!(
            "{mark} {}  {} [{:?}, {} compute units, f32 x {}, {}f64, {} MiB, buffers to {} MiB]\n     {}, driver {}",
            d.index,
            d.name,
            d.kind,
            d.compute_units,
            d.vector_width,
            if d.fp64 { "" } else { "no " },
            d.global_memory >> 20,
            d.max_alloc >> 20,
            d.platform,
            d.driver,
        ));
        output::line(&format!("     {}", tuning_line(tuning.as_ref())));
    }
    output::line(&format!(
        "* is the default: {why}. Select with --device or MHSPLAT_DEVICE."
    ));
    Ok(Outcome::Done)
}

/// Formats a tuning in the syntax of `MHSPLAT_TUNING`.
fn tuning_line(known: Option<&(Tuning, Origin)>) -> String {
    let Some((t, origin)) = known else {
        return "tuning: measured at first use".into();
    };
    let from = match origin {
        Origin::Default => "default of its class",
        Origin::Measured => "measured",
        Origin::UserSupplied => "given",
    };
    let fields = serde_json::to_string(t).unwrap_or_default();
    let fields = fields.replace(['{', '}', '"'], "").replace(':', "=");
    format!("tuning ({from}): {fields}")
}
