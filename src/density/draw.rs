//! Random draws of the strategies: sources by weight, positions by the source's own shape (\[MH\] Eq. 14–16, \[3DGS\] §5.2).

use rayon::prelude::*;

use crate::base::rng::Philox;
use crate::density::state::{SceneState, gather};

/// Number of weights per partial sum; fixed, so that sums round alike for any number of threads.
const CHUNK: usize = 8192;

/// A categorical distribution over N items, by prefix sums in f64.
///
/// Negative and NaN weights count as 0. A total of zero or infinity makes the draw uniform over all items.
#[derive(Debug, Clone, PartialEq)]
pub struct Categorical {
    /// Prefix sums, never falling; empty if the draw is uniform.
    cumulative: Vec<f64>,
    len: usize,
}

impl Categorical {
    /// The distribution with one weight per item.
    #[must_use]
    pub fn new(weights: Vec<f64>) -> Self {
        let len = weights.len();
        let mut cumulative = weights;
        let totals: Vec<f64> = cumulative
            .par_chunks_mut(CHUNK)
            .map(|sums| {
                let mut total = 0.0;
                for sum in sums {
                    total += if *sum > 0.0 { *sum } else { 0.0 };
                    *sum = total;
                }
                total
            })
            .collect();
        let mut base = 0.0;
        let bases: Vec<f64> = totals
            .iter()
            .map(|total| {
                let before = base;
                base += total;
                before
            })
            .collect();
        if !(base > 0.0 && base.is_finite()) {
            cumulative.clear();
        }
        cumulative
            .par_chunks_mut(CHUNK)
            .zip(bases)
            .for_each(|(sums, base)| sums.iter_mut().for_each(|s| *s += base));
        Self { cumulative, len }
    }

    /// The item at u ∈ [0, 1); `None` if there are no items. An item of weight 0 is never drawn (unless uniform).
    #[must_use]
    pub fn draw(&self, u: f64) -> Option<usize> {
        let Some(&total) = self.cumulative.last() else {
            return (self.len > 0).then(|| ((u * self.len as f64) as usize).min(self.len - 1));
        };
        let at = u * total;
        let i = self.cumulative.partition_point(|&c| c <= at);
        // u·total may round up to the total: the item that reaches it is the last one with a weight.
        let last = self.cumulative.partition_point(|&c| c < total);
        Some(i.min(last))
    }

    /// Unique items of `draws` draws with replacement, sorted (Eq. 14): at most `draws` of them.
    #[must_use]
    pub fn draw_unique(&self, draws: usize, seed: u64, stream: u64) -> Vec<usize> {
        let mut items: Vec<usize> = (0..draws as u64)
            .into_par_iter()
            .filter_map(|k| self.draw(Philox::uniform_53(seed, stream, k)[0]))
            .collect();
        items.par_sort_unstable();
        items.dedup();
        items
    }
}

/// Position of a birth: x′ = x + R·(k·s ⊙ ξ), ξ the given standard normal numbers, s the scales of row `row` along its
/// own axes, R its rotation, k the spread (Eq. 15, 16 with the Gaussian's own covariance, so that births follow its
/// shape). `log_scale` is given apart because a relocation may have changed it. `None` if `row` does not exist or the
/// result is not finite in f32.
#[must_use]
pub fn birth_position(
    scene: &SceneState<'_>,
    row: usize,
    log_scale: [f32; 3],
    spread: f64,
    normal: [f64; 3],
) -> Option<[f32; 3]> {
    let at = gather(&scene.positions, row)?;
    let rotation = gather(&scene.rotations, row)?.map(f64::from);
    let own: [f64; 3] = std::array::from_fn(|k| spread * f64::from(log_scale[k]).exp() * normal[k]);
    let offset = rotate(rotation, own);
    let moved: [f32; 3] = std::array::from_fn(|k| (f64::from(at[k]) + offset[k]) as f32);
    moved.iter().all(|v| v.is_finite()).then_some(moved)
}

/// R(q)·v for a quaternion (w, x, y, z) of any norm; a zero or non-finite one is the identity.
#[must_use]
pub fn rotate(quaternion: [f64; 4], v: [f64; 3]) -> [f64; 3] {
    let largest = quaternion.iter().fold(0.0f64, |m, c| m.max(c.abs()));
    let finite = quaternion.iter().all(|c| c.is_finite());
    if !(finite && largest > 0.0) {
        return v;
    }
    // The largest component is factored out so that squaring neither overflows nor vanishes.
    let q = quaternion.map(|c| c / largest);
    let norm = q.iter().map(|c| c * c).sum::<f64>().sqrt();
    let [w, x, y, z] = q.map(|c| c / norm);
    let axis = [x, y, z];
    let cross = |a: [f64; 3], b: [f64; 3]| {
        [
            a[1] * b[2] - a[2] * b[1],
            a[2] * b[0] - a[0] * b[2],
            a[0] * b[1] - a[1] * b[0],
        ]
    };
    let t = cross(axis, v).map(|c| 2.0 * c);
    let u = cross(axis, t);
    std::array::from_fn(|k| v[k] + w * t[k] + u[k])
}
