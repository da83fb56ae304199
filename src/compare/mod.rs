//! Error against run time of several runs, and what may be said of the difference.
//!
//! Runs that differ in nothing but the seed are samples of one group. Times are interpolated between evaluations; a PSNR that
//! a run never has is "not reached", never a number. Of two groups a ratio is given only where both have runs of
//! [`RATIO_SAMPLES`](crate::report::spread::RATIO_SAMPLES) seeds. Runs over other views or at another resolution are refused.
//!
//! | file | what |
//! |---|---|
//! | `load.rs` | run folders, clocks |
//! | `check.rs` | whether they may be compared |
//! | `group.rs` | which of them are samples of one thing |
//! | `curve.rs` | first crossings, bands |
//! | `outcome.rs` | figures of a group, ratios of two |
//! | `tables.rs`, `page.rs` | Markdown and HTML |
//!
//! Tests: compare.

mod check;
pub mod curve;
mod group;
mod load;
mod outcome;
mod page;
mod tables;

pub use check::ALLOW;
pub use group::{Group, group};
pub use load::{Clock, Loaded, Source, finished};
pub use outcome::geometric_mean;
pub use outcome::{
    Difference, GroupOutcome, Reach, Relative, RelativeTime, RunOutcome, Share, Target,
};
pub use page::{GENERATOR, check_page, page, warnings, write_page};
pub use tables::{finals, markdown, relative, tables, times};

use serde::Serialize;

use crate::error::{Error, Result};
use crate::report::DatasetRecord;
use crate::report::svg::ticks;

/// How runs are compared.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Options {
    /// What times are told by; none for CPU seconds where all runs have them, else training seconds.
    pub clock: Option<Clock>,
    /// PSNR values that runs are timed to, dB; none for round ones within the range of the runs.
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
    let thresholds = thresholds(&runs, &groups, &options.thresholds)?;
    let outcomes: Vec<GroupOutcome> = groups
        .iter()
        .map(|g| outcome::of_group(g, &runs, &thresholds))
        .collect();
    warnings.extend(outcome::remarks(&groups, &runs, &outcomes));
    Ok(Comparison {
        version: env!("CARGO_PKG_VERSION"),
        dataset: runs[0].record.dataset.clone(),
        warnings,
        clock,
        reference: groups[reference].label.clone(),
        relative: outcome::relative(&outcomes, reference, clock),
        differences: outcome::differences(&groups, &runs),
        thresholds,
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

/// Thresholds as asked for, or about six round ones: above what every run has at its first evaluation, and not above what the
/// best run ends with.
fn thresholds(runs: &[Loaded], groups: &[Group], asked: &[f64]) -> Result<Vec<f64>> {
    if let Some(bad) = asked.iter().find(|v| !v.is_finite()) {
        return Err(Error::config(
            "--threshold",
            format!("{bad}; finite numbers expected"),
        ));
    }
    let mut all = asked.to_vec();
    if all.is_empty() {
        let curves: Vec<_> = runs.iter().map(|r| r.psnr(Clock::Iterations)).collect();
        let firsts = curves.iter().filter_map(|c| Some(c.points().first()?.1));
        let low = firsts.fold(f64::NEG_INFINITY, f64::max);
        let lasts = curves.iter().filter_map(curve::Curve::last);
        let best = lasts.fold(f64::NEG_INFINITY, f64::max);
        // Differences are at the upper end: from half-way up, or from the worst group's end if that is lower.
        let worst = groups.iter().map(|g| {
            let ends = g.runs.iter().filter_map(|r| curves[*r].last());
            ends.fold(f64::NEG_INFINITY, f64::max)
        });
        let half = f64::midpoint(low, best);
        let from = worst.fold(half, f64::min).max(low);
        let round = ticks(from, best, 6, false).map_or_else(Vec::new, |t| t.at);
        all = round
            .into_iter()
            .filter(|v| *v > low && *v <= best)
            .collect();
    }
    all.sort_by(f64::total_cmp);
    all.dedup();
    Ok(all)
}
