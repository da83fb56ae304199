//! Times of one group over those of another: ratios, bounds, means, and of how many thresholds they are.

use serde::Serialize;

use crate::lab::compare::load::Clock;
use crate::lab::compare::outcome::{GroupOutcome, Reach, RunOutcome};
use crate::lab::stats::{RATIO_SAMPLES, Ratio, Spread, ratio};

/// On which side of a figure the true one is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Bound {
    /// It is the figure itself.
    Exact,
    /// The figure or above.
    AtLeast,
    /// The figure or below.
    AtMost,
    /// Not known.
    Unknown,
}

impl Bound {
    /// Of a product of two such figures, or of their mean.
    pub(super) fn and(self, other: Self) -> Self {
        match (self, other) {
            (a, b) if a == b => a,
            (Self::Exact, b) => b,
            (a, Self::Exact) => a,
            _ => Self::Unknown,
        }
    }

    /// Of the inverse.
    fn inverse(self) -> Self {
        match self {
            Self::AtLeast => Self::AtMost,
            Self::AtMost => Self::AtLeast,
            same => same,
        }
    }

    /// To be written before the figure.
    #[must_use]
    pub fn sign(self) -> &'static str {
        match self {
            Self::Exact => "",
            Self::AtLeast => "≥ ",
            Self::AtMost => "≤ ",
            Self::Unknown => "≈ ",
        }
    }
}

/// A figure, or a bound of it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Limit {
    /// The figure.
    pub value: f64,
    /// On which side of it the true one is.
    pub bound: Bound,
}

impl Limit {
    /// This over another, positive one.
    pub(super) fn over(self, other: Self) -> Self {
        Self {
            value: self.value / other.value,
            bound: self.bound.and(other.bound.inverse()),
        }
    }

    /// Median of several: a bound where any of them is one.
    pub(super) fn median(all: &[Self]) -> Option<Self> {
        let values: Vec<f64> = all.iter().map(|l| l.value).collect();
        let bound = all.iter().fold(Bound::Exact, |b, l| b.and(l.bound));
        let value = Spread::of(&values)?.median;
        Some(Self { value, bound })
    }

    /// Whether it tells anything, as a factor of a mean.
    pub(super) fn tells(&self) -> bool {
        self.bound != Bound::Unknown && self.value.is_finite() && self.value > 0.0
    }
}

/// When a run had a PSNR: the last reading of its clock, or later, where it never had it.
pub(super) fn time(reach: &Reach, place: usize, run: &RunOutcome) -> Limit {
    match reach.runs.get(place).copied().flatten() {
        Some(c) if c.at_most => Limit {
            value: c.at,
            bound: Bound::AtMost,
        },
        Some(c) => Limit {
            value: c.at,
            bound: Bound::Exact,
        },
        None => Limit {
            value: run.last(reach.clock),
            bound: Bound::AtLeast,
        },
    }
}

/// How many thresholds all runs of one side or of both reach.
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
    /// Counts one more threshold.
    pub(super) fn add(&mut self, group: bool, reference: bool) {
        *match (group, reference) {
            (true, true) => &mut self.both,
            (false, true) => &mut self.only_reference,
            (true, false) => &mut self.only_group,
            (false, false) => &mut self.neither,
        } += 1;
    }

    /// Counts those of another scene, too.
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

/// Geometric mean of figures some of which are bounds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Bounded {
    /// The mean.
    pub ratio: f64,
    /// Of how many.
    pub of: usize,
    /// How many of them may be higher.
    pub at_least: usize,
    /// How many of them may be lower.
    pub at_most: usize,
}

impl Bounded {
    /// Of positive figures; one whose bound is not known may be either. None without any.
    #[must_use]
    pub fn of(limits: &[Limit]) -> Option<Self> {
        let one = |l: &Limit| Self {
            ratio: l.value,
            of: 1,
            at_least: usize::from(matches!(l.bound, Bound::AtLeast | Bound::Unknown)),
            at_most: usize::from(matches!(l.bound, Bound::AtMost | Bound::Unknown)),
        };
        Self::mean(&limits.iter().map(one).collect::<Vec<_>>())
    }

    /// Mean of means, each counting as one.
    #[must_use]
    pub fn mean(all: &[Self]) -> Option<Self> {
        let good = all.iter().filter(|b| b.ratio.is_finite() && b.ratio > 0.0);
        let good: Vec<&Self> = good.collect();
        let logs: f64 = good.iter().map(|b| b.ratio.ln()).sum();
        (!good.is_empty()).then(|| Self {
            ratio: (logs / good.len() as f64).exp(),
            of: good.len(),
            at_least: good.iter().filter(|b| b.at_least > 0).count(),
            at_most: good.iter().filter(|b| b.at_most > 0).count(),
        })
    }

    /// As a figure, a bound where what it is of are bounds of one side.
    #[must_use]
    pub fn limit(&self) -> Limit {
        let bound = match (self.at_least, self.at_most) {
            (0, 0) => Bound::Exact,
            (_, 0) => Bound::AtLeast,
            (0, _) => Bound::AtMost,
            _ => Bound::Unknown,
        };
        Limit {
            value: self.ratio,
            bound,
        }
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
    /// The ratio of the medians, with the last clock reading of a run as the least time to what it has not reached; none of
    /// fewer than three samples.
    pub limit: Option<Limit>,
}

/// Times of one group over those of the reference.
#[derive(Debug, Clone, Serialize)]
pub struct Relative {
    /// The group.
    pub label: String,
    /// One per threshold.
    pub to_psnr: Vec<RelativeTime>,
    /// Geometric mean of those ratios that there are.
    pub mean: Option<Ratio>,
    /// Of how many.
    pub mean_of: usize,
    /// What the others are.
    pub counts: Counts,
    /// Geometric mean of the limits.
    pub bounded: Option<Bounded>,
}

/// Runs of a group, by their places.
struct Side<'a> {
    group: &'a GroupOutcome,
    places: Vec<usize>,
    seeds: usize,
}

impl Side<'_> {
    /// The reach of its runs alone.
    fn reach(&self, place: usize, clock: Clock) -> Option<Reach> {
        let all = self.group.reach(place, clock)?;
        let own = self.places.iter().map(|p| all.runs[*p]);
        Some(Reach::new(clock, own.collect()))
    }

    fn limit(&self, place: usize, clock: Clock) -> Option<Limit> {
        let all = self.group.reach(place, clock)?;
        let own = self.places.iter();
        let times = own.map(|p| time(all, *p, &self.group.runs[*p]));
        Limit::median(&times.collect::<Vec<_>>())
    }
}

/// Seeds that two groups share.
pub(super) fn common(a: &GroupOutcome, b: &GroupOutcome) -> Vec<u64> {
    let in_b = |seed: &u64| b.runs.iter().any(|r| r.seed == *seed);
    let mut seeds: Vec<u64> = a.runs.iter().map(|r| r.seed).filter(in_b).collect();
    seeds.sort_unstable();
    seeds.dedup();
    seeds
}

/// Runs of the seeds that both groups have, where these are enough for a ratio; else all.
fn sides<'a>(a: &'a GroupOutcome, b: &'a GroupOutcome) -> [Side<'a>; 2] {
    let seeds = common(a, b);
    let enough = seeds.len() >= RATIO_SAMPLES;
    [a, b].map(|group| {
        let kept = |p: &usize| !enough || seeds.contains(&group.runs[*p].seed);
        Side {
            group,
            places: (0..group.runs.len()).filter(kept).collect(),
            seeds: if enough { seeds.len() } else { group.seeds },
        }
    })
}

/// A ratio, or why there is none.
fn ratio_of(a: &Side, b: &Side, place: usize, clock: Clock) -> Result<Ratio, String> {
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
            (None, _) => part(&x),
            _ => format!("{}: {}", b.group.label, part(&y)),
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
        .map(|(_, group)| against(group, base, clock))
        .collect()
}

fn against(group: &GroupOutcome, base: &GroupOutcome, clock: Clock) -> Relative {
    let [own, base] = sides(group, base);
    let enough = own.seeds.min(base.seeds) >= RATIO_SAMPLES;
    let mut counts = Counts::default();
    let times = group.to_psnr.iter().enumerate().map(|(place, target)| {
        let whole = |s: &Side| s.reach(place, clock).is_some_and(|r| r.spread.is_some());
        counts.add(whole(&own), whole(&base));
        let ratio = ratio_of(&own, &base, place, clock);
        let limits = own.limit(place, clock).zip(base.limit(place, clock));
        let limit = limits.map(|(a, b)| a.over(b));
        RelativeTime {
            psnr: target.psnr,
            ratio: ratio.as_ref().ok().copied(),
            why: ratio.err(),
            limit: limit.filter(|l| enough && l.tells()),
        }
    });
    let to_psnr: Vec<RelativeTime> = times.collect();
    let good: Vec<Ratio> = to_psnr.iter().filter_map(|t| t.ratio).collect();
    let limits: Vec<Limit> = to_psnr.iter().filter_map(|t| t.limit).collect();
    Relative {
        label: group.label.clone(),
        mean: geometric_mean(&good),
        mean_of: good.len(),
        counts,
        bounded: Bounded::of(&limits),
        to_psnr,
    }
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
