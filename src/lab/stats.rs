//! Statistics of repeated measurements: spread, ratio, interval, power law, geometric mean, quantile.

use serde::{Deserialize, Serialize};

/// Least number of samples that a ratio needs on both sides, and a range that is shown.
pub const RATIO_SAMPLES: usize = 3;

/// Median and range of repeated measurements.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Median.
    pub median: f64,
    /// Smallest sample.
    pub min: f64,
    /// Largest sample.
    pub max: f64,
    /// Number of samples.
    pub samples: usize,
}

impl Spread {
    /// The spread of finite samples; `None` of an empty list or one that holds anything else.
    #[must_use]
    pub fn of(samples: &[f64]) -> Option<Self> {
        if samples.is_empty() || samples.iter().any(|v| !v.is_finite()) {
            return None;
        }
        let mut sorted = samples.to_vec();
        sorted.sort_by(f64::total_cmp);
        let n = sorted.len();
        Some(Self {
            median: f64::midpoint(sorted[(n - 1) / 2], sorted[n / 2]),
            min: sorted[0],
            max: sorted[n - 1],
            samples: n,
        })
    }

    /// The spread of ratios: the middle two of an even number have their geometric mean between them, so that it does not
    /// matter which side is below the line.
    #[must_use]
    pub fn of_ratios(ratios: &[f64]) -> Option<Self> {
        let logs: Vec<f64> = ratios.iter().map(|v| v.ln()).collect();
        let s = Self::of(&logs)?;
        Some(Self {
            median: s.median.exp(),
            min: s.min.exp(),
            max: s.max.exp(),
            ..s
        })
    }

    /// All three figures times a positive factor (a change of unit).
    #[must_use]
    pub fn scaled(self, factor: f64) -> Self {
        Self {
            median: self.median * factor,
            min: self.min * factor,
            max: self.max * factor,
            ..self
        }
    }
}

/// A ratio of medians with the interval that the samples' ranges allow.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Ratio {
    /// Ratio of the medians.
    pub median: f64,
    /// Smallest over largest sample.
    pub low: f64,
    /// Largest over smallest sample.
    pub high: f64,
}

impl Ratio {
    /// All three figures times a positive factor (a change of unit).
    #[must_use]
    pub fn scaled(self, factor: f64) -> Self {
        Self {
            median: self.median * factor,
            low: self.low * factor,
            high: self.high * factor,
        }
    }
}

/// `a` over `b`; `None` if either has fewer than [`RATIO_SAMPLES`] samples, or `b` is not positive throughout: a ratio
/// without a spread says nothing.
#[must_use]
pub fn ratio(a: &Spread, b: &Spread) -> Option<Ratio> {
    let enough = a.samples >= RATIO_SAMPLES && b.samples >= RATIO_SAMPLES;
    (enough && b.min > 0.0).then(|| Ratio {
        median: a.median / b.median,
        low: a.min / b.max,
        high: a.max / b.min,
    })
}

/// Exponent p of y ∝ xᵖ by least squares in the logarithms, through the medians, and its interval over all y within the
/// samples' ranges. `None` with fewer than two different x, or a point of fewer than [`RATIO_SAMPLES`] samples: an exponent
/// is a logarithm of ratios.
#[must_use]
pub fn exponent(points: &[(f64, Spread)]) -> Option<Ratio> {
    let usable = |(x, y): &(f64, Spread)| *x > 0.0 && y.min > 0.0 && y.samples >= RATIO_SAMPLES;
    if !points.iter().all(usable) {
        return None;
    }
    let mean = points.iter().map(|(x, _)| x.ln()).sum::<f64>() / points.len() as f64;
    let square: f64 = points.iter().map(|(x, _)| (x.ln() - mean).powi(2)).sum();
    if points.len() < 2 || square < 1e-12 {
        return None;
    }
    let slope = |pick: &dyn Fn(&Spread, f64) -> f64| -> f64 {
        points
            .iter()
            .map(|(x, y)| {
                let weight = (x.ln() - mean) / square;
                weight * pick(y, weight).ln()
            })
            .sum()
    };
    Some(Ratio {
        median: slope(&|y, _| y.median),
        low: slope(&|y, weight| if weight > 0.0 { y.min } else { y.max }),
        high: slope(&|y, weight| if weight > 0.0 { y.max } else { y.min }),
    })
}

/// Quantiles of Student's t at 0.975, of 1 to 30 degrees of freedom; the last stands for more, on the wide side.
const STUDENT: [f64; 30] = [
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160,
    2.145, 2.131, 2.120, 2.110, 2.101, 2.093, 2.086, 2.080, 2.074, 2.069, 2.064, 2.060, 2.056,
    2.052, 2.048, 2.045, 2.042,
];

/// A mean with its 95 % confidence interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Interval {
    /// Mean.
    pub mean: f64,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
    /// Number of samples.
    pub samples: usize,
}

impl Interval {
    /// Mean of the means of some strata (scenes, say), each with its own samples. The interval is of the spread within the strata alone:
    /// it holds for these strata, not for others. Each has a variance of its own, so that the degrees of freedom of Student's t
    /// are those of Welch and Satterthwaite. `None` unless every stratum has [`RATIO_SAMPLES`] finite samples.
    #[must_use]
    pub fn of_strata(strata: &[&[f64]]) -> Option<Self> {
        let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
        let good = |v: &&[f64]| v.len() >= RATIO_SAMPLES && v.iter().all(|x| x.is_finite());
        if strata.is_empty() || !strata.iter().all(good) {
            return None;
        }
        let squares = |v: &&[f64]| v.iter().map(|x| (x - mean(v)).powi(2)).sum::<f64>();
        let of_mean = |v: &&[f64]| squares(v) / ((v.len() - 1) * v.len()) as f64;
        let variance: f64 = strata.iter().map(of_mean).sum();
        let parts = strata
            .iter()
            .map(|v| of_mean(v).powi(2) / (v.len() - 1) as f64);
        // Without any scatter the quantile does not matter.
        let freedom = (variance.powi(2) / parts.sum::<f64>()).max(1.0) as usize;
        let means: Vec<f64> = strata.iter().map(|v| mean(v)).collect();
        let error = variance.sqrt() / strata.len() as f64;
        let half = STUDENT[(freedom - 1).min(STUDENT.len() - 1)] * error;
        let mean = mean(&means);
        Some(Self {
            mean,
            low: mean - half,
            high: mean + half,
            samples: strata.iter().map(|v| v.len()).sum(),
        })
    }
}

/// Geometric mean; `None` of an empty list or one that holds anything but positive finite numbers.
#[must_use]
pub fn geometric_mean(values: &[f64]) -> Option<f64> {
    let good = |v: &f64| *v > 0.0 && v.is_finite();
    let logs: f64 = values.iter().map(|v| v.ln()).sum();
    (!values.is_empty() && values.iter().all(good)).then(|| (logs / values.len() as f64).exp())
}

/// Quantile of sorted values, linear between them; `None` of an empty list.
#[must_use]
pub fn quantile(sorted: &[f64], share: f64) -> Option<f64> {
    let last = sorted.len().checked_sub(1)?;
    let at = share.clamp(0.0, 1.0) * last as f64;
    let below = at.floor() as usize;
    let above = (below + 1).min(last);
    Some(sorted[below] + (at - below as f64) * (sorted[above] - sorted[below]))
}
