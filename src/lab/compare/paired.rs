//! Two groups seed by seed: for scenes side by side, where the seeds of each are few.
//!
//! All figures are told for the reference: a time is that of the other group over that of the reference (above 1: the reference
//! is sooner), a difference is that of the reference less that of the other group.

use serde::Serialize;

use crate::lab::compare::Comparison;
use crate::lab::compare::load::Clock;
use crate::lab::compare::outcome::{GroupOutcome, RunOutcome};
use crate::lab::compare::relative::{Bound, Bounded, Counts, Limit, common, time};
use crate::lab::stats::{RATIO_SAMPLES, Spread};

/// What the reference may end below the other group, dB.
pub const FINAL_BELOW: f64 = 0.05;

/// A ratio of times of one seed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SeedRatio {
    /// Seed.
    pub seed: u64,
    /// Other over reference; none where neither reached it, or both before their first evaluation.
    pub ratio: Option<Limit>,
    /// Whether the reference was no later; a finished run that has not reached a PSNR never does. None where that is not known.
    pub no_later: Option<bool>,
}

/// Times to one PSNR.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PairedTime {
    /// dB.
    pub psnr: f64,
    /// By seed.
    pub seeds: Vec<SeedRatio>,
    /// Over the seeds with a ratio.
    pub spread: Option<Spread>,
    /// On which side of the median the true one is.
    pub bound: Bound,
    /// Whether the reference was no later, in the median over the seeds.
    pub no_later: Option<bool>,
}

impl PairedTime {
    /// The median and its bound.
    #[must_use]
    pub fn limit(&self) -> Option<Limit> {
        let bound = self.bound;
        self.spread.map(|s| Limit {
            value: s.median,
            bound,
        })
    }
}

/// In how many cases something holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Default)]
pub struct Verdict {
    /// Cases in which it does.
    pub holds: usize,
    /// Cases in which it is known.
    pub of: usize,
}

impl Verdict {
    /// Of single cases.
    pub fn count(cases: impl IntoIterator<Item = Option<bool>>) -> Self {
        let mut all = Self::default();
        for case in cases.into_iter().flatten() {
            all.of += 1;
            all.holds += usize::from(case);
        }
        all
    }

    /// Whether it holds in all of them; none without any.
    #[must_use]
    pub fn all(&self) -> Option<bool> {
        (self.of > 0).then_some(self.holds == self.of)
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

/// One group against the reference.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Paired {
    /// The group.
    pub label: String,
    /// Seeds that both have.
    pub seeds: Vec<u64>,
    /// One per threshold.
    pub to_psnr: Vec<PairedTime>,
    /// How many thresholds which of them reaches, with all seeds.
    pub counts: Counts,
    /// Geometric mean over the thresholds that both reach with all seeds, by seed.
    pub mean: Option<Spread>,
    /// Geometric mean over all thresholds that at least one of them reaches, median over the seeds by threshold.
    pub bounded: Option<Bounded>,
    /// The threshold at which the reference does worst.
    pub worst: Option<(f64, Limit)>,
    /// Final PSNR, dB, differences by seed.
    pub psnr: Option<Spread>,
    /// Final SSIM.
    pub ssim: Option<Spread>,
    /// Final FLIP.
    pub flip: Option<Spread>,
    /// Gaussians of the reference and of the group.
    pub gaussians: Option<(Spread, Spread)>,
    /// Whether the reference is no later, threshold by threshold.
    pub no_later: Verdict,
    /// Whether the reference ends no more than [`FINAL_BELOW`] below.
    pub final_holds: Option<bool>,
}

/// A run of each side, by their places.
struct Pair {
    seed: u64,
    own: usize,
    base: usize,
}

/// All groups against the reference, over the seeds that both have. Groups without such a seed are left out.
#[must_use]
pub fn paired(c: &Comparison) -> Vec<Paired> {
    let reference = c.reference_place();
    let Some(base) = c.groups.get(reference) else {
        return Vec::new();
    };
    let others = c.groups.iter().enumerate().filter(|g| g.0 != reference);
    others
        .filter_map(|(_, g)| against(g, base, c.clock))
        .collect()
}

fn against(group: &GroupOutcome, base: &GroupOutcome, clock: Clock) -> Option<Paired> {
    let seeds = common(group, base);
    let place = |g: &GroupOutcome, seed: u64| g.runs.iter().position(|r| r.seed == seed);
    let pair = |seed: &u64| {
        Some(Pair {
            seed: *seed,
            own: place(group, *seed)?,
            base: place(base, *seed)?,
        })
    };
    let pairs: Vec<Pair> = seeds.iter().filter_map(pair).collect();
    if pairs.is_empty() {
        return None;
    }
    let at = |place: usize| to_psnr(group, base, &pairs, place, clock);
    let (to_psnr, reached): (Vec<PairedTime>, Vec<[bool; 2]>) =
        (0..group.to_psnr.len()).filter_map(at).unzip();
    let mut counts = Counts::default();
    reached.iter().for_each(|r| counts.add(r[0], r[1]));
    let whole = to_psnr.iter().zip(&reached).filter(|(_, r)| r[0] && r[1]);
    let whole: Vec<&PairedTime> = whole.map(|(t, _)| t).collect();
    let limits: Vec<Limit> = to_psnr.iter().filter_map(PairedTime::limit).collect();
    let over = |of: &dyn Fn(&Pair) -> Option<f64>| {
        let all: Option<Vec<f64>> = pairs.iter().map(of).collect();
        Spread::of(&all?)
    };
    let less = |of: &dyn Fn(&RunOutcome) -> Option<f64>| {
        over(&|p| Some(of(&base.runs[p.base])? - of(&group.runs[p.own])?))
    };
    let psnr = less(&|r| Some(r.psnr));
    let counted = over(&|p| Some(base.runs[p.base].gaussians as f64));
    Some(Paired {
        label: group.label.clone(),
        counts,
        mean: means(&whole, pairs.len()),
        bounded: Bounded::of(&limits),
        worst: worst(&to_psnr),
        ssim: less(&|r| r.ssim),
        flip: less(&|r| r.flip),
        gaussians: counted.zip(over(&|p| Some(group.runs[p.own].gaussians as f64))),
        no_later: Verdict::count(to_psnr.iter().map(|t| t.no_later)),
        final_holds: psnr.map(|s| s.median >= -FINAL_BELOW),
        psnr,
        to_psnr,
        seeds,
    })
}

/// Times to one threshold, and whether the group and the reference reach it with all seeds.
fn to_psnr(
    group: &GroupOutcome,
    base: &GroupOutcome,
    pairs: &[Pair],
    place: usize,
    clock: Clock,
) -> Option<(PairedTime, [bool; 2])> {
    let (x, y) = (group.reach(place, clock)?, base.reach(place, clock)?);
    let there = |p: &Pair| [x.runs[p.own].is_some(), y.runs[p.base].is_some()];
    let one = |p: &Pair| {
        let own = time(x, p.own, &group.runs[p.own]);
        let ratio = own.over(time(y, p.base, &base.runs[p.base]));
        let ratio = Some(ratio).filter(Limit::tells);
        SeedRatio {
            seed: p.seed,
            ratio: ratio.filter(|_| there(p) != [false, false]),
            no_later: no_later(there(p), ratio),
        }
    };
    let seeds: Vec<SeedRatio> = pairs.iter().map(one).collect();
    let ratios: Vec<Limit> = seeds.iter().filter_map(|s| s.ratio).collect();
    let values: Vec<f64> = ratios.iter().map(|r| r.value).collect();
    let bound = Limit::median(&ratios).map_or(Bound::Unknown, |l| l.bound);
    let time = PairedTime {
        psnr: group.to_psnr.get(place)?.psnr,
        spread: of_ratios(&values),
        bound,
        no_later: median_holds(&seeds),
        seeds,
    };
    let all = |side: usize| pairs.iter().all(|p| there(p)[side]);
    Some((time, [all(0), all(1)]))
}

/// Whether the reference was no later, from who reached it (group, reference) and the ratio.
fn no_later(there: [bool; 2], ratio: Option<Limit>) -> Option<bool> {
    match there {
        [false, false] => None,
        [false, true] => Some(true),
        [true, false] => Some(false),
        [true, true] => ratio.and_then(|r| match r.bound {
            Bound::Exact => Some(r.value >= 1.0),
            Bound::AtLeast => (r.value >= 1.0).then_some(true),
            Bound::AtMost => (r.value < 1.0).then_some(false),
            Bound::Unknown => None,
        }),
    }
}

/// Whether the median of the ratios is 1 or more, those of a side that has not reached it being as low or as high as can be.
fn median_holds(seeds: &[SeedRatio]) -> Option<bool> {
    let known = seeds.iter().filter_map(|s| {
        let holds = s.no_later?;
        let exact = s.ratio.filter(|r| r.bound == Bound::Exact);
        let far = if holds { 1e9 } else { 1e-9 };
        Some(exact.map_or(far, |r| r.value))
    });
    let mut known: Vec<f64> = known.collect();
    known.sort_by(f64::total_cmp);
    // Of an even number the lower of the middle two: the reference has to hold in more than half of the seeds.
    Some(*known.get(known.len().checked_sub(1)? / 2)? >= 1.0)
}

/// Geometric means over thresholds that all of so many seeds reach, by seed.
fn means(whole: &[&PairedTime], seeds: usize) -> Option<Spread> {
    let of_seed = |k: usize| -> Option<f64> {
        let all = whole.iter().filter_map(|t| t.seeds.get(k)?.ratio);
        let limits: Vec<Limit> = all.filter(|l| l.bound == Bound::Exact).collect();
        Some(Bounded::of(&limits)?.ratio)
    };
    let all: Option<Vec<f64>> = (0..seeds).map(of_seed).collect();
    of_ratios(&all?)
}

/// Median and range of ratios. Between the middle two of an even number lies their geometric mean: which side is below the
/// line must not matter.
fn of_ratios(values: &[f64]) -> Option<Spread> {
    let logs: Vec<f64> = values.iter().map(|v| v.ln()).collect();
    let s = Spread::of(&logs)?;
    Some(Spread {
        median: s.median.exp(),
        min: s.min.exp(),
        max: s.max.exp(),
        ..s
    })
}

/// The lowest ratio; at most that where any is a bound from above.
fn worst(times: &[PairedTime]) -> Option<(f64, Limit)> {
    let all = times.iter().filter_map(|t| Some((t.psnr, t.limit()?)));
    let all: Vec<(f64, Limit)> = all.collect();
    let low = all
        .iter()
        .min_by(|a, b| a.1.value.total_cmp(&b.1.value))
        .copied();
    let open = |l: &Limit| matches!(l.bound, Bound::AtMost | Bound::Unknown);
    let open = all.iter().any(|(_, l)| open(l));
    low.map(|(psnr, limit)| {
        let bound = if open { Bound::AtMost } else { limit.bound };
        (psnr, Limit { bound, ..limit })
    })
}

/// `median (min–max)` by `text`; the median alone of fewer than three seeds.
#[must_use]
pub fn few(s: &Spread, text: impl Fn(f64) -> String) -> String {
    match s.samples < RATIO_SAMPLES {
        true => text(s.median),
        false => format!("{} ({}–{})", text(s.median), text(s.min), text(s.max)),
    }
}
