//! Importance of each Gaussian from its opacity and the error maps under it (\[MH\] Eq. 12, 13).

use rayon::prelude::*;

use crate::base::math::sigmoid;
use crate::density::statistics::ErrorStatistics;

/// Number of rows per partial sum; fixed, so that sums round alike for any number of threads.
const CHUNK: usize = 8192;
/// Number of rows that are worked on column by column.
const BLOCK: usize = 128;
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
    let cues = Cues { errors };
    // With room for those of the births: it costs nothing until it is written, a larger copy does.
    let mut values = vec![0.0; n + n / 8];
    values.truncate(n);
    let scales = cues.scales(&opacity_logits[..n], &mut values);
    let chunks = values.par_chunks_mut(CHUNK).enumerate();
    chunks.for_each(|(c, values)| cues.weigh(c * CHUNK, values, &scales, weights));
    values
}

/// The cues of all Gaussians. Averages are computed where they are read, which costs less than memory for them.
struct Cues<'a> {
    errors: &'a ErrorStatistics<'a>,
}

/// Opacity, 1 − SSIM and L1 of a block of Gaussians; an absent value is not finite, because it is divided by no views.
type Block = [[f64; BLOCK]; 3];

/// Sums over the finite values of each cue, and their numbers.
type Sums = ([f64; 3], [usize; 3]);

impl Cues<'_> {
    /// Fills in the cues of the Gaussians from `first` on, of which these are the opacities. Loops without branches over one column at
    /// a time: the compiler makes vectors of them.
    fn read(&self, first: usize, opacities: &[f64], block: &mut Block) {
        let n = opacities.len();
        let [opacity, averages @ ..] = block;
        opacity[..n].copy_from_slice(opacities);
        let views = &self.errors.views[first..][..n];
        for (column, sums) in averages.iter_mut().zip([self.errors.ssim, self.errors.l1]) {
            let rows = sums[first..][..n].iter().zip(views);
            for (average, (sum, views)) in column.iter_mut().zip(rows) {
                *average = f64::from(*sum) / f64::from(*views);
            }
        }
    }

    /// The first finite value of each cue, or 0.
    fn first(&self, logits: &[f32]) -> [f64; 3] {
        let average = |sums: &[f32], i: usize| f64::from(sums[i]) / f64::from(self.errors.views[i]);
        let first = |value: &dyn Fn(usize) -> f64| {
            let mut column = (0..logits.len()).map(value);
            column.find(|v| v.is_finite()).unwrap_or(0.0)
        };
        [
            first(&|i| sigmoid(f64::from(logits[i]))),
            first(&|i| average(self.errors.ssim, i)),
            first(&|i| average(self.errors.l1, i)),
        ]
    }

    /// Sum of `term(column, value)` over the finite values of each cue in the rows from `first` on.
    fn sums(&self, first: usize, opacities: &[f64], term: impl Fn(usize, f64) -> f64) -> Sums {
        let (mut sums, mut counts, mut block) = ([0.0; 3], [0; 3], [[0.0; BLOCK]; 3]);
        for (b, opacities) in opacities.chunks(BLOCK).enumerate() {
            self.read(first + b * BLOCK, opacities, &mut block);
            for (k, column) in block.iter_mut().enumerate() {
                let column = &mut column[..opacities.len()];
                counts[k] += column.iter().filter(|v| v.is_finite()).count();
                for v in column {
                    // A 0 changes no bit of a sum.
                    *v = if v.is_finite() { term(k, *v) } else { 0.0 };
                }
            }
            for i in 0..opacities.len() {
                for (sum, column) in sums.iter_mut().zip(&block) {
                    *sum += column[i];
                }
            }
        }
        (sums, counts)
    }

    /// Writes the importances of the Gaussians from `first` on in place of their opacities.
    fn weigh(&self, first: usize, values: &mut [f64], scales: &[Scale; 3], weights: [f64; 3]) {
        let mut block = [[0.0; BLOCK]; 3];
        for (b, values) in values.chunks_mut(BLOCK).enumerate() {
            self.read(first + b * BLOCK, values, &mut block);
            for (k, column) in block.iter_mut().enumerate() {
                for v in &mut column[..values.len()] {
                    *v = weights[k] * scales[k].apply(*v);
                }
            }
            for (i, value) in values.iter_mut().enumerate() {
                *value = sigmoid(block[0][i] + block[1][i] + block[2][i]);
            }
        }
    }

    /// Writes the opacities, and returns the scale of the finite values of each cue.
    fn scales(&self, logits: &[f32], opacities: &mut [f64]) -> [Scale; 3] {
        // Relative to a value of the column: the mean of equal values is that value to the last bit.
        let origins = self.first(logits);
        let chunks = opacities.par_chunks_mut(CHUNK).enumerate();
        let apart = chunks.map(|(c, opacities)| {
            for (opacity, logit) in opacities.iter_mut().zip(&logits[c * CHUNK..]) {
                *opacity = sigmoid(f64::from(*logit));
            }
            self.sums(c * CHUNK, opacities, |k, v| v - origins[k])
        });
        let (sums, counts) = total(apart);
        let counts = counts.map(|c| c.max(1) as f64);
        let means: [f64; 3] = std::array::from_fn(|k| origins[k] + sums[k] / counts[k]);
        // Around the mean in a second pass: E[v²] − E[v]² goes negative on a constant cue.
        let chunks = opacities.par_chunks(CHUNK).enumerate();
        let (squares, _) = total(chunks.map(|(c, opacities)| {
            let square = |k: usize, v: f64| (v - means[k]) * (v - means[k]);
            self.sums(c * CHUNK, opacities, square)
        }));
        std::array::from_fn(|k| Scale {
            mean: means[k],
            std: (squares[k] / counts[k]).sqrt(),
        })
    }
}

/// Sums of all chunks, in an order that depends on the number of rows alone.
fn total(chunks: impl IndexedParallelIterator<Item = Sums>) -> Sums {
    let partial: Vec<Sums> = chunks.collect();
    let (mut sums, mut counts) = ([0.0; 3], [0; 3]);
    for (s, c) in partial {
        for k in 0..3 {
            sums[k] += s[k];
            counts[k] += c[k];
        }
    }
    (sums, counts)
}

/// Mean and standard deviation of a cue.
#[derive(Debug, Clone, Copy)]
struct Scale {
    mean: f64,
    std: f64,
}

impl Scale {
    fn apply(self, v: f64) -> f64 {
        if v.is_finite() {
            (v - self.mean) / (self.std + STD_FLOOR)
        } else {
            0.0
        }
    }
}
