//! One group against another, run by run: the one notion of "sooner".
//!
//! Runs of one seed are a pair. All figures are told for the reference: a time is that of the other group over that of the
//! reference (above 1: the reference is sooner), a difference is that of the reference less that of the other group. A PSNR
//! that a run has not reached, or had at its first evaluation, has no time and enters no ratio; how many runs reach it is told
//! beside the ratios.

use std::collections::BTreeSet;

use serde::Serialize;

use crate::lab::compare::curve::Crossing;
use crate::lab::compare::group::{Group, Spreads, Target, spreads};
use crate::lab::compare::load::{Clock, Loaded};
use crate::lab::stats::{Spread, geometric_mean};

/// Number of thresholds that all runs of one side or of both reach.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Default)]
pub struct Counts {
    /// Both.
    pub both: usize,
    /// The reference alone.
    pub only_reference: usize,
    /// The group alone.
    pub only_group: usize,
    /// Neither.
    pub neither: usize,
}

impl Counts {
    /// Adds those of another scene.
    pub fn join(&mut self, other: &Self) {
        self.both += other.both;
        self.only_reference += other.only_reference;
        self.only_group += other.only_group;
        self.neither += other.neither;
    }

    /// `both 7, only mh 2, only mcmc 0, neither 1`.
    #[must_use]
    pub fn text(&self, reference: &str, group: &str) -> String {
        format!(
            "both {}, only {reference} {}, only {group} {}, neither {}",
            self.both, self.only_reference, self.only_group, self.neither
        )
    }
}

/// Times to one PSNR.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PairedTime {
    /// PSNR, dB.
    pub psnr: f64,
    /// Time of the other over that of the reference, pair by pair; `None` unless both reached it after their first evaluation.
    pub ratios: Vec<Option<f64>>,
    /// Spread of the ratios, if every pair has one.
    pub spread: Option<Spread>,
    /// Number of the pairs' runs that reached it: of the reference and of the group.
    pub reached: [usize; 2],
}

/// One group against the reference.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Paired {
    /// The group.
    pub label: String,
    /// Seed of each pair.
    pub seeds: Vec<u64>,
    /// One per threshold.
    pub to_psnr: Vec<PairedTime>,
    /// Number of thresholds that either side reaches with all runs.
    pub counts: Counts,
    /// Geometric mean over the thresholds at which every pair has a ratio, pair by pair.
    pub mean: Option<Spread>,
    /// Number of those thresholds.
    pub mean_of: usize,
    /// Number of those at which the median ratio is 1 or more.
    pub no_later: usize,
    /// The one of those at which the reference does worst, and its median ratio.
    pub worst: Option<(f64, f64)>,
    /// Final PSNR of the reference less that of the other, pair by pair, dB; empty unless every run has one.
    pub psnr_changes: Vec<f64>,
    /// Final number of Gaussians of the other over that of the reference, pair by pair.
    pub gaussians_ratios: Vec<f64>,
    /// Differences at the end, by the keys of `FIGURES`.
    #[serde(flatten)]
    pub change: Spreads,
}

impl Paired {
    /// `3 seeds`, or `3 pairs of 1 seed`.
    #[must_use]
    pub fn pairs_text(&self) -> String {
        let count = |n: usize, what: &str| format!("{n} {what}{}", if n == 1 { "" } else { "s" });
        let seeds = self.seeds.iter().collect::<BTreeSet<_>>().len();
        match self.seeds.len() {
            pairs if pairs == seeds => count(seeds, "seed"),
            pairs => format!("{} of {}", count(pairs, "pair"), count(seeds, "seed")),
        }
    }
}

/// Every other group that has a seed in common with the reference, against it.
#[must_use]
pub fn paired(groups: &[Group], base: &Group, clock: Clock) -> Vec<Paired> {
    let others = groups.iter().filter(|g| g.label != base.label);
    others.filter_map(|g| against(g, base, clock)).collect()
}

/// Places of the runs of one seed, in the group and in the reference.
fn pairs(group: &Group, base: &Group) -> Vec<(usize, usize)> {
    let mut free: Vec<usize> = (0..group.runs.len()).collect();
    let partner = |(place, run): (usize, &Loaded)| {
        let same = |own: &usize| group.runs[*own].seed == run.seed;
        let found = free.iter().position(same)?;
        Some((free.remove(found), place))
    };
    base.runs.iter().enumerate().filter_map(partner).collect()
}

fn against(group: &Group, base: &Group, clock: Clock) -> Option<Paired> {
    let pairs = pairs(group, base);
    if pairs.is_empty() {
        return None;
    }
    let mut counts = Counts::default();
    let time = |(place, target): (usize, &Target)| {
        let (x, y) = (group.reach(place, clock)?, base.reach(place, clock)?);
        let one = |(own, other): &(usize, usize)| [y.runs[*other], x.runs[*own]];
        let found: Vec<[Option<Crossing>; 2]> = pairs.iter().map(one).collect();
        let reached = [0, 1].map(|side| found.iter().filter(|f| f[side].is_some()).count());
        *match reached.map(|n| n == pairs.len()) {
            [true, true] => &mut counts.both,
            [true, false] => &mut counts.only_reference,
            [false, true] => &mut counts.only_group,
            [false, false] => &mut counts.neither,
        } += 1;
        let ratio = |[reference, own]: &[Option<Crossing>; 2]| {
            let exact = own
                .zip(*reference)
                .filter(|(a, b)| !a.at_most && !b.at_most);
            let ratio = exact.map(|(a, b)| a.at / b.at);
            ratio.filter(|r| r.is_finite() && *r > 0.0)
        };
        let ratios: Vec<Option<f64>> = found.iter().map(ratio).collect();
        let all: Option<Vec<f64>> = ratios.iter().copied().collect();
        Some(PairedTime {
            psnr: target.psnr,
            spread: all.and_then(|r| Spread::of_ratios(&r)),
            ratios,
            reached,
        })
    };
    let targets = group.to_psnr.iter().enumerate();
    let to_psnr: Vec<PairedTime> = targets.filter_map(time).collect();
    let whole = || to_psnr.iter().filter_map(|t| Some((t, t.spread?.median)));
    let mean = |pair: usize| {
        let ratios: Option<Vec<f64>> = whole().map(|(t, _)| t.ratios[pair]).collect();
        geometric_mean(&ratios?)
    };
    let means: Option<Vec<f64>> = (0..pairs.len()).map(mean).collect();
    let worst = whole().min_by(|a, b| a.1.total_cmp(&b.1));
    let change = |of: fn(&Loaded) -> Option<f64>| -> Option<Vec<f64>> {
        let pairs = pairs.iter();
        pairs
            .map(|p| Some(of(&base.runs[p.1])? - of(&group.runs[p.0])?))
            .collect()
    };
    let count = |run: &Loaded| run.last.gaussians as f64;
    let gaussians = |p: &(usize, usize)| count(&group.runs[p.0]) / count(&base.runs[p.1]);
    Some(Paired {
        label: group.label.clone(),
        seeds: pairs.iter().map(|p| base.runs[p.1].seed).collect(),
        counts,
        mean: means.and_then(|m| Spread::of_ratios(&m)),
        mean_of: whole().count(),
        no_later: whole().filter(|(_, ratio)| *ratio >= 1.0).count(),
        worst: worst.map(|(t, ratio)| (t.psnr, ratio)),
        psnr_changes: change(|run| run.last.psnr).unwrap_or_default(),
        gaussians_ratios: pairs.iter().map(gaussians).collect(),
        change: spreads(change),
        to_psnr,
    })
}
