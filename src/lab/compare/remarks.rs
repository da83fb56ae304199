//! Caveats of a comparison, and the differences between its groups.

use serde::Serialize;

use crate::chart::text::fixed;
use crate::lab::compare::group::Group;
use crate::lab::compare::load::{Clock, Loaded};

/// Relative difference up to which numbers of Gaussians count as equal.
const EQUAL: f64 = 0.02;
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
pub fn differences(groups: &[Group]) -> Vec<Difference> {
    let names = groups[0].runs[0].facts.iter().map(|f| f.0.as_str());
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
    names.filter(shown).map(row).collect()
}

/// Caveats of the groups: settings mixed under one name, and inequalities between them.
pub fn remarks(groups: &[Group], base: &Group, clock: Clock) -> Vec<String> {
    let mut out: Vec<String> = groups.iter().filter_map(mixed).collect();
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
    out.extend(groups.iter().filter_map(|g| other_seeds(g, base)));
    if clock != Clock::Iterations {
        out.extend(groups.iter().filter_map(|g| other_machine(g, base)));
    }
    out
}

/// The caveat that settings are mixed under one name.
fn mixed(group: &Group) -> Option<String> {
    let names = group.runs[0].setting().iter().map(|f| f.0.as_str());
    let mixed = names.filter(|n| *n != "max-gaussians" && values(n, &group.runs).len() > 1);
    let mixed = mixed.collect::<Vec<_>>().join(", ");
    let label = &group.label;
    (!mixed.is_empty()).then(|| format!("{label}: its runs differ in more than the seed: {mixed}"))
}

/// The caveat that the seeds of a group are not those of the reference.
fn other_seeds(group: &Group, base: &Group) -> Option<String> {
    let [own, all] = [group, base].map(|g| {
        let mut seeds = values("seed", &g.runs);
        seeds.sort_unstable();
        seeds.join(", ")
    });
    let (label, reference) = (&group.label, &base.label);
    (own != all).then(|| {
        format!("{label}: seeds {own}, but {all} of {reference}; only those of both are compared")
    })
}

/// The caveat that a group was trained on another device, or by another version, than the reference.
fn other_machine(group: &Group, base: &Group) -> Option<String> {
    let differing = MACHINE.iter().filter_map(|name| {
        let [own, other] = [group, base].map(|g| values(name, &g.runs).join("; "));
        (own != other).then(|| format!("{name} {own} instead of {other}"))
    });
    let differing = differing.collect::<Vec<_>>().join(", ");
    let (label, reference) = (&group.label, &base.label);
    (!differing.is_empty()).then(|| {
        format!(
            "{label}: {differing} of {reference}: seconds are not those of the same machine and program"
        )
    })
}
