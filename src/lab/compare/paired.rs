//! One group against another, run by run: the one notion of "sooner".
//!
//! Runs of one seed are a pair; groups without a common seed are paired in their order. All figures are told for the
//! reference: a time is that of the other group over that of the reference (above 1: the reference is sooner), a difference
//! is that of the reference less that of the other group. A PSNR that a run has not reached has no time and enters no mean;
//! it still decides which of the two is sooner.

use serde::Serialize;

use crate::lab::compare::curve::Crossing;
use crate::lab::compare::load::Clock;
use crate::lab::compare::outcome::{GroupOutcome, RunOutcome};
use crate::lab::stats::{Spread, geometric_mean};

/// Largest deficit of the reference's final PSNR that still counts as equal, dB.
pub const FINAL_BELOW: f64 = 0.05;

/// Number of cases in which something holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Default)]
pub struct Verdict {
    /// Cases in which it does.
    pub holds: usize,
    /// Cases in which it is known.
    pub of: usize,
}

impl Verdict {
    /// The count over single cases; `None` is one that is not known.
    pub fn count(cases: impl IntoIterator<Item = Option<bool>>) -> Self {
        let mut all = Self::default();
        for case in cases.into_iter().flatten() {
            all.of += 1;
            all.holds += usize::from(case);
        }
        all
    }

    /// True if it holds in all of them; `None` without any.
    #[must_use]
    pub fn all(&self) -> Option<bool> {
        (self.of > 0).then_some(self.holds == self.of)
    }

    /// True if it holds in more than half of them; `None` without any.
    #[must_use]
    pub fn most(&self) -> Option<bool> {
        (self.of > 0).then_some(2 * self.holds > self.of)
    }

    /// `yes, 12 of 12`.
    #[must_use]
    pub fn text(&self) -> String {
        match self.all() {
            None => "–".into(),
            Some(yes) => {
                let word = if yes { "yes" } else { "no" };
                format!("{word}, {} of {}", self.holds, self.of)
            }
        }
    }
}

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

/// Times of one pair to one PSNR.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PairRatio {
    /// Seed of the reference's run.
    pub seed: u64,
    /// Other over reference; `None` unless both reached it after their first evaluation.
    pub ratio: Option<f64>,
    /// True if the reference was no later; a finished run that has not reached a PSNR never does. `None` if not known.
    pub no_later: Option<bool>,
}

/// Times to one PSNR.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PairedTime {
    /// PSNR, dB.
    pub psnr: f64,
    /// Pair by pair.
    pub seeds: Vec<PairRatio>,
    /// Spread of the ratios, if every pair has one.
    pub spread: Option<Spread>,
    /// True if the reference was no later in more than half of the pairs in which that is known.
    pub no_later: Option<bool>,
}

impl PairedTime {
    /// Pairs in which the reference was no later.
    #[must_use]
    pub fn verdict(&self) -> Verdict {
        Verdict::count(self.seeds.iter().map(|s| s.no_later))
    }
}

/// One group against the reference.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Paired {
    /// The group.
    pub label: String,
    /// Seeds of the pairs (of the reference's runs), each once.
    pub seeds: Vec<u64>,
    /// Number of pairs.
    pub pairs: usize,
    /// True if the runs of a pair have the same seed; else they are paired in their order.
    pub same_seeds: bool,
    /// One per threshold.
    pub to_psnr: Vec<PairedTime>,
    /// Number of thresholds that either side reaches with all runs.
    pub counts: Counts,
    /// Geometric mean over the thresholds at which every pair has a ratio, pair by pair.
    pub mean: Option<Spread>,
    /// Number of those thresholds.
    pub mean_of: usize,
    /// Threshold at which the reference does worst, and its median ratio; `None`: it is later or never in most pairs, but not all
    /// have a ratio.
    pub worst: Option<(f64, Option<f64>)>,
    /// Differences of the final PSNR, dB.
    pub psnr: Option<Spread>,
    /// Differences of the final SSIM.
    pub ssim: Option<Spread>,
    /// Differences of the final FLIP.
    pub flip: Option<Spread>,
    /// Gaussians of the reference and of the group.
    pub gaussians: Option<(Spread, Spread)>,
    /// Thresholds at which the reference is no later.
    pub no_later: Verdict,
    /// True if the reference ends no more than [`FINAL_BELOW`] below.
    pub final_holds: Option<bool>,
}

impl Paired {
    /// `3 seeds`, `3 pairs of 1 seed`, or `2 pairs of other seeds`.
    #[must_use]
    pub fn pairs_text(&self) -> String {
        let count = |n: usize, what: &str| match n {
            1 => format!("1 {what}"),
            n => format!("{n} {what}s"),
        };
        let seeds = count(self.seeds.len(), "seed");
        match (self.same_seeds, self.pairs == self.seeds.len()) {
            (true, true) => seeds,
            (true, false) => format!("{} of {seeds}", count(self.pairs, "pair")),
            (false, _) => format!("{} of other seeds", count(self.pairs, "pair")),
        }
    }
}

/// Places of the runs of a pair.
#[derive(Clone, Copy)]
struct Pair {
    own: usize,
    base: usize,
}

/// Every other group against the reference.
#[must_use]
pub fn paired(groups: &[GroupOutcome], reference: usize, clock: Clock) -> Vec<Paired> {
    let others = groups.iter().enumerate().filter(|g| g.0 != reference);
    others
        .map(|(_, group)| against(group, &groups[reference], clock))
        .collect()
}

/// Pairs of one seed, or, if there are none, in the order of the runs; and which of the two.
fn pair_runs(group: &GroupOutcome, base: &GroupOutcome) -> (Vec<Pair>, bool) {
    let mut free: Vec<usize> = (0..group.runs.len()).collect();
    let partner = |(place, run): (usize, &RunOutcome)| {
        let same = |own: &usize| group.runs[*own].seed == run.seed;
        let own = free.iter().position(same).map(|at| free.remove(at))?;
        Some(Pair { own, base: place })
    };
    let pairs: Vec<Pair> = base.runs.iter().enumerate().filter_map(partner).collect();
    if !pairs.is_empty() {
        return (pairs, true);
    }
    let count = group.runs.len().min(base.runs.len());
    let in_order = (0..count).map(|k| Pair { own: k, base: k });
    (in_order.collect(), false)
}

fn against(group: &GroupOutcome, base: &GroupOutcome, clock: Clock) -> Paired {
    let (pairs, same_seeds) = pair_runs(group, base);
    let mut seeds: Vec<u64> = pairs.iter().map(|p| base.runs[p.base].seed).collect();
    seeds.sort_unstable();
    seeds.dedup();
    let mut counts = Counts::default();
    let at = |place| to_psnr(group, base, &pairs, place, clock, &mut counts);
    let to_psnr: Vec<PairedTime> = (0..group.to_psnr.len()).filter_map(at).collect();
    let over = |of: &dyn Fn(&Pair) -> Option<f64>| {
        let all: Option<Vec<f64>> = pairs.iter().map(of).collect();
        Spread::of(&all?)
    };
    let less = |of: &dyn Fn(&RunOutcome) -> Option<f64>| {
        over(&|p| Some(of(&base.runs[p.base])? - of(&group.runs[p.own])?))
    };
    let whole: Vec<&PairedTime> = to_psnr.iter().filter(|t| t.spread.is_some()).collect();
    let psnr = less(&|r| Some(r.psnr));
    let counted = over(&|p| Some(base.runs[p.base].gaussians as f64));
    Paired {
        label: group.label.clone(),
        pairs: pairs.len(),
        same_seeds,
        counts,
        mean: means(&whole, pairs.len()),
        mean_of: whole.len(),
        worst: worst(&to_psnr),
        ssim: less(&|r| r.ssim),
        flip: less(&|r| r.flip),
        gaussians: counted.zip(over(&|p| Some(group.runs[p.own].gaussians as f64))),
        no_later: Verdict::count(to_psnr.iter().map(|t| t.no_later)),
        final_holds: psnr.map(|s| s.median >= -FINAL_BELOW),
        psnr,
        to_psnr,
        seeds,
    }
}

/// Times to one threshold; counts who reaches it with all runs. `None` if a side is not timed by this clock.
fn to_psnr(
    group: &GroupOutcome,
    base: &GroupOutcome,
    pairs: &[Pair],
    place: usize,
    clock: Clock,
    counts: &mut Counts,
) -> Option<PairedTime> {
    let (x, y) = (group.reach(place, clock)?, base.reach(place, clock)?);
    let all = |side: &dyn Fn(&Pair) -> bool| pairs.iter().all(side);
    let own_all = all(&|p| x.runs[p.own].is_some());
    *match (own_all, all(&|p| y.runs[p.base].is_some())) {
        (true, true) => &mut counts.both,
        (false, true) => &mut counts.only_reference,
        (true, false) => &mut counts.only_group,
        (false, false) => &mut counts.neither,
    } += 1;
    let one = |p: &Pair| {
        let own = interval(x.runs[p.own], &group.runs[p.own], clock);
        let reference = interval(y.runs[p.base], &base.runs[p.base], clock);
        let exact = own[0] == own[1] && reference[0] == reference[1];
        let ratio = own[0] / reference[0];
        PairRatio {
            seed: base.runs[p.base].seed,
            ratio: (exact && ratio.is_finite() && ratio > 0.0).then_some(ratio),
            no_later: no_later(reference, own),
        }
    };
    let seeds: Vec<PairRatio> = pairs.iter().map(one).collect();
    let ratios: Option<Vec<f64>> = seeds.iter().map(|s| s.ratio).collect();
    let mut time = PairedTime {
        psnr: group.to_psnr.get(place)?.psnr,
        spread: ratios.and_then(|r| Spread::of_ratios(&r)),
        no_later: None,
        seeds,
    };
    time.no_later = time.verdict().most();
    Some(time)
}

/// The interval in which a run first had a PSNR: a point between two evaluations, before the first evaluation, or after the
/// end of an unfinished run; of a finished one that has not reached it, infinity.
fn interval(found: Option<Crossing>, run: &RunOutcome, clock: Clock) -> [f64; 2] {
    match found {
        Some(c) if c.at_most => [0.0, c.at],
        Some(c) => [c.at; 2],
        None if run.finished => [f64::INFINITY; 2],
        None => [run.last(clock), f64::INFINITY],
    }
}

/// True if the reference is no later than the other; `None` if the intervals leave that open.
fn no_later(reference: [f64; 2], own: [f64; 2]) -> Option<bool> {
    if reference[1].is_finite() && reference[1] <= own[0] {
        return Some(true);
    }
    (own[1].is_finite() && own[1] < reference[0]).then_some(false)
}

/// Geometric means over thresholds at which every pair has a ratio, pair by pair.
fn means(whole: &[&PairedTime], pairs: usize) -> Option<Spread> {
    let of_pair = |k: usize| {
        let ratios: Option<Vec<f64>> = whole.iter().map(|t| t.seeds.get(k)?.ratio).collect();
        geometric_mean(&ratios?)
    };
    let all: Option<Vec<f64>> = (0..pairs).map(of_pair).collect();
    Spread::of_ratios(&all?)
}

/// The first threshold without a ratio at which the reference is later or never; else that of the lowest ratio.
fn worst(times: &[PairedTime]) -> Option<(f64, Option<f64>)> {
    let missed = |t: &&PairedTime| t.spread.is_none() && t.no_later == Some(false);
    if let Some(time) = times.iter().find(missed) {
        return Some((time.psnr, None));
    }
    let ratios = times
        .iter()
        .filter_map(|t| Some((t.psnr, t.spread?.median)));
    let low = ratios.min_by(|a, b| a.1.total_cmp(&b.1));
    low.map(|(psnr, ratio)| (psnr, Some(ratio)))
}
