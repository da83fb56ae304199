//! Random draws of the strategies: sources by weight, positions by the source's own shape (\[MH\] Eq. 14–16, \[3DGS\] §5.2).

use rayon::prelude::*;

use crate::base::rng::Philox;
use crate::density::state::{SceneState, gather};

/// Number of weights per partial sum; fixed, so that sums round alike for any number of threads.
const CHUNK: usize = 8192;
/// Number of weights that a draw adds up again.
const BLOCK: usize = 32;
const _: () = assert!(CHUNK.is_multiple_of(BLOCK));

/// Weights of N items, computed where they are read: written out, those of a million items cost more time than all draws.
pub trait Weights: Sync {
    /// Number of items.
    fn count(&self) -> usize;

    /// Writes the weights of as many items from `first` on as `out` has room for.
    fn write(&self, first: usize, out: &mut [f64]);
}

impl<W: Weights> Weights for &W {
    fn count(&self) -> usize {
        (*self).count()
    }

    fn write(&self, first: usize, out: &mut [f64]) {
        (*self).write(first, out);
    }
}

impl Weights for Vec<f64> {
    fn count(&self) -> usize {
        self.len()
    }

    fn write(&self, first: usize, out: &mut [f64]) {
        out.copy_from_slice(&self[first..][..out.len()]);
    }
}

/// The weights of some rows.
#[derive(Debug, Clone, Copy)]
pub struct RowWeights<'a> {
    /// Weight of every row.
    pub weights: &'a [f64],
    /// The items' rows.
    pub rows: &'a [u32],
}

impl Weights for RowWeights<'_> {
    fn count(&self) -> usize {
        self.rows.len()
    }

    fn write(&self, first: usize, out: &mut [f64]) {
        for (out, row) in out.iter_mut().zip(&self.rows[first..]) {
            *out = self.weights[*row as usize];
        }
    }
}

/// A categorical distribution over N items, by prefix sums in f64: of each chunk by itself, and then of the chunks.
///
/// Negative and NaN weights count as 0. A total of zero or infinity makes the draw uniform over all items.
#[derive(Debug, Clone, PartialEq)]
pub struct Categorical<W> {
    weights: W,
    /// Sum of all chunks before each chunk; empty if the draw is uniform.
    bases: Vec<f64>,
    /// Sum of the items of its chunk before each block.
    runs: Vec<f64>,
    /// Prefix sum at the end of each block, never falling.
    ends: Vec<f64>,
}

impl<W: Weights> Categorical<W> {
    /// The distribution with one weight per item.
    #[must_use]
    pub fn new(weights: W) -> Self {
        let count = weights.count();
        let mut runs = vec![0.0; count.div_ceil(BLOCK)];
        let chunk = |(c, runs): (usize, &mut [f64])| {
            let mut total = 0.0;
            for (b, run) in runs.iter_mut().enumerate() {
                *run = total;
                let mut block = [0.0; BLOCK];
                let block = within(&weights, c * CHUNK + b * BLOCK, &mut block);
                total = block.iter().fold(total, |sum, w| sum + w);
            }
            total
        };
        let chunks = runs.par_chunks_mut(CHUNK / BLOCK).enumerate();
        let totals: Vec<f64> = chunks.map(chunk).collect();
        let mut base = 0.0;
        let add = |total: &f64| {
            let before = base;
            base += total;
            before
        };
        let mut bases: Vec<f64> = totals.iter().map(add).collect();
        if !(base > 0.0 && base.is_finite()) {
            bases.clear();
        }
        // A chunk ends where the next one begins.
        let starts = (1..).zip(runs.iter().skip(1));
        let starts = starts.map(|(b, run)| run + bases.get(b * BLOCK / CHUNK).unwrap_or(&base));
        let ends = starts.chain((count > 0).then_some(base)).collect();
        Self {
            weights,
            bases,
            runs,
            ends,
        }
    }

    /// The item at u ∈ [0, 1); `None` if there are no items. An item of weight 0 is never drawn (unless uniform).
    #[must_use]
    pub fn draw(&self, u: f64) -> Option<usize> {
        let (len, total) = (self.weights.count(), *self.ends.last()?);
        if self.bases.is_empty() {
            return Some(((u * len as f64) as usize).min(len - 1));
        }
        let at = u * total;
        if at < total {
            return Some(self.first(|sum| sum > at));
        }
        // u·total may round up to the total: the item that reaches it is the last one with a weight.
        Some(self.first(|sum| sum >= total))
    }

    /// The first item whose prefix sum is `beyond`, as the last one's is.
    fn first(&self, beyond: impl Fn(f64) -> bool) -> usize {
        let block = self.ends.partition_point(|sum| !beyond(*sum));
        let first = block * BLOCK;
        let (mut sum, base) = (self.runs[block], self.bases[first / CHUNK]);
        let mut weights = [0.0; BLOCK];
        let weights = within(&self.weights, first, &mut weights);
        let mut reached = weights.iter().map(|weight| {
            sum += weight;
            sum + base
        });
        first + reached.position(beyond).unwrap_or(weights.len() - 1)
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

/// The weights of a block, without the negative and NaN ones.
fn within<'b>(weights: &impl Weights, first: usize, block: &'b mut [f64; BLOCK]) -> &'b [f64] {
    let len = BLOCK.min(weights.count() - first);
    let block = &mut block[..len];
    weights.write(first, block);
    for weight in block.iter_mut() {
        *weight = if *weight > 0.0 { *weight } else { 0.0 };
    }
    block
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
