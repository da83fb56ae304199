//! Importance of each Gaussian from its opacity and the error maps under it (\[MH\] Eq. 12, 13).

use rayon::prelude::*;

use crate::base::math::sigmoid;
use crate::density::statistics::ErrorStatistics;

/// Number of rows per partial sum; fixed, so that sums round alike for any number of threads.
const CHUNK: usize = 8192;
/// Addend to the standard deviation (the released implementation's value): a constant cue becomes 0, not NaN.
const STD_FLOOR: f64 = 1e-6;

/// Importance of N Gaussians.
#[derive(Debug, Clone, PartialEq)]
pub struct Importance {
    /// I ∈ [0, 1], one per Gaussian.
    pub values: Vec<f64>,
    /// Number of Gaussians that no view of the subset saw.
    pub unseen: usize,
    /// Number of Gaussians with a non-finite cue or opacity, which count as average in that cue.
    pub invalid: usize,
}

/// I = σ(w_O·Ô + w_S·Ŝ + w_E·Ê) (Eq. 13) with `weights` = [w_O, w_S, w_E]. O is the opacity σ(logit); S and E are
/// 1 − SSIM and L1 averaged over the views that saw the Gaussian. The hat is (v − mean)/(std + 1e-6).
///
/// Mean and deviation are those of the valid values; a Gaussian that was not seen, or has a non-finite value, gets 0,
/// the mean. All slices have length N; if they differ the shortest counts.
#[must_use]
pub fn importance(
    opacity_logits: &[f32],
    errors: &ErrorStatistics<'_>,
    weights: [f64; 3],
) -> Importance {
    let n = [errors.ssim.len(), errors.l1.len(), errors.views.len()]
        .into_iter()
        .fold(opacity_logits.len(), usize::min);
    let average = |sums: &[f32], i: usize| match errors.views[i] {
        0 => f64::NAN,
        views => f64::from(sums[i]) / f64::from(views),
    };
    // Opacity, 1 − SSIM, L1 of each Gaussian; an absent value is NaN.
    let rows: Vec<[f64; 3]> = (0..n)
        .into_par_iter()
        .map(|i| {
            [
                sigmoid(f64::from(opacity_logits[i])),
                average(errors.ssim, i),
                average(errors.l1, i),
            ]
        })
        .collect();
    let scales = Scale::of(&rows);
    let value = |row: &[f64; 3]| {
        let term = |k: usize| weights[k] * scales[k].apply(row[k]);
        sigmoid(term(0) + term(1) + term(2))
    };
    let broken = |(row, views): &(&[f64; 3], &u32)| {
        let [opacity, ssim, l1] = row.map(f64::is_finite);
        !(opacity && (**views == 0 || (ssim && l1)))
    };
    let views = &errors.views[..n];
    Importance {
        values: rows.par_iter().map(value).collect(),
        unseen: views.par_iter().filter(|v| **v == 0).count(),
        invalid: rows.par_iter().zip(views).filter(broken).count(),
    }
}

/// Mean and standard deviation of a cue.
#[derive(Debug, Clone, Copy)]
struct Scale {
    mean: f64,
    std: f64,
}

impl Scale {
    /// Scales of the finite values of each column.
    fn of(rows: &[[f64; 3]]) -> [Self; 3] {
        // Relative to a value of the column: the mean of equal values is that value to the last bit.
        let origins: [f64; 3] = std::array::from_fn(|k| {
            let mut column = rows.iter().map(|row| row[k]);
            column.find(|v| v.is_finite()).unwrap_or(0.0)
        });
        let (sums, counts) = ordered_sums(rows, |k, v| v - origins[k]);
        let counts = counts.map(|c| c.max(1) as f64);
        let means: [f64; 3] = std::array::from_fn(|k| origins[k] + sums[k] / counts[k]);
        // Around the mean in a second pass: E[v²] − E[v]² goes negative on a constant cue.
        let (squares, _) = ordered_sums(rows, |k, v| (v - means[k]) * (v - means[k]));
        std::array::from_fn(|k| Self {
            mean: means[k],
            std: (squares[k] / counts[k]).sqrt(),
        })
    }

    fn apply(self, v: f64) -> f64 {
        if v.is_finite() {
            (v - self.mean) / (self.std + STD_FLOOR)
        } else {
            0.0
        }
    }
}

/// Sum of `term(column, value)` and number of the finite values of each column, in an order that depends on the number
/// of rows alone.
fn ordered_sums(
    rows: &[[f64; 3]],
    term: impl Fn(usize, f64) -> f64 + Sync,
) -> ([f64; 3], [usize; 3]) {
    let sum_chunk = |chunk: &[[f64; 3]]| {
        let (mut sums, mut counts) = ([0.0; 3], [0; 3]);
        for row in chunk {
            for k in 0..3 {
                if row[k].is_finite() {
                    sums[k] += term(k, row[k]);
                    counts[k] += 1;
                }
            }
        }
        (sums, counts)
    };
    let partial: Vec<_> = rows.par_chunks(CHUNK).map(sum_chunk).collect();
    let (mut sums, mut counts) = ([0.0; 3], [0; 3]);
    for (s, c) in partial {
        for k in 0..3 {
            sums[k] += s[k];
            counts[k] += c[k];
        }
    }
    (sums, counts)
}
