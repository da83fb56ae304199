//! Several samples of one figure, and what may be said of two of them.

use serde::{Deserialize, Serialize};

/// Samples that a ratio needs on both sides.
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
    /// Of finite samples; none of an empty list or one that holds anything else.
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

/// A ratio of medians, and the interval that the samples' ranges allow.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Ratio {
    /// Ratio of the medians.
    pub median: f64,
    /// Smallest over largest sample.
    pub low: f64,
    /// Largest over smallest sample.
    pub high: f64,
}

/// `a` over `b`; none where either has fewer than [`RATIO_SAMPLES`] samples, or `b` is not positive throughout: a ratio
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
/// samples' ranges. None with fewer than two different x, or a point of fewer than [`RATIO_SAMPLES`] samples: an exponent
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
