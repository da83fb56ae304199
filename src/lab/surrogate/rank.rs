//! Rank correlations with bootstrap intervals, and calibration, of one form of birth.

use serde::Serialize;

use crate::base::rng::{Philox, Stream};
use crate::lab::stats::quantile;
use crate::lab::surrogate::births::{Candidate, Draw, FORMS, Phase};

/// Resamples of a bootstrap interval.
const RESAMPLES: u64 = 1000;

/// A statistic and its 95 % interval (percentiles of a bootstrap over the pairs).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Interval {
    /// The statistic of the sample.
    pub value: f64,
    /// 2.5th percentile.
    pub low: f64,
    /// 97.5th percentile.
    pub high: f64,
}

/// Ranks from 1, ties sharing their mean rank. NaN sorts last.
#[must_use]
pub fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|a, b| values[*a].total_cmp(&values[*b]));
    let mut ranks = vec![0.0; values.len()];
    let mut first = 0;
    // 0.0 and −0.0 are one value, which `==` says and the order of sorting does not mind.
    for run in order.chunk_by(|a, b| values[*a] == values[*b]) {
        let shared = first as f64 + (run.len() + 1) as f64 / 2.0;
        run.iter().for_each(|i| ranks[*i] = shared);
        first += run.len();
    }
    ranks
}

/// Pearson's correlation; `None` for fewer than two pairs, or if a side is constant or not finite.
fn pearson(x: &[f64], y: &[f64]) -> Option<f64> {
    let n = x.len() as f64;
    let mean = |v: &[f64]| v.iter().sum::<f64>() / n;
    let (mx, my) = (mean(x), mean(y));
    let (mut xx, mut yy, mut xy) = (0.0, 0.0, 0.0);
    for (a, b) in x.iter().zip(y) {
        xx += (a - mx) * (a - mx);
        yy += (b - my) * (b - my);
        xy += (a - mx) * (b - my);
    }
    let r = xy / (xx * yy).sqrt();
    (x.len() == y.len() && xx > 0.0 && yy > 0.0 && r.is_finite()).then(|| r.clamp(-1.0, 1.0))
}

/// Spearman's ρ: Pearson's correlation of the ranks. `None` if a side is constant, or the lengths differ.
#[must_use]
pub fn spearman(x: &[f64], y: &[f64]) -> Option<f64> {
    pearson(&ranks(x), &ranks(y))
}

/// Kendall's τ_b, which corrects for ties: (concordant − discordant) over the geometric mean of the pairs not tied in x and
/// those not tied in y. `None` if a side is constant, or the lengths differ.
#[must_use]
pub fn kendall(x: &[f64], y: &[f64]) -> Option<f64> {
    if x.len() != y.len() {
        return None;
    }
    // Ranks in place of values: ties are equal, and NaN and signed zeros are no special case any more.
    let (x, y) = (ranks(x), ranks(y));
    let mut pairs: Vec<(f64, f64)> = x.into_iter().zip(y).collect();
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let tied = |runs: &mut dyn Iterator<Item = usize>| runs.map(choose_two).sum::<f64>();
    let all = choose_two(pairs.len());
    let tied_x = tied(&mut pairs.chunk_by(|a, b| a.0 == b.0).map(<[_]>::len));
    let tied_both = tied(&mut pairs.chunk_by(|a, b| a == b).map(<[_]>::len));
    let mut ys: Vec<f64> = pairs.into_iter().map(|p| p.1).collect();
    let swaps = inversions(&mut ys);
    let tied_y = tied(&mut ys.chunk_by(|a, b| a == b).map(<[_]>::len));
    let score = all - tied_x - tied_y + tied_both - 2.0 * swaps;
    let tau = score / ((all - tied_x) * (all - tied_y)).sqrt();
    tau.is_finite().then(|| tau.clamp(-1.0, 1.0))
}

fn choose_two(n: usize) -> f64 {
    n as f64 * (n as f64 - 1.0) / 2.0
}

/// Number of pairs out of order; sorts on the way.
fn inversions(values: &mut [f64]) -> f64 {
    let half = values.len() / 2;
    if half == 0 {
        return 0.0;
    }
    let (left, right) = values.split_at_mut(half);
    let mut count = inversions(left) + inversions(right);
    let mut merged = Vec::with_capacity(left.len() + right.len());
    let (mut l, mut r) = (0, 0);
    while l < left.len() && r < right.len() {
        if right[r] < left[l] {
            count += (left.len() - l) as f64;
            merged.push(right[r]);
            r += 1;
        } else {
            merged.push(left[l]);
            l += 1;
        }
    }
    merged.extend_from_slice(&left[l..]);
    merged.extend_from_slice(&right[r..]);
    values.copy_from_slice(&merged);
    count
}

/// A statistic of paired values with its bootstrap interval: pairs are drawn with replacement, as many as there are; resamples
/// in which the statistic does not exist do not count. `None` if the sample itself has none.
#[must_use]
pub fn with_interval(
    statistic: fn(&[f64], &[f64]) -> Option<f64>,
    x: &[f64],
    y: &[f64],
    seed: u64,
    stream: u64,
) -> Option<Interval> {
    let value = statistic(x, y)?;
    let n = x.len();
    let mut values: Vec<f64> = (0..RESAMPLES)
        .filter_map(|sample| {
            let pick = |k: usize| {
                let at = sample * n as u64 + k as u64;
                ((Philox::uniform_53(seed, stream, at)[0] * n as f64) as usize).min(n - 1)
            };
            let (a, b): (Vec<f64>, Vec<f64>) = (0..n).map(pick).map(|i| (x[i], y[i])).unzip();
            statistic(&a, &b)
        })
        .collect();
    values.sort_by(f64::total_cmp);
    let (low, high) = (quantile(&values, 0.025), quantile(&values, 0.975));
    Some(Interval {
        value,
        low: low.unwrap_or(value),
        high: high.unwrap_or(value),
    })
}

/// Bins of a calibration curve.
const BINS: usize = 10;
/// Random stream of the first bootstrap; one per predictor and subset.
const RESAMPLE: u32 = 30;

/// A predictor of the true gain: name, and value of a candidate in a form.
type Predictor = (&'static str, fn(&Candidate, usize) -> Option<f64>);

/// Predictors in the order of the tables.
const PREDICTORS: [Predictor; 6] = [
    ("importance I", |j, _| Some(j.importance)),
    ("acceptance ρ", |j, _| Some(j.acceptance)),
    ("opacity alone", |j, _| Some(j.opacity)),
    ("1 − SSIM alone", |j, _| j.ssim),
    ("L1 alone", |j, _| j.l1),
    ("probe", |j, form| Some(j.estimate[form])),
];

/// Subset of the candidates: name, and test of membership.
type Subset = (&'static str, fn(&Candidate) -> bool);

const SUBSETS: [Subset; 5] = [
    ("all", |_| true),
    ("proposals", |c| c.draw == Draw::Proposal),
    ("stratified", |c| c.draw == Draw::Stratified),
    ("coarse", |c| c.phase == Phase::Coarse),
    ("fine", |c| c.phase == Phase::Fine),
];

/// Rank correlation of a predictor with the true gain.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Correlation {
    /// Name of the predictor.
    pub predictor: &'static str,
    /// Name of the subset.
    pub subset: &'static str,
    /// Number of candidates that have a value.
    pub count: usize,
    /// Spearman's ρ; `None` if a side is constant.
    pub spearman: Option<Interval>,
    /// Kendall's τ_b.
    pub kendall: Option<Interval>,
    /// Mean gain of the tenth with the highest prediction.
    pub top_gain: Option<f64>,
}

/// The true gain of candidates of similar prediction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Calibration {
    /// Candidates.
    pub count: usize,
    /// Mean of the predictor.
    pub predicted: f64,
    /// Mean gain.
    pub mean: f64,
    /// Quartiles of the gain.
    pub quartiles: [f64; 3],
}

/// Statistics of one form of birth.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FormOutcome {
    /// One of [`FORMS`].
    pub birth: &'static str,
    /// Share of the candidates that lower the loss.
    pub lowering: f64,
    /// Share of those drawn as proposals that lower the loss.
    pub lowering_proposals: f64,
    /// Share of those that are estimated to lower the loss, and of those that are not; `None` of an empty set.
    #[serde(rename = "lowering_by_probe")]
    pub lowering_by_estimate: [Option<f64>; 2],
    /// Mean gain.
    pub mean_gain: f64,
    /// Quartiles of the gain.
    pub quartiles: Option<[f64; 3]>,
    /// Correlations by subset and predictor.
    pub correlations: Vec<Correlation>,
    /// Tenths by importance.
    pub by_importance: Vec<Calibration>,
    /// Tenths by first-order estimate.
    #[serde(rename = "by_probe")]
    pub by_estimate: Vec<Calibration>,
}

pub(super) fn of_form(form: usize, all: &[Candidate], seed: u64) -> FormOutcome {
    let gains: Vec<f64> = all.iter().map(|j| j.gain[form]).collect();
    let share = |keep: &dyn Fn(&Candidate) -> bool| {
        let kept = || all.iter().filter(|j| keep(j));
        let good = kept().filter(|j| j.gain[form] > 0.0).count();
        (kept().count() > 0).then(|| good as f64 / kept().count() as f64)
    };
    let along = |of: &dyn Fn(&Candidate) -> f64| {
        let x: Vec<f64> = all.iter().map(of).collect();
        bins(&x, &gains)
    };
    FormOutcome {
        birth: FORMS[form],
        lowering: share(&|_| true).unwrap_or(0.0),
        lowering_proposals: share(&|j| j.draw == Draw::Proposal).unwrap_or(0.0),
        lowering_by_estimate: [
            share(&|j| j.estimate[form] > 0.0),
            share(&|j| j.estimate[form] <= 0.0),
        ],
        mean_gain: gains.iter().sum::<f64>() / gains.len().max(1) as f64,
        quartiles: quartiles(&gains),
        correlations: correlations(form, all, seed),
        by_importance: along(&|j| j.importance),
        by_estimate: along(&|j| j.estimate[form]),
    }
}

/// Every predictor over every subset.
fn correlations(form: usize, all: &[Candidate], seed: u64) -> Vec<Correlation> {
    let mut correlations = Vec::new();
    for (s, (subset, keep)) in SUBSETS.into_iter().enumerate() {
        for (p, (predictor, value)) in PREDICTORS.into_iter().enumerate() {
            let kept = all.iter().filter(|j| keep(j));
            let pairs = kept.filter_map(|j| Some((value(j, form)?, j.gain[form])));
            let (x, y): (Vec<f64>, Vec<f64>) = pairs.unzip();
            let resamples = RESAMPLE + (s * PREDICTORS.len() + p) as u32;
            let resamples = Stream::Surrogate.stream(resamples);
            correlations.push(Correlation {
                predictor,
                subset,
                count: x.len(),
                spearman: with_interval(spearman, &x, &y, seed, resamples),
                kendall: with_interval(kendall, &x, &y, seed, resamples),
                top_gain: bins(&x, &y).last().map(|b| b.mean),
            });
        }
    }
    correlations
}

fn quartiles(values: &[f64]) -> Option<[f64; 3]> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let at = |share| quantile(&sorted, share);
    Some([at(0.25)?, at(0.5)?, at(0.75)?])
}

/// Bins of (nearly) equal count along a predictor, rising; fewer where there are fewer values.
fn bins(predicted: &[f64], gains: &[f64]) -> Vec<Calibration> {
    let n = predicted.len();
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|a, b| predicted[*a].total_cmp(&predicted[*b]));
    let count = BINS.min(n);
    let bin = |k: usize| {
        let rows = &order[n * k / count..n * (k + 1) / count];
        let mean = |v: &[f64]| rows.iter().map(|i| v[*i]).sum::<f64>() / rows.len() as f64;
        let inside: Vec<f64> = rows.iter().map(|i| gains[*i]).collect();
        Some(Calibration {
            count: rows.len(),
            predicted: mean(predicted),
            mean: mean(gains),
            quartiles: quartiles(&inside)?,
        })
    };
    (0..count).filter_map(bin).collect()
}
