//! Importance of each Gaussian from its opacity and the error maps under it ([MH] Eq. 12, 13).

use crate::density::Cues;
use crate::density::relocation::sigmoid;
use rayon::prelude::*;

/// Rows per partial sum; fixed, so that sums round alike for any number of threads.
const CHUNK: usize = 8192;
/// Added to the standard deviation (the released implementation's value): a constant cue becomes 0, not NaN.
const STD_FLOOR: f64 = 1e-6;

/// Importance of N Gaussians.
#[derive(Debug, Clone, PartialEq)]
pub struct Importance {
    /// I ∈ [0, 1], one per Gaussian.
    pub values: Vec<f64>,
    /// Gaussians that no view of the subset saw.
    pub unseen: usize,
    /// Gaussians with a non-finite cue or opacity, taken as average in that cue.
    pub invalid: usize,
}

/// I = σ(w_O·Ô + w_S·Ŝ + w_E·Ê) (Eq. 13) with `weights` = [w_O, w_S, w_E]. O is the opacity σ(logit); S and E are
/// 1 − SSIM and L1 averaged over the views that saw the Gaussian. The hat is (v − mean)/(std + 1e-6).
///
/// Mean and deviation are those of the valid values; a Gaussian that was not seen, or has a non-finite value, gets 0,
/// the mean. All slices have length N; where they differ the shortest counts.
#[must_use]
pub fn importance(opacity_logits: &[f32], cues: &Cues<'_>, weights: [f64; 3]) -> Importance {
    let n = [cues.ssim.len(), cues.l1.len(), cues.views.len()]
        .into_iter()
        .fold(opacity_logits.len(), usize::min);
    let opacity = |i: usize| valid(sigmoid(f64::from(opacity_logits[i])));
    let average = |sums: &[f32], i: usize| match cues.views[i] {
        0 => None,
        views => valid(f64::from(sums[i]) / f64::from(views)),
    };
    let ssim = |i: usize| average(cues.ssim, i);
    let l1 = |i: usize| average(cues.l1, i);
    let scales = [Scale::of(n, opacity), Scale::of(n, ssim), Scale::of(n, l1)];
    let values = (0..n)
        .into_par_iter()
        .map(|i| {
            let cues = [opacity(i), ssim(i), l1(i)];
            let terms: [f64; 3] = std::array::from_fn(|k| weights[k] * scales[k].apply(cues[k]));
            sigmoid(terms[0] + terms[1] + terms[2])
        })
        .collect();
    let broken = |i: &usize| {
        opacity(*i).is_none() || (cues.views[*i] > 0 && (ssim(*i).is_none() || l1(*i).is_none()))
    };
    Importance {
        values,
        unseen: cues.views[..n].par_iter().filter(|v| **v == 0).count(),
        invalid: (0..n).into_par_iter().filter(broken).count(),
    }
}

fn valid(v: f64) -> Option<f64> {
    v.is_finite().then_some(v)
}

/// Mean and standard deviation of a cue.
#[derive(Debug, Clone, Copy)]
struct Scale {
    mean: f64,
    std: f64,
}

impl Scale {
    fn of(n: usize, cue: impl Fn(usize) -> Option<f64> + Sync) -> Self {
        let (sum, count) = ordered_sum(n, &cue);
        let count = count.max(1) as f64;
        let mean = sum / count;
        // Around the mean in a second pass: E[v²] − E[v]² goes negative on a constant cue.
        let (squares, _) = ordered_sum(n, &|i| cue(i).map(|v| (v - mean) * (v - mean)));
        Self {
            mean,
            std: (squares / count).sqrt(),
        }
    }

    fn apply(self, cue: Option<f64>) -> f64 {
        cue.map_or(0.0, |v| (v - self.mean) / (self.std + STD_FLOOR))
    }
}

/// Sum and number of the present values, in an order that depends on n alone.
fn ordered_sum(n: usize, value: &(impl Fn(usize) -> Option<f64> + Sync)) -> (f64, usize) {
    let partial: Vec<(f64, usize)> = (0..n.div_ceil(CHUNK))
        .into_par_iter()
        .map(|c| {
            (c * CHUNK..n.min((c + 1) * CHUNK))
                .filter_map(value)
                .fold((0.0, 0), |(sum, count), v| (sum + v, count + 1))
        })
        .collect();
    partial
        .into_iter()
        .fold((0.0, 0), |(sum, count), (s, c)| (sum + s, count + c))
}
