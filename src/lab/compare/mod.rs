//! Error against run time of several runs, and what may be said of the difference.
//!
//! Runs that differ in nothing but the seed are samples of one group. Times are interpolated between evaluations; a PSNR that
//! a run never has is "not reached", never a number: it counts as a bound beside the mean of the others. Of two groups a ratio
//! is given only where both have runs of [`RATIO_SAMPLES`](crate::lab::stats::RATIO_SAMPLES) seeds. Runs over other views or at another resolution are refused.
//!
//! | file | what |
//! |---|---|
//! | `load.rs` | run folders, clocks |
//! | `check.rs` | whether they may be compared |
//! | `group.rs` | which of them are samples of one thing |
//! | `curve.rs` | first crossings, bands |
//! | `thresholds.rs` | PSNR values that runs are timed to |
//! | `outcome.rs` | figures of a group |
//! | `relative.rs` | ratios of two, bounds, means |
//! | `paired.rs` | the same seed by seed, and what may be said of it |
//! | `remarks.rs` | what the reader has to know, and what differs |
//! | `tables.rs`, `page.rs` | Markdown and HTML |
//!
//! Tests: compare.

mod check;
pub mod curve;
mod group;
mod load;
mod outcome;
mod page;
mod paired;
mod relative;
mod remarks;
mod tables;
pub mod thresholds;

pub use crate::lab::compare::check::ALLOW;
pub use crate::lab::compare::group::{Group, group};
pub use crate::lab::compare::load::{Clock, Loaded, Source, finished};
pub use crate::lab::compare::outcome::{GroupOutcome, Reach, RunOutcome, Share, Target};
pub use crate::lab::compare::page::{page, warnings};
pub use crate::lab::compare::paired::{
    FINAL_BELOW, Paired, PairedTime, SeedRatio, Verdict, few, paired,
};
pub use crate::lab::compare::relative::{Bound, Bounded, Counts, Limit, Relative, RelativeTime};
pub use crate::lab::compare::remarks::Difference;
pub use crate::lab::compare::tables::{
    bounded, decibels, finals, limit, markdown, relative, tables, times,
};
pub use crate::lab::page::{GENERATOR, check_page, write_page};

use serde::Serialize;

use crate::base::error::{Error, Result};
use crate::run::DatasetRecord;

/// How runs are compared.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Options {
    /// What times are told by; none for CPU seconds where all runs have them, else training seconds.
    pub clock: Option<Clock>,
    /// PSNR values that runs are timed to, dB; none for the rule in `thresholds.rs`.
    pub thresholds: Vec<f64>,
    /// Label of the group that ratios are taken against; none for the first.
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
    /// What the reader has to know.
    pub warnings: Vec<String>,
    /// What times are told by.
    pub clock: Clock,
    /// PSNR values that runs are timed to, dB.
    pub thresholds: Vec<f64>,
    /// How they were chosen.
    pub threshold_rule: &'static str,
    /// Label of the group that ratios are taken against.
    pub reference: String,
    /// The groups, in the order of their first runs.
    pub groups: Vec<GroupOutcome>,
    /// Time of the other groups over that of the reference.
    pub relative: Vec<Relative>,
    /// What differs between the groups.
    pub differences: Vec<Difference>,
    /// The runs themselves, for the charts.
    #[serde(skip)]
    runs: Vec<Loaded>,
}

impl Comparison {
    /// Place of the group that ratios are taken against.
    #[must_use]
    pub fn reference_place(&self) -> usize {
        let own = |g: &GroupOutcome| g.label == self.reference;
        self.groups.iter().position(own).unwrap_or(0)
    }

    /// Names of the devices that the runs were trained on.
    #[must_use]
    pub fn device(&self) -> String {
        let mut names: Vec<&str> = Vec::new();
        for run in &self.runs {
            let name = run.record.device.name.as_str();
            if !names.contains(&name) {
                names.push(name);
            }
        }
        names.join(", ")
    }
}

/// Reads and compares runs.
///
/// # Errors
/// A folder that is no run, runs that are not comparable, thresholds that are not finite, or a reference that is no group.
pub fn compare(sources: &[Source], options: &Options) -> Result<Comparison> {
    let mut warnings = Vec::new();
    let runs = load::load_all(sources, &mut warnings)?;
    check::check(&runs, options.allow_different, &mut warnings)?;
    let clock = choose_clock(&runs, options.clock, &mut warnings)?;
    let groups = group(&runs);
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
    let (thresholds, rule) = thresholds::choose(&runs, &groups, reference, &options.thresholds)?;
    let outcomes: Vec<GroupOutcome> = groups
        .iter()
        .map(|g| outcome::of_group(g, &runs, &thresholds))
        .collect();
    warnings.extend(remarks::remarks(
        &groups, &runs, &outcomes, reference, clock,
    ));
    Ok(Comparison {
        version: env!("CARGO_PKG_VERSION"),
        dataset: runs[0].record.dataset.clone(),
        warnings,
        clock,
        reference: groups[reference].label.clone(),
        relative: relative::relative(&outcomes, reference, clock),
        differences: remarks::differences(&groups, &runs),
        thresholds,
        threshold_rule: rule,
        groups: outcomes,
        runs,
    })
}

fn choose_clock(
    runs: &[Loaded],
    asked: Option<Clock>,
    warnings: &mut Vec<String>,
) -> Result<Clock> {
    let without = runs.iter().find(|r| !r.has_cpu());
    match (asked, without) {
        (Some(Clock::Cpu), Some(run)) => Err(Error::config(
            "--clock",
            format!(
                "{} has no CPU seconds; give train, wall or iterations",
                run.source.path.display()
            ),
        )),
        (None, Some(run)) => {
            warnings.push(format!(
                "{}: no CPU seconds; training seconds are the clock",
                run.source.path.display()
            ));
            Ok(Clock::Train)
        }
        (asked, _) => Ok(asked.unwrap_or_default()),
    }
}
