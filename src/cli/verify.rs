//! `mhsplat verify`.

use clap::ValueEnum;
use mhsplat::error::{Error, Result};
use mhsplat::gpu::Device;
use mhsplat::verify::{Verification, quick};

use super::{Common, Outcome, output};

/// Which cases.
#[derive(Clone, Copy, ValueEnum)]
enum Suite {
    /// A few small scenes.
    Quick,
}

/// Arguments.
#[derive(clap::Args)]
pub struct VerifyArgs {
    /// Which cases.
    #[arg(long, value_enum, default_value = "quick")]
    suite: Suite,
}

/// Checks one device, or all of them with --device all.
pub fn run(args: &VerifyArgs, common: &Common) -> Result<Outcome> {
    let Suite::Quick = args.suite;
    let selectors: Vec<Option<String>> = match common.device.as_deref() {
        Some("all") => Device::list()?
            .iter()
            .map(|d| Some(d.index.to_string()))
            .collect(),
        other => vec![other.map(str::to_owned)],
    };
    let results = selectors
        .iter()
        .map(|s| quick(&super::open_device(s.as_deref())?))
        .collect::<Result<Vec<Verification>>>()?;
    if common.json {
        match results.as_slice() {
            [one] => output::json(one)?,
            all => output::json(&all)?,
        }
    } else {
        results.iter().for_each(print);
    }
    if results.is_empty() {
        return Err(Error::device(
            "verify",
            "no device",
            "see `mhsplat devices`",
        ));
    }
    let failed: usize = results.iter().map(|r| r.failed).sum();
    Ok(if failed == 0 {
        Outcome::Done
    } else {
        Outcome::Missed
    })
}

fn print(v: &Verification) {
    output::line(&format!("{}: suite {}", v.device, v.suite));
    output::line(&format!(
        "{:8} {:28} {:13} {:42} {:>9} {:>9} {:>8} {:>6}",
        "family", "case", "stage", "quantity", "max", "median", "bound", "flips"
    ));
    for r in &v.cases {
        output::line(&format!(
            "{:8} {:28} {:13} {:42} {:9.1e} {:9.1e} {:8.0e} {:6} {}",
            r.family,
            r.case,
            r.stage,
            r.quantity,
            r.max_rel_error,
            r.median_rel_error,
            r.bound,
            r.flips,
            if r.pass { "" } else { "FAILED" }
        ));
    }
    output::line(&format!("{} passed, {} failed", v.passed, v.failed));
}
