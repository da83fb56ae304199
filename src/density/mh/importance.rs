//! Importance of each Gaussian from its opacity and the error maps under it (\[MH\] Eq. 12, 13).

use rayon::prelude::*;

use crate::base::math::sigmoid;
use crate::density::statistics::ErrorStatistics;

/// Number of rows per partial sum; fixed, so that sums round alike for any number of threads.
const CHUNK: usize = 8192;
/// Addend to the standard deviation (the released implementation's value): a constant cue becomes 0, not NaN.
const STD_FLOOR: f64 = 1e-6;

/// I = σ(w_O·Ô + w_S·Ŝ + w_E·Ê) (Eq. 13) with `weights` = [w_O, w_S, w_E]. O is the opacity σ(logit); S and E are
/// 1 − SSIM and L1 averaged over the views that saw the Gaussian. The hat is (v − mean)/(std + 1e-6).
///
/// Returns one value in [0, 1] per Gaussian. Mean and deviation are those of the valid values; a Gaussian that was not seen, or has a non-finite value, gets 0,
/// the mean. All slices have length N; if they differ the shortest counts.
#[must_use]
pub fn importance(
    opacity_logits: &[f32],
    errors: &ErrorStatistics<'_>,
    weights: [f64; 3],
) -> Vec<f64> {
    let n = [errors.ssim.len(), errors.l1.len(), errors.views.len()]
        .into_iter()
        .fold(opacity_logits.len(), usize::min);
    let mut values = vec![0.0; n];
    let opacities = values.par_iter_mut().zip(opacity_logits);
    opacities.for_each(|(value, logit)| *value = sigmoid(f64::from(*logit)));
    let cues = Cues {
        opacities: &values,
        errors,
    };
    let scales = Scale::of(&cues);
    let importance = |(i, value): (usize, &mut f64)| {
        let row = cue_row(*value, errors, i);
        let term = |k: usize| weights[k] * scales[k].apply(row[k]);
        *value = sigmoid(term(0) + term(1) + term(2));
    };
    values.par_iter_mut().enumerate().for_each(importance);
    values
}

/// Opacity, 1 − SSIM, L1 of a Gaussian; an absent value is not finite, because it is divided by no views.
fn cue_row(opacity: f64, errors: &ErrorStatistics<'_>, i: usize) -> [f64; 3] {
    let average = |sums: &[f32]| f64::from(sums[i]) / f64::from(errors.views[i]);
    [opacity, average(errors.ssim), average(errors.l1)]
}

/// The cues of all Gaussians. Averages are computed where they are read, which costs less than memory for them.
struct Cues<'a> {
    opacities: &'a [f64],
    errors: &'a ErrorStatistics<'a>,
}

impl Cues<'_> {
    fn row(&self, i: usize) -> [f64; 3] {
        cue_row(self.opacities[i], self.errors, i)
    }

    /// The first finite value of each cue, or 0.
    fn first(&self) -> [f64; 3] {
        std::array::from_fn(|k| {
            let mut column = (0..self.opacities.len()).map(|i| self.row(i)[k]);
            column.find(|v| v.is_finite()).unwrap_or(0.0)
        })
    }

    /// Sum of `term(column, value)` and number of the finite values of each column, in an order that depends on the number
    /// of rows alone.
    fn ordered_sums(&self, term: impl Fn(usize, f64) -> f64 + Sync) -> ([f64; 3], [usize; 3]) {
        let n = self.opacities.len();
        let sum_chunk = |c: usize| {
            let (mut sums, mut counts) = ([0.0; 3], [0; 3]);
            for i in c * CHUNK..n.min((c + 1) * CHUNK) {
                let row = self.row(i);
                for k in 0..3 {
                    // No branch: which values are there is not to be predicted. A 0 changes no bit of a sum.
                    let there = row[k].is_finite();
                    sums[k] += if there { term(k, row[k]) } else { 0.0 };
                    counts[k] += usize::from(there);
                }
            }
            (sums, counts)
        };
        let chunks = (0..n.div_ceil(CHUNK)).into_par_iter();
        let partial: Vec<_> = chunks.map(sum_chunk).collect();
        let (mut sums, mut counts) = ([0.0; 3], [0; 3]);
        for (s, c) in partial {
            for k in 0..3 {
                sums[k] += s[k];
                counts[k] += c[k];
            }
        }
        (sums, counts)
    }
}

/// Mean and standard deviation of a cue.
#[derive(Debug, Clone, Copy)]
struct Scale {
    mean: f64,
    std: f64,
}

impl Scale {
    /// Scales of the finite values of each cue.
    fn of(cues: &Cues<'_>) -> [Self; 3] {
        // Relative to a value of the column: the mean of equal values is that value to the last bit.
        let origins = cues.first();
        let (sums, counts) = cues.ordered_sums(|k, v| v - origins[k]);
        let counts = counts.map(|c| c.max(1) as f64);
        let means: [f64; 3] = std::array::from_fn(|k| origins[k] + sums[k] / counts[k]);
        // Around the mean in a second pass: E[v²] − E[v]² goes negative on a constant cue.
        let (squares, _) = cues.ordered_sums(|k, v| (v - means[k]) * (v - means[k]));
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
