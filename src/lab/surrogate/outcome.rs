//! Correlations and calibration of one form of birth.

use serde::Serialize;

use crate::lab::stats::quantile;
use crate::lab::surrogate::candidates::{Candidate, Draw, Phase};
use crate::lab::surrogate::rank::{Estimate, estimate, kendall, spearman};
use crate::lab::surrogate::stream::{RESAMPLE, stream};

/// The forms of a birth, by their names in the configuration.
pub const FORMS: [&str; 3] = ["copy", "split", "faint"];
/// Bins of a calibration curve.
const BINS: usize = 10;

/// A candidate with its true and predicted gain in each of [`FORMS`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Judged {
    /// The candidate.
    #[serde(flatten)]
    pub candidate: Candidate,
    /// Number of views in which it has any pixel.
    pub views: usize,
    /// True gain −ΔL.
    pub gain: [f64; FORMS.len()],
    /// First-order prediction of −ΔL by the probe.
    pub probe: [f64; FORMS.len()],
}

/// A predictor of the true gain: name, and value of a candidate in a form.
type Predictor = (&'static str, fn(&Judged, usize) -> Option<f64>);

/// Predictors in the order of the tables.
const PREDICTORS: [Predictor; 6] = [
    ("importance I", |j, _| Some(j.candidate.importance)),
    ("acceptance ρ", |j, _| Some(j.candidate.acceptance)),
    ("opacity alone", |j, _| Some(j.candidate.opacity)),
    ("1 − SSIM alone", |j, _| j.candidate.ssim),
    ("L1 alone", |j, _| j.candidate.l1),
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

pub(super) fn of_form(form: usize, all: &[Judged], seed: u64) -> FormOutcome {
    let gains: Vec<f64> = all.iter().map(|j| j.gain[form]).collect();
    let share = |keep: &dyn Fn(&Judged) -> bool| {
        let kept = || all.iter().filter(|j| keep(j));
        let good = kept().filter(|j| j.gain[form] > 0.0).count();
        (kept().count() > 0).then(|| good as f64 / kept().count() as f64)
    };
    let along = |of: &dyn Fn(&Judged) -> f64| {
        let x: Vec<f64> = all.iter().map(of).collect();
        bins(&x, &gains, BINS)
    };
    FormOutcome {
        birth: FORMS[form],
        lowering: share(&|_| true).unwrap_or(0.0),
        lowering_proposals: share(&|j| j.candidate.draw == Draw::Proposal).unwrap_or(0.0),
        lowering_by_probe: [
            share(&|j| j.probe[form] > 0.0),
            share(&|j| j.probe[form] <= 0.0),
        ],
        mean_gain: gains.iter().sum::<f64>() / gains.len().max(1) as f64,
        quartiles: quartiles(&gains),
        correlations: correlations(form, all, seed),
        by_importance: along(&|j| j.candidate.importance),
        by_probe: along(&|j| j.probe[form]),
    }
}

/// Every predictor over every subset.
fn correlations(form: usize, all: &[Judged], seed: u64) -> Vec<Correlation> {
    let mut correlations = Vec::new();
    for (s, (subset, keep)) in SUBSETS.into_iter().enumerate() {
        for (p, (predictor, value)) in PREDICTORS.into_iter().enumerate() {
            let kept = all.iter().filter(|j| keep(&j.candidate));
            let pairs = kept.filter_map(|j| Some((value(j, form)?, j.gain[form])));
            let (x, y): (Vec<f64>, Vec<f64>) = pairs.unzip();
            let resamples = stream(RESAMPLE + (s * PREDICTORS.len() + p) as u32);
            correlations.push(Correlation {
                predictor,
                subset,
                count: x.len(),
                spearman: estimate(spearman, &x, &y, seed, resamples),
                kendall: estimate(kendall, &x, &y, seed, resamples),
                top_gain: bins(&x, &y, BINS).last().map(|b| b.mean),
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
#[must_use]
pub(super) fn bins(predicted: &[f64], gains: &[f64], count: usize) -> Vec<Calibration> {
    let n = predicted.len();
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|a, b| predicted[*a].total_cmp(&predicted[*b]));
    let count = count.min(n);
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
