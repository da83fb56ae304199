//! `mhsplat verify`.

use std::path::PathBuf;

use clap::ValueEnum;

use crate::cli::common::{Common, DeviceOption, Outcome};
use crate::cli::lab::Form;
use crate::cli::output;
use mhsplat::base::error::{Error, Result};
use mhsplat::device::Device;
use mhsplat::lab::folder::check_folder;
use mhsplat::lab::tune::variants;
use mhsplat::lab::verify::page::{json, report, write_folder};
use mhsplat::lab::verify::stress::stress;
use mhsplat::lab::verify::{Verification, quick, tiny};

/// Suites of cases.
#[derive(Clone, Copy, ValueEnum)]
enum Suite {
    /// Three scenes of two tiles or three, for interpreters of kernels.
    Tiny,
    /// A few small scenes.
    Quick,
    /// Stiff and extreme cases: the error against the stiffness.
    Stress,
}

/// Arguments.
#[derive(clap::Args)]
pub struct VerifyArgs {
    /// Cases to check.
    #[arg(long, value_enum, default_value = "quick")]
    suite: Suite,
    /// Folder for verify.html, verify.json and verify.md; must be empty or not exist.
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    #[command(flatten)]
    device: DeviceOption,
    #[command(flatten)]
    form: Form,
}

/// Checks one device, or all of them with --device all, in every tuning that it is known to have for scenes of some size.
pub fn run(args: &VerifyArgs, common: &Common) -> Result<Outcome> {
    if let Some(dir) = &args.output {
        check_folder(dir)?;
    }
    let suite = match args.suite {
        Suite::Tiny => tiny,
        Suite::Quick => quick,
        Suite::Stress => stress,
    };
    let selectors: Vec<Option<String>> = match args.device.selector().as_deref() {
        Some("all") => Device::list()?
            .iter()
            .map(|d| Some(d.index.to_string()))
            .collect(),
        other => vec![other.map(str::to_owned)],
    };
    let mut results: Vec<Verification> = Vec::new();
    for selector in &selectors {
        let device = args.device.open_tuned(selector.as_deref())?;
        for device in variants(&device)? {
            results.push(suite(&device)?);
        }
    }
    if let Some(dir) = &args.output {
        write_folder(dir, &results)?;
    }
    if common.json {
        output::line(&json(&results)?);
    } else {
        args.form.print(&report(&results));
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
