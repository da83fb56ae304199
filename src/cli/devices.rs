//! `mhsplat devices`.

use mhsplat::error::Result;
use mhsplat::gpu::Device;
use serde_json::json;

use super::{Common, Outcome, output};

/// Lists devices; marks the default and says why.
pub fn run(common: &Common) -> Result<Outcome> {
    let list = Device::list()?;
    let default = Device::default_of(&list).map(|d| d.index);
    let why = "the first GPU, else the first accelerator, else the first CPU";
    if common.json {
        output::json(&json!({ "devices": list, "default": default, "why": why }))?;
        return Ok(Outcome::Done);
    }
    for d in &list {
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
    }
    output::line(&format!(
        "* is the default: {why}. Select with --device or MHSPLAT_DEVICE."
    ));
    Ok(Outcome::Done)
}
