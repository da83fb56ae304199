//! A comparison of runs: read, checked, grouped, timed and paired, with caveats and differences.

use serde::Serialize;

use crate::base::error::{Error, Result};
use crate::chart::text::fixed;
use crate::lab::compare::group::{Group, group};
use crate::lab::compare::load::{Clock, Loaded, Source, check_comparable, load_all};
use crate::lab::compare::paired::{Paired, paired};
use crate::lab::compare::thresholds::choose;
use crate::run::DatasetRecord;

/// Relative difference up to which numbers of Gaussians count as equal.
const EQUAL: f64 = 0.02;
/// Facts that change how long a second is.
const MACHINE: [&str; 5] = ["device", "platform", "driver", "version", "commit"];

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

/// An option, device or version that is not the same everywhere.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Difference {
    /// Name.
    pub what: String,
    /// Group by group; several values if the runs of a group differ.
    pub values: Vec<String>,
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
    let (thresholds, rule) = choose(&groups, &options.thresholds)?;
    for group in &mut groups {
        group.to_psnr = thresholds.iter().map(|t| group.target(*t)).collect();
    }
    let wanted = options.reference.as_ref().unwrap_or(&groups[0].label);
    let base = groups.iter().find(|g| g.label == *wanted).ok_or_else(|| {
        let all: Vec<&str> = groups.iter().map(|g| g.label.as_str()).collect();
        let what = format!("no group {wanted:?}; there are: {}", all.join("; "));
        Error::config("--reference", what)
    })?;
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

/// Different values of a fact among runs, in their order.
pub fn values<'a>(name: &str, runs: impl IntoIterator<Item = &'a Loaded>) -> Vec<&'a str> {
    let mut all = Vec::new();
    for value in runs.into_iter().map(|r| r.fact(name)) {
        if !all.contains(&value) {
            all.push(value);
        }
    }
    all
}

/// Facts that differ between groups or within one.
fn differences(groups: &[Group]) -> Vec<Difference> {
    let mut names = Vec::new();
    for (name, _) in groups.iter().flat_map(|g| &g.runs).flat_map(|r| &r.facts) {
        if !names.contains(&name.as_str()) {
            names.push(name.as_str());
        }
    }
    let shown = |name: &&str| {
        *name == "seed" || values(name, groups.iter().flat_map(|g| &g.runs)).len() > 1
    };
    let row = |name: &str| Difference {
        what: name.to_owned(),
        values: groups
            .iter()
            .map(|g| values(name, &g.runs).join("; "))
            .collect(),
    };
    names.into_iter().filter(shown).map(row).collect()
}

/// Caveats of the groups: settings mixed under one name, and other seeds, machines or numbers of Gaussians than the reference has.
fn remarks(groups: &[Group], base: &Group, clock: Clock) -> Vec<String> {
    let mut out = Vec::new();
    let gaussians = |g: &Group| g.end.get("gaussians").map_or(f64::NAN, |s| s.median);
    let count = |g: &Group| format!("{} ({})", fixed(gaussians(g), 0), g.label);
    let unequal = groups.iter().filter(|g| {
        let (a, b) = (gaussians(g), gaussians(base));
        a.max(b) > a.min(b) * (1.0 + EQUAL)
    });
    let unequal = unequal.map(count).collect::<Vec<_>>().join(", ");
    if !unequal.is_empty() {
        out.push(format!(
            "not at equal numbers of Gaussians: {} to {unequal}; --max-gaussians makes them equal",
            count(base)
        ));
    }
    let reference = &base.label;
    for group in groups {
        let label = &group.label;
        let names = group.runs[0].setting().iter().map(|f| f.0.as_str());
        let mixed = names.filter(|n| *n != "max-gaussians" && values(n, &group.runs).len() > 1);
        let mixed = mixed.collect::<Vec<_>>().join(", ");
        if !mixed.is_empty() {
            out.push(format!(
                "{label}: its runs differ in more than the seed: {mixed}"
            ));
        }
        let [own, other] = [group, base].map(|g| {
            let mut seeds = values("seed", &g.runs);
            seeds.sort_unstable();
            seeds.join(", ")
        });
        if own != other {
            out.push(format!(
                "{label}: seeds {own}, but {other} of {reference}; only those of both are compared"
            ));
        }
        let machine = MACHINE.iter().filter_map(|name| {
            let [own, other] = [group, base].map(|g| values(name, &g.runs).join("; "));
            (own != other).then(|| format!("{name} {own} instead of {other}"))
        });
        let machine = machine.collect::<Vec<_>>().join(", ");
        if clock != Clock::Iterations && !machine.is_empty() {
            out.push(format!(
                "{label}: {machine} of {reference}: seconds are not those of the same machine and program"
            ));
        }
    }
    out
}
