//! Caveats of a comparison, and the differences between its groups.

use std::collections::BTreeSet;

use serde::Serialize;

use crate::chart::text::fixed;
use crate::lab::compare::group::{Facts, Group, facts};
use crate::lab::compare::load::{Clock, Loaded};
use crate::lab::compare::outcome::{GroupOutcome, RunOutcome};
use crate::lab::stats::Spread;

/// Fall from the best PSNR to the last one that is worth a caveat, dB.
const FALL: f64 = 0.5;
/// Relative difference up to which numbers of Gaussians count as equal.
pub const EQUAL: f64 = 0.02;
/// Ratio of the evaluation intervals of two groups that is worth a caveat.
const SPACING: f64 = 1.5;
/// Facts that change how long a second is.
const MACHINE: [&str; 5] = ["device", "platform", "driver", "version", "commit"];

/// An option, device or version that is not the same everywhere.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Difference {
    /// Name.
    pub what: String,
    /// Group by group; several values if the runs of a group differ.
    pub values: Vec<String>,
}

/// Different values of a fact among runs, in their order.
fn values<'a>(name: &str, members: impl Iterator<Item = &'a Facts>) -> Vec<&'a str> {
    let mut all = Vec::new();
    for facts in members {
        let found = facts.iter().find(|f| f.0 == name);
        let value = found.map_or("", |f| f.1.as_str());
        if !all.contains(&value) {
            all.push(value);
        }
    }
    all
}

/// Facts that differ between groups or within one.
pub fn differences(groups: &[Group], runs: &[Loaded]) -> Vec<Difference> {
    let mut all: Vec<Facts> = runs.iter().map(facts).collect();
    for (facts, run) in all.iter_mut().zip(runs) {
        facts.insert(0, ("dataset".into(), run.record.dataset.path.clone()));
        facts.insert(1, ("seed".into(), run.record.seed.to_string()));
    }
    let names: Vec<&str> = all[0].iter().map(|f| f.0.as_str()).collect();
    let shown = |name: &&str| *name == "seed" || values(name, all.iter()).len() > 1;
    let row = |name: &str| {
        let of = |g: &Group| values(name, g.runs.iter().map(|r| &all[*r])).join("; ");
        Difference {
            what: name.to_owned(),
            values: groups.iter().map(of).collect(),
        }
    };
    names.into_iter().filter(shown).map(row).collect()
}

/// Caveats of the groups: settings mixed under one name, and inequalities between them.
pub fn remarks(
    groups: &[Group],
    runs: &[Loaded],
    outcomes: &[GroupOutcome],
    reference: usize,
    clock: Clock,
) -> Vec<String> {
    let mut out: Vec<String> = groups.iter().filter_map(|g| mixed(g, runs)).collect();
    out.extend(groups.iter().filter_map(|g| fallen(g, runs)));
    let unequal = unequal(outcomes, reference);
    if !unequal.is_empty() {
        let count = |g: &GroupOutcome| {
            let gaussians = g.gaussians.map_or(f64::NAN, |s| s.median);
            format!("{} ({})", fixed(gaussians, 0), g.label)
        };
        let others: Vec<String> = unequal.into_iter().map(count).collect();
        out.push(format!(
            "not at equal numbers of Gaussians: {} to {}; --max-gaussians makes them equal",
            count(&outcomes[reference]),
            others.join(", ")
        ));
    }
    let others = || (0..groups.len()).filter(|i| *i != reference);
    out.extend(others().filter_map(|i| other_seeds(&outcomes[i], &outcomes[reference])));
    if clock != Clock::Iterations {
        let machine = |i| other_machine(&groups[i], &groups[reference], runs);
        out.extend(others().filter_map(machine));
    }
    let spaced = |i| other_spacing(&groups[i], &groups[reference], runs, clock);
    out.extend(others().filter_map(spaced));
    out
}

/// The caveat that settings are mixed under one name.
fn mixed(group: &Group, runs: &[Loaded]) -> Option<String> {
    let all: Vec<Facts> = group.runs.iter().map(|r| facts(&runs[*r])).collect();
    let names = all.first()?.iter().map(|f| f.0.as_str());
    let mixed = names.filter(|n| *n != "max-gaussians" && values(n, all.iter()).len() > 1);
    let mixed: Vec<&str> = mixed.collect();
    (!mixed.is_empty()).then(|| {
        format!(
            "{}: its runs differ in more than the seed: {}",
            group.label,
            mixed.join(", ")
        )
    })
}

/// Groups with other numbers of Gaussians than the reference.
pub fn unequal(outcomes: &[GroupOutcome], reference: usize) -> Vec<&GroupOutcome> {
    let median = |g: &GroupOutcome| g.gaussians.map(|s| s.median);
    let Some(base) = outcomes.get(reference).and_then(median) else {
        return Vec::new();
    };
    let other = |g: &&GroupOutcome| {
        median(g).is_some_and(|own| own.max(base) > own.min(base) * (1.0 + EQUAL))
    };
    outcomes.iter().filter(other).collect()
}

/// The caveat that the seeds of a group are not those of the reference.
fn other_seeds(group: &GroupOutcome, base: &GroupOutcome) -> Option<String> {
    let [own, all] = [group, base].map(|g| {
        let seeds: BTreeSet<u64> = g.runs.iter().map(|r| r.seed).collect();
        let words: Vec<String> = seeds.iter().map(u64::to_string).collect();
        words.join(", ")
    });
    let common = |r: &RunOutcome| base.runs.iter().any(|b| b.seed == r.seed);
    let pairs = match group.runs.iter().any(common) {
        true => "the others are in no pair",
        false => "pairs are in the order of the runs",
    };
    (own != all).then(|| {
        format!(
            "{}: seeds {own}, but {all} of {}; {pairs}",
            group.label, base.label
        )
    })
}

/// The caveat that a group was trained on another device, or by another version, than the reference.
fn other_machine(group: &Group, base: &Group, runs: &[Loaded]) -> Option<String> {
    let all = |g: &Group| -> Vec<Facts> { g.runs.iter().map(|r| facts(&runs[*r])).collect() };
    let (own, base_facts) = (all(group), all(base));
    let differing = MACHINE.iter().filter_map(|name| {
        let (a, b) = (
            values(name, own.iter()).join("; "),
            values(name, base_facts.iter()).join("; "),
        );
        (a != b).then(|| format!("{name} {a} instead of {b}"))
    });
    let differing: Vec<String> = differing.collect();
    (!differing.is_empty()).then(|| {
        format!(
            "{}: {} of {}: seconds are not those of the same machine and program",
            group.label,
            differing.join(", "),
            base.label
        )
    })
}

/// Median interval between the evaluations of a group.
fn spacing(group: &Group, runs: &[Loaded], clock: Clock) -> Option<f64> {
    let gaps = group.runs.iter().flat_map(|r| {
        let rows = runs[*r].rows.windows(2);
        rows.map(|w| clock.of(&w[1]) - clock.of(&w[0]))
    });
    Some(Spread::of(&gaps.collect::<Vec<_>>())?.median)
}

/// The caveat that a group is evaluated much more or less often than the reference.
fn other_spacing(group: &Group, base: &Group, runs: &[Loaded], clock: Clock) -> Option<String> {
    let (own, other) = (spacing(group, runs, clock)?, spacing(base, runs, clock)?);
    let apart = own.min(other) > 0.0 && own.max(other) > SPACING * own.min(other);
    apart.then(|| {
        format!(
            "{}: evaluations are {own:.1} {} apart, those of {} {other:.1}: times may be late by up to as much",
            group.label,
            clock.name(),
            base.label
        )
    })
}

/// The caveat that runs of a group end below what they had reached.
fn fallen(group: &Group, runs: &[Loaded]) -> Option<String> {
    let falls = group.runs.iter().map(|r| {
        let curve = runs[*r].psnr(Clock::Iterations);
        let best = curve.points().iter().map(|p| p.1).fold(0.0, f64::max);
        best - curve.last().unwrap_or(best)
    });
    let deep: Vec<f64> = falls.filter(|f| *f > FALL).collect();
    let most = deep.iter().copied().fold(0.0, f64::max);
    (!deep.is_empty()).then(|| {
        format!(
            "{}: {} of {} runs end up to {most:.1} dB below their best; a PSNR that they reached first may be lost again",
            group.label,
            deep.len(),
            group.runs.len()
        )
    })
}
