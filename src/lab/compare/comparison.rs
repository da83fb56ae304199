//! A comparison of runs: read, checked, grouped, timed and paired.

use serde::Serialize;

use crate::base::error::{Error, Result};
use crate::lab::compare::group::{Group, group};
use crate::lab::compare::load::{Clock, Loaded, Source, check_comparable, load_all};
use crate::lab::compare::paired::{Paired, paired};
use crate::lab::compare::remarks::{Difference, differences, remarks};
use crate::lab::compare::thresholds::choose;
use crate::run::DatasetRecord;

/// Options of a comparison.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Options {
    /// Clock of the times; `None`: CPU seconds if all runs have them, else training seconds.
    pub clock: Option<Clock>,
    /// PSNR values that runs are timed to, dB; empty: by the rule in `thresholds.rs`.
    pub thresholds: Vec<f64>,
    /// Label of the group that the others are compared with; `None`: the first.
    pub reference: Option<String>,
    /// Compare even what is not comparable, with a warning.
    pub allow_different: bool,
}

/// Several runs side by side.
#[derive(Debug, Clone, Serialize)]
pub struct Comparison {
    /// Version of this package.
    pub version: &'static str,
    /// The dataset of the first run.
    pub dataset: DatasetRecord,
    /// Caveats.
    pub warnings: Vec<String>,
    /// Clock of the times.
    pub clock: Clock,
    /// PSNR values that runs are timed to, dB.
    pub thresholds: Vec<f64>,
    /// Rule by which they were chosen.
    pub threshold_rule: &'static str,
    /// Label of the group that the others are compared with.
    pub reference: String,
    /// The groups, in the order of their first runs.
    pub groups: Vec<Group>,
    /// Each other group against the reference, run by run.
    pub relative: Vec<Paired>,
    /// Options, devices and versions that differ between the groups.
    pub differences: Vec<Difference>,
}

impl Comparison {
    /// All runs, group by group.
    pub fn runs(&self) -> impl Iterator<Item = &Loaded> {
        self.groups.iter().flat_map(|g| &g.runs)
    }
}

/// Reads and compares runs.
///
/// # Errors
/// A folder that is no run, runs that are not comparable, thresholds that are not finite, or a reference that is no group.
pub fn compare(sources: &[Source], options: &Options) -> Result<Comparison> {
    let mut warnings = Vec::new();
    let runs = load_all(sources, &mut warnings)?;
    check_comparable(&runs, options.allow_different, &mut warnings)?;
    let clock = choose_clock(&runs, options.clock, &mut warnings)?;
    let dataset = runs[0].record.dataset.clone();
    let mut groups = group(runs);
    let reference = match &options.reference {
        None => 0,
        Some(wanted) => groups
            .iter()
            .position(|g| g.label == *wanted)
            .ok_or_else(|| {
                let all: Vec<&str> = groups.iter().map(|g| g.label.as_str()).collect();
                Error::config(
                    "--reference",
                    format!("no group {wanted:?}; there are: {}", all.join("; ")),
                )
            })?,
    };
    let (thresholds, rule) = choose(&groups, reference, &options.thresholds)?;
    for group in &mut groups {
        group.to_psnr = thresholds.iter().map(|t| group.target(*t)).collect();
    }
    let base = &groups[reference];
    warnings.extend(remarks(&groups, base, clock));
    Ok(Comparison {
        version: env!("CARGO_PKG_VERSION"),
        dataset,
        warnings,
        clock,
        reference: base.label.clone(),
        relative: paired(&groups, base, clock),
        differences: differences(&groups),
        thresholds,
        threshold_rule: rule,
        groups,
    })
}

/// The clock asked for, or the best that all runs have.
fn choose_clock(
    runs: &[Loaded],
    asked: Option<Clock>,
    warnings: &mut Vec<String>,
) -> Result<Clock> {
    let without = runs.iter().find(|r| !r.has(Clock::Cpu));
    match (asked, without) {
        (Some(Clock::Cpu), Some(Loaded { path, .. })) => Err(Error::config(
            "--clock",
            format!("{path} has no CPU seconds; give train, wall or iterations"),
        )),
        (None, Some(Loaded { path, .. })) => {
            warnings.push(format!(
                "{path}: no CPU seconds; training seconds are the clock"
            ));
            Ok(Clock::Train)
        }
        (asked, _) => Ok(asked.unwrap_or_default()),
    }
}
