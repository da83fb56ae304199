//! Grouping: runs that differ in nothing but the seed are samples of one setting.

use std::collections::BTreeSet;

use crate::lab::compare::load::Loaded;
use crate::run::report::settings::flatten;

/// Options that change no result, or only by chance.
const BESIDE: [&str; 5] = [
    "seed",
    "eval-every",
    "export-every",
    "checkpoint-every",
    "image-budget",
];
/// Option that may change along with the seed, as it does if it is another run's final count.
const CAP: &str = "max-gaussians";
/// Largest ratio of the caps of one setting.
const CAP_RATIO: f64 = 1.5;

/// Options, device and version of a run: name and value.
pub type Facts = Vec<(String, String)>;

/// Everything that may tell two groups apart.
#[must_use]
pub fn facts(run: &Loaded) -> Facts {
    let r = &run.record;
    let mut facts: Facts = flatten(&r.config)
        .into_iter()
        .filter(|(name, _)| !BESIDE.contains(&name.as_str()))
        .collect();
    let d = &r.device;
    let own = [
        ("device", &d.name),
        ("platform", &d.platform),
        ("driver", &d.driver),
        ("version", &r.version),
        ("commit", &r.commit),
    ];
    facts.extend(own.map(|(name, value)| (name.to_owned(), value.clone())));
    facts
}

/// Runs of one kind, by their places in the list.
#[derive(Debug, Clone, PartialEq)]
pub struct Group {
    /// Name, or the options that set it apart from the others.
    pub label: String,
    /// Places of its runs.
    pub runs: Vec<usize>,
}

fn without_cap(facts: &Facts) -> Facts {
    let other = |f: &&(String, String)| f.0 != CAP;
    facts.iter().filter(other).cloned().collect()
}

/// Returns true if caps that change along with the seeds are one setting: one cap per seed, and all of a size.
fn one_cap_per_seed(runs: &[&Loaded]) -> bool {
    let seeds: BTreeSet<u64> = runs.iter().map(|r| r.record.seed).collect();
    let caps: Option<Vec<usize>> = runs.iter().map(|r| r.record.config.max_gaussians).collect();
    let Some(caps) = caps else {
        return false;
    };
    let (low, high) = (caps.iter().min(), caps.iter().max());
    let ratio = low.zip(high).map(|(l, h)| *h as f64 / *l as f64);
    seeds.len() == runs.len() && ratio.is_some_and(|r| r <= CAP_RATIO)
}

/// Sorts runs into groups, in the order of their first runs: by the names that were given, else by their options.
#[must_use]
pub fn group(runs: &[Loaded]) -> Vec<Group> {
    let facts: Vec<Facts> = runs.iter().map(facts).collect();
    // Key of a group, and whether the key is a name that was given.
    let mut kinds: Vec<(Result<&str, Facts>, Vec<usize>)> = Vec::new();
    for (place, run) in runs.iter().enumerate() {
        let key = match &run.source.group {
            Some(name) => Ok(name.as_str()),
            None => Err(without_cap(&facts[place])),
        };
        match kinds.iter_mut().find(|(k, _)| *k == key) {
            Some((_, places)) => places.push(place),
            None => kinds.push((key, vec![place])),
        }
    }
    let mut groups = Vec::new();
    for (key, places) in kinds {
        let members: Vec<&Loaded> = places.iter().map(|p| &runs[*p]).collect();
        match key {
            Ok(name) => groups.push((Some(name.to_owned()), places)),
            Err(_) if one_cap_per_seed(&members) => groups.push((None, places)),
            Err(_) => groups.extend(by_cap(&members, &places).into_iter().map(|g| (None, g))),
        }
    }
    groups.sort_by_key(|(_, places)| places.first().copied());
    label(groups, runs, &facts)
}

/// The runs, split by their cap.
fn by_cap(members: &[&Loaded], places: &[usize]) -> Vec<Vec<usize>> {
    let mut kinds: Vec<(Option<usize>, Vec<usize>)> = Vec::new();
    for (run, place) in members.iter().zip(places) {
        let cap = run.record.config.max_gaussians;
        match kinds.iter_mut().find(|(c, _)| *c == cap) {
            Some((_, list)) => list.push(*place),
            None => kinds.push((cap, vec![*place])),
        }
    }
    kinds.into_iter().map(|(_, list)| list).collect()
}

/// Names unnamed groups by their sampler and, if that does not tell them apart, by the options that do; by the cap only if
/// nothing else does.
fn label(
    groups: Vec<(Option<String>, Vec<usize>)>,
    runs: &[Loaded],
    facts: &[Facts],
) -> Vec<Group> {
    let of = |place: usize, name: &str| -> &str {
        let found = facts[place].iter().find(|f| f.0 == name);
        found.map_or("none", |f| f.1.as_str())
    };
    let first = |places: &[usize]| places.first().copied().unwrap_or(0);
    let unnamed = groups.iter().filter(|g| g.0.is_none());
    let unnamed: Vec<usize> = unnamed.map(|g| first(&g.1)).collect();
    let own = |place: usize| -> String {
        let sampler = of(place, "sampler");
        let alike = unnamed.iter().filter(|p| of(**p, "sampler") == sampler);
        let alike: Vec<usize> = alike.copied().collect();
        let names = facts[place].iter().map(|f| f.0.as_str());
        let mut differing: Vec<&str> = names
            .filter(|n| alike.iter().any(|p| of(*p, n) != of(place, n)))
            .collect();
        if differing.len() > 1 {
            differing.retain(|n| *n != CAP);
        }
        let more = differing.iter().map(|n| format!("{n} {}", of(place, n)));
        let parts: Vec<String> = std::iter::once(sampler.to_owned()).chain(more).collect();
        parts.join(", ")
    };
    let mut out: Vec<Group> = Vec::new();
    for (name, places) in groups {
        let place = first(&places);
        let mut label = name.unwrap_or_else(|| own(place));
        if out.iter().any(|g| g.label == label) {
            label = format!("{label}, {}", runs[place].source.path.display());
        }
        out.push(Group {
            label,
            runs: places,
        });
    }
    out
}
