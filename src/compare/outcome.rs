//! Figures of a group, and ratios of two.

use std::collections::BTreeSet;

use serde::Serialize;

use super::curve::Crossing;
use super::group::{Facts, Group, facts};
use super::load::{Clock, Loaded};
use crate::report::spread::{RATIO_SAMPLES, Ratio, Spread, ratio};

/// Shares of its own final PSNR that a run is timed to.
pub const SHARES: [f64; 2] = [0.95, 0.98];
/// A run that ends so much below its best PSNR, dB, has lost what it had reached.
const FALL: f64 = 0.5;
/// Numbers of Gaussians within this share of each other are equal.
pub const EQUAL: f64 = 0.02;

/// One run.
#[derive(Debug, Clone, Serialize)]
pub struct RunOutcome {
    /// Folder.
    pub path: String,
    /// Seed.
    pub seed: u64,
    /// Whether it came to its end.
    pub finished: bool,
    /// Iterations of the last evaluation.
    pub iterations: u32,
    /// Gaussians at the last evaluation.
    pub gaussians: u64,
    /// Mean PSNR of the last evaluation, dB.
    pub psnr: f64,
    /// Mean SSIM of the last evaluation.
    pub ssim: Option<f64>,
    /// Mean FLIP of the end; none of unfinished runs and of earlier versions.
    pub flip: Option<f64>,
    /// Clocks at the last evaluation.
    pub cpu_seconds: f64,
    /// Seconds of training.
    pub train_seconds: f64,
    /// Seconds since the start.
    pub wall_seconds: f64,
}

/// When the runs of a group first had a PSNR, by one clock.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Reach {
    /// What it is told by.
    pub clock: Clock,
    /// By run; null where it was not reached.
    pub runs: Vec<Option<Crossing>>,
    /// Over the runs, if all of them reached it.
    pub spread: Option<Spread>,
}

impl Reach {
    fn new(clock: Clock, runs: Vec<Option<Crossing>>) -> Self {
        let all: Option<Vec<f64>> = runs.iter().map(|r| r.map(|c| c.at)).collect();
        Self {
            clock,
            spread: all.and_then(|v| Spread::of(&v)),
            runs,
        }
    }

    /// Number of runs that reached it.
    #[must_use]
    pub fn reached(&self) -> usize {
        self.runs.iter().flatten().count()
    }

    /// Whether a run was there at its first evaluation already.
    #[must_use]
    pub fn at_most(&self) -> bool {
        self.runs.iter().flatten().any(|c| c.at_most)
    }
}

/// Times to one PSNR.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Target {
    /// dB.
    pub psnr: f64,
    /// By clock.
    pub reach: Vec<Reach>,
}

/// Times to a share of a run's own final PSNR.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Share {
    /// Share of the final PSNR in dB.
    pub share: f64,
    /// By clock.
    pub reach: Vec<Reach>,
}

/// Samples of one thing.
#[derive(Debug, Clone, Serialize)]
pub struct GroupOutcome {
    /// What sets it apart.
    pub label: String,
    /// Different seeds among its runs.
    pub seeds: usize,
    /// Gaussians at the end.
    pub gaussians: Option<Spread>,
    /// Mean PSNR at the end, dB.
    pub psnr: Option<Spread>,
    /// Mean SSIM at the end.
    pub ssim: Option<Spread>,
    /// Mean FLIP at the end, if all runs have it.
    pub flip: Option<Spread>,
    /// CPU seconds at the end.
    pub cpu_seconds: Option<Spread>,
    /// Training seconds at the end.
    pub train_seconds: Option<Spread>,
    /// Wall seconds at the end.
    pub wall_seconds: Option<Spread>,
    /// Times to equal PSNR.
    pub to_psnr: Vec<Target>,
    /// Times to a share of a run's own final PSNR.
    pub to_share: Vec<Share>,
    /// The runs.
    pub runs: Vec<RunOutcome>,
}

impl GroupOutcome {
    /// Times to the threshold at `place`, by a clock.
    #[must_use]
    pub fn reach(&self, place: usize, clock: Clock) -> Option<&Reach> {
        let target = self.to_psnr.get(place)?;
        target.reach.iter().find(|r| r.clock == clock)
    }
}

/// Time of one group over that of the reference, to one PSNR.
#[derive(Debug, Clone, Serialize)]
pub struct RelativeTime {
    /// dB.
    pub psnr: f64,
    /// Above 1 where the group is later than the reference.
    pub ratio: Option<Ratio>,
    /// Why there is none.
    pub why: Option<String>,
}

/// Times of one group over those of the reference.
#[derive(Debug, Clone, Serialize)]
pub struct Relative {
    /// The group.
    pub label: String,
    /// One per threshold.
    pub to_psnr: Vec<RelativeTime>,
    /// Geometric mean of those that there are.
    pub mean: Option<Ratio>,
    /// Of how many.
    pub mean_of: usize,
}

/// An option, device or version that is not the same everywhere.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Difference {
    /// Its name.
    pub what: String,
    /// By group; several values where the runs of a group differ.
    pub values: Vec<String>,
}

fn of_run(run: &Loaded) -> RunOutcome {
    let last = run.rows.last().copied().unwrap_or_default();
    let scores = run.record.final_scores.as_ref();
    RunOutcome {
        path: run.source.path.display().to_string(),
        seed: run.record.seed,
        finished: run.finished(),
        iterations: last.iteration,
        gaussians: last.gaussians,
        psnr: last.psnr.unwrap_or_default(),
        ssim: last.ssim,
        flip: scores.filter(|_| run.finished()).and_then(|f| f.flip),
        cpu_seconds: last.cpu_seconds,
        train_seconds: last.train_seconds,
        wall_seconds: last.wall_seconds,
    }
}

fn reach(members: &[&Loaded], psnr: impl Fn(&Loaded) -> Option<f64>) -> Vec<Reach> {
    let by = |clock: Clock| {
        let first = |r: &&Loaded| r.psnr(clock).first_reaches(psnr(r)?);
        Reach::new(clock, members.iter().map(first).collect())
    };
    let has = |c: &Clock| *c != Clock::Cpu || members.iter().all(|r| r.has_cpu());
    Clock::ALL.into_iter().filter(has).map(by).collect()
}

/// Figures of a group.
pub fn of_group(group: &Group, runs: &[Loaded], thresholds: &[f64]) -> GroupOutcome {
    let members: Vec<&Loaded> = group.runs.iter().map(|r| &runs[*r]).collect();
    let own: Vec<RunOutcome> = members.iter().map(|r| of_run(r)).collect();
    let spread = |of: &dyn Fn(&RunOutcome) -> Option<f64>| {
        let all: Option<Vec<f64>> = own.iter().map(of).collect();
        all.and_then(|v| Spread::of(&v))
    };
    let seeds: BTreeSet<u64> = own.iter().map(|r| r.seed).collect();
    let share = |share: f64| Share {
        share,
        reach: reach(&members, |r| {
            Some(share * r.psnr(Clock::Iterations).last()?)
        }),
    };
    let target = |psnr: &f64| Target {
        psnr: *psnr,
        reach: reach(&members, |_| Some(*psnr)),
    };
    GroupOutcome {
        label: group.label.clone(),
        seeds: seeds.len(),
        gaussians: spread(&|r| Some(r.gaussians as f64)),
        psnr: spread(&|r| Some(r.psnr)),
        ssim: spread(&|r| r.ssim),
        flip: spread(&|r| r.flip),
        cpu_seconds: spread(&|r| Some(r.cpu_seconds).filter(|s| *s > 0.0)),
        train_seconds: spread(&|r| Some(r.train_seconds)),
        wall_seconds: spread(&|r| Some(r.wall_seconds)),
        to_psnr: thresholds.iter().map(target).collect(),
        to_share: SHARES.map(share).to_vec(),
        runs: own,
    }
}

/// A ratio, or why there is none.
fn ratio_of(
    a: &GroupOutcome,
    b: &GroupOutcome,
    place: usize,
    clock: Clock,
) -> Result<Ratio, String> {
    let missing = || "not told by this clock".to_owned();
    let x = a.reach(place, clock).ok_or_else(missing)?;
    let y = b.reach(place, clock).ok_or_else(missing)?;
    let part = |r: &Reach| match r.reached() {
        0 => "not reached".to_owned(),
        k => format!("{k} of {} runs", r.runs.len()),
    };
    let (Some(p), Some(q)) = (&x.spread, &y.spread) else {
        return Err(match (x.spread, y.spread) {
            (None, None) => "–".into(),
            (None, _) => part(x),
            _ => format!("{}: {}", b.label, part(y)),
        });
    };
    if x.at_most() || y.at_most() {
        return Err("before the first evaluation".into());
    }
    if a.seeds.min(b.seeds) < RATIO_SAMPLES {
        return Err(match a.seeds.min(b.seeds) {
            1 => "from one sample".into(),
            n => format!("from {n} samples"),
        });
    }
    ratio(p, q).ok_or_else(|| "no ratio".into())
}

/// Times of all other groups over those of the reference.
pub fn relative(groups: &[GroupOutcome], reference: usize, clock: Clock) -> Vec<Relative> {
    let base = &groups[reference];
    let others = groups.iter().enumerate().filter(|(i, _)| *i != reference);
    others
        .map(|(_, group)| {
            let times = group.to_psnr.iter().enumerate().map(|(place, target)| {
                let ratio = ratio_of(group, base, place, clock);
                RelativeTime {
                    psnr: target.psnr,
                    ratio: ratio.as_ref().ok().copied(),
                    why: ratio.err(),
                }
            });
            let to_psnr: Vec<RelativeTime> = times.collect();
            let good: Vec<Ratio> = to_psnr.iter().filter_map(|t| t.ratio).collect();
            Relative {
                label: group.label.clone(),
                mean: geometric_mean(&good),
                mean_of: good.len(),
                to_psnr,
            }
        })
        .collect()
}

/// Geometric mean of medians and of the ends of their intervals.
#[must_use]
pub fn geometric_mean(ratios: &[Ratio]) -> Option<Ratio> {
    let mean = |pick: fn(&Ratio) -> f64| {
        let logs = ratios.iter().map(|r| pick(r).ln());
        (logs.sum::<f64>() / ratios.len() as f64).exp()
    };
    (!ratios.is_empty()).then(|| Ratio {
        median: mean(|r| r.median),
        low: mean(|r| r.low),
        high: mean(|r| r.high),
    })
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

/// What differs between groups or within one.
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

/// What the reader has to know of the groups: settings mixed under one name, and unequal numbers of Gaussians.
pub fn remarks(groups: &[Group], runs: &[Loaded], outcomes: &[GroupOutcome]) -> Vec<String> {
    let mut out = Vec::new();
    for group in groups {
        let all: Vec<Facts> = group.runs.iter().map(|r| facts(&runs[*r])).collect();
        let names = all[0].iter().map(|f| f.0.as_str());
        let mixed = names.filter(|n| *n != "max-gaussians" && values(n, all.iter()).len() > 1);
        let mixed: Vec<&str> = mixed.collect();
        if !mixed.is_empty() {
            out.push(format!(
                "{}: its runs differ in more than the seed: {}",
                group.label,
                mixed.join(", ")
            ));
        }
    }
    out.extend(groups.iter().filter_map(|g| fallen(g, runs)));
    if let Some([least, most]) = unequal(outcomes) {
        out.push(format!(
            "not at equal numbers of Gaussians: {} ({}) to {} ({}); --max-gaussians makes them equal",
            least.0, least.1, most.0, most.1
        ));
    }
    out
}

/// The groups with the fewest and the most Gaussians, where those are not equal.
pub fn unequal(outcomes: &[GroupOutcome]) -> Option<[(f64, &str); 2]> {
    let counts = outcomes
        .iter()
        .filter_map(|g| Some((g.gaussians?.median, g.label.as_str())));
    let counts: Vec<_> = counts.collect();
    let least = *counts.iter().min_by(|a, b| a.0.total_cmp(&b.0))?;
    let most = *counts.iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
    (most.0 > least.0 * (1.0 + EQUAL)).then_some([least, most])
}

/// What to know of a group whose runs end below what they had reached.
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
