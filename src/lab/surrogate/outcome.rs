//! Correlations and calibration of one form of birth.

use serde::Serialize;

use crate::base::rng::Stream;
use crate::lab::stats::quantile;
use crate::lab::surrogate::births::{Candidate, Draw, FORMS, Phase};
use crate::lab::surrogate::rank::{Estimate, estimate, kendall, spearman};

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
    ("probe", |j, form| Some(j.probe[form])),
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
    pub spearman: Option<Estimate>,
    /// Kendall's τ_b.
    pub kendall: Option<Estimate>,
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
    /// Share of those whose probe predicts a gain, and of those whose probe does not; `None` of an empty set.
    pub lowering_by_probe: [Option<f64>; 2],
    /// Mean gain.
    pub mean_gain: f64,
    /// Quartiles of the gain.
    pub quartiles: Option<[f64; 3]>,
    /// Correlations by subset and predictor.
    pub correlations: Vec<Correlation>,
    /// Tenths by importance.
    pub by_importance: Vec<Calibration>,
    /// Tenths by probe.
    pub by_probe: Vec<Calibration>,
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
        lowering_by_probe: [
            share(&|j| j.probe[form] > 0.0),
            share(&|j| j.probe[form] <= 0.0),
        ],
        mean_gain: gains.iter().sum::<f64>() / gains.len().max(1) as f64,
        quartiles: quartiles(&gains),
        correlations: correlations(form, all, seed),
        by_importance: along(&|j| j.importance),
        by_probe: along(&|j| j.probe[form]),
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
                spearman: estimate(spearman, &x, &y, seed, resamples),
                kendall: estimate(kendall, &x, &y, seed, resamples),
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
