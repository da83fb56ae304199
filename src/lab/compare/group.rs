//! Groups: runs that differ in nothing but the seed are samples of one setting.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::lab::compare::curve::Crossing;
use crate::lab::compare::load::{Clock, Fact, Loaded};
use crate::lab::stats::Spread;

/// Times at which the runs of a group first had a PSNR, by one clock.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Reach {
    /// Clock of the times.
    pub clock: Clock,
    /// Run by run; null if it was not reached.
    pub runs: Vec<Option<Crossing>>,
    /// Spread over the runs, if all of them reached it.
    pub spread: Option<Spread>,
}

impl Reach {
    /// Number of runs that reached it.
    #[must_use]
    pub fn reached(&self) -> usize {
        self.runs.iter().flatten().count()
    }

    /// Returns true if a run was there at its first evaluation already.
    #[must_use]
    pub fn at_most(&self) -> bool {
        self.runs.iter().flatten().any(|c| c.at_most)
    }
}

/// Times to one PSNR.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Target {
    /// PSNR, dB.
    pub psnr: f64,
    /// Clock by clock.
    pub reach: Vec<Reach>,
}

/// A figure of a run at its last evaluation: key in JSON, column name, decimals in tables (`None`: three digits), and the value.
pub type Figure = (
    &'static str,
    &'static str,
    Option<usize>,
    fn(&Loaded) -> Option<f64>,
);

/// Figures of every run, in the order of the tables.
pub const FIGURES: [Figure; 7] = [
    ("gaussians", "Gaussians", Some(0), |r| {
        Some(r.last.gaussians as f64)
    }),
    ("psnr", "PSNR, dB", Some(2), |r| r.last.psnr),
    ("ssim", "SSIM", Some(4), |r| r.last.ssim),
    ("flip", "FLIP", Some(4), |r| r.flip),
    ("cpu_seconds", "CPU s", None, |r| {
        Some(r.last.cpu_seconds).filter(|s| *s > 0.0)
    }),
    ("train_seconds", "training s", None, |r| {
        Some(r.last.train_seconds)
    }),
    ("wall_seconds", "wall s", None, |r| {
        Some(r.last.wall_seconds)
    }),
];

/// Spreads of [`FIGURES`] by their keys.
pub type Spreads = BTreeMap<&'static str, Spread>;

/// Spreads of every figure of which `samples` are known and finite.
pub fn spreads(samples: impl Fn(fn(&Loaded) -> Option<f64>) -> Option<Vec<f64>>) -> Spreads {
    let all = FIGURES.iter();
    all.filter_map(|(key, _, _, of)| Some((*key, Spread::of(&samples(*of)?)?)))
        .collect()
}

/// Samples of one setting.
#[derive(Debug, Clone, Serialize)]
pub struct Group {
    /// Name, or the options that set it apart from the others.
    pub label: String,
    /// Spreads at the end, by the keys of `FIGURES`; those that all runs have.
    #[serde(flatten)]
    pub end: Spreads,
    /// Times to equal PSNR, threshold by threshold.
    pub to_psnr: Vec<Target>,
    /// The runs, in their order.
    pub runs: Vec<Loaded>,
}

impl Group {
    /// Times to a PSNR by every clock that all runs have.
    pub(super) fn target(&self, psnr: f64) -> Target {
        let reach = |clock: Clock| {
            let first = |r: &Loaded| r.curve(clock, |row| row.psnr).first_reaches(psnr);
            let runs: Vec<Option<Crossing>> = self.runs.iter().map(first).collect();
            let all: Option<Vec<f64>> = runs.iter().map(|r| r.map(|c| c.at)).collect();
            Reach {
                clock,
                spread: all.and_then(|v| Spread::of(&v)),
                runs,
            }
        };
        let has = |clock: &Clock| self.runs.iter().all(|r| r.has(*clock));
        Target {
            psnr,
            reach: Clock::all().filter(has).map(reach).collect(),
        }
    }

    /// Times to the threshold at `place`, by a clock.
    #[must_use]
    pub fn reach(&self, place: usize, clock: Clock) -> Option<&Reach> {
        let target = self.to_psnr.get(place)?;
        target.reach.iter().find(|r| r.clock == clock)
    }
}

/// Sorts runs into groups, in the order of their first runs: by the names that were given, else by their options. Unnamed groups
/// are named by their sampler and, if that does not tell them apart, by the options that do.
#[must_use]
pub fn group(runs: Vec<Loaded>) -> Vec<Group> {
    let mut parts: Vec<Vec<Loaded>> = Vec::new();
    for run in runs {
        let alike = |part: &&mut Vec<Loaded>| match &run.group {
            None => part[0].group.is_none() && part[0].setting() == run.setting(),
            named => part[0].group == *named,
        };
        match parts.iter_mut().find(alike) {
            Some(part) => part.push(run),
            None => parts.push(vec![run]),
        }
    }
    let name = |part: &Vec<Loaded>| -> String {
        let run = &part[0];
        let sampler = run.fact("sampler");
        let firsts = parts.iter().map(|part| &part[0]);
        let alike = firsts.filter(|r| r.group.is_none() && r.fact("sampler") == sampler);
        let alike: Vec<&Loaded> = alike.collect();
        let differs = |f: &&Fact| alike.iter().any(|r| r.fact(&f.0) != f.1);
        let differing = run.setting().iter().filter(differs);
        let more = differing.map(|(name, value)| format!(", {name} {value}"));
        let own = || sampler.to_owned() + &more.collect::<String>();
        run.group.clone().unwrap_or_else(own)
    };
    let names: Vec<String> = parts.iter().map(name).collect();
    let mut out: Vec<Group> = Vec::new();
    for (part, mut label) in parts.into_iter().zip(names) {
        if out.iter().any(|g| g.label == label) {
            label = format!("{label}, {}", part[0].path);
        }
        out.push(Group {
            label,
            end: spreads(|of| part.iter().map(of).collect()),
            to_psnr: Vec::new(),
            runs: part,
        });
    }
    out
}
