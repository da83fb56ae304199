//! Rank correlations with bootstrap intervals.

use serde::Serialize;

use crate::base::rng::Philox;
use crate::lab::stats::quantile;

/// Resamples of a bootstrap interval.
const RESAMPLES: u64 = 1000;

/// A statistic and its 95 % interval (percentiles of a bootstrap over the pairs).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Estimate {
    /// The statistic of the sample.
    pub value: f64,
    /// 2.5th percentile.
    pub low: f64,
    /// 97.5th percentile.
    pub high: f64,
}

/// Ranks from 1, ties sharing their mean rank. NaN sorts last.
#[must_use]
pub fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|a, b| values[*a].total_cmp(&values[*b]));
    let mut ranks = vec![0.0; values.len()];
    let mut first = 0;
    // 0.0 and −0.0 are one value, which `==` says and the order of sorting does not mind.
    for run in order.chunk_by(|a, b| values[*a] == values[*b]) {
        let shared = first as f64 + (run.len() + 1) as f64 / 2.0;
        run.iter().for_each(|i| ranks[*i] = shared);
        first += run.len();
    }
    ranks
}

/// Pearson's correlation; `None` for fewer than two pairs, or if a side is constant or not finite.
fn pearson(x: &[f64], y: &[f64]) -> Option<f64> {
    let n = x.len() as f64;
    let mean = |v: &[f64]| v.iter().sum::<f64>() / n;
    let (mx, my) = (mean(x), mean(y));
    let (mut xx, mut yy, mut xy) = (0.0, 0.0, 0.0);
    for (a, b) in x.iter().zip(y) {
        xx += (a - mx) * (a - mx);
        yy += (b - my) * (b - my);
        xy += (a - mx) * (b - my);
    }
    let r = xy / (xx * yy).sqrt();
    (x.len() == y.len() && xx > 0.0 && yy > 0.0 && r.is_finite()).then(|| r.clamp(-1.0, 1.0))
}

/// Spearman's ρ: Pearson's correlation of the ranks. `None` if a side is constant, or the lengths differ.
#[must_use]
pub fn spearman(x: &[f64], y: &[f64]) -> Option<f64> {
    pearson(&ranks(x), &ranks(y))
}

/// Kendall's τ_b, which corrects for ties: (concordant − discordant) over the geometric mean of the pairs not tied in x and
/// those not tied in y. `None` if a side is constant, or the lengths differ.
#[must_use]
pub fn kendall(x: &[f64], y: &[f64]) -> Option<f64> {
    if x.len() != y.len() {
        return None;
    }
    // Ranks in place of values: ties are equal, and NaN and signed zeros are no special case any more.
    let (x, y) = (ranks(x), ranks(y));
    let mut pairs: Vec<(f64, f64)> = x.into_iter().zip(y).collect();
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let tied = |runs: &mut dyn Iterator<Item = usize>| runs.map(choose_two).sum::<f64>();
    let all = choose_two(pairs.len());
    let tied_x = tied(&mut pairs.chunk_by(|a, b| a.0 == b.0).map(<[_]>::len));
    let tied_both = tied(&mut pairs.chunk_by(|a, b| a == b).map(<[_]>::len));
    // Every y goes to its place among the ones before it: those that it passes are out of order.
    let (mut ys, mut swaps): (Vec<f64>, f64) = (Vec::with_capacity(pairs.len()), 0.0);
    for (_, y) in pairs {
        let at = ys.partition_point(|before| *before <= y);
        swaps += (ys.len() - at) as f64;
        ys.insert(at, y);
    }
    let tied_y = tied(&mut ys.chunk_by(|a, b| a == b).map(<[_]>::len));
    let score = all - tied_x - tied_y + tied_both - 2.0 * swaps;
    let tau = score / ((all - tied_x) * (all - tied_y)).sqrt();
    tau.is_finite().then(|| tau.clamp(-1.0, 1.0))
}

fn choose_two(n: usize) -> f64 {
    n as f64 * (n as f64 - 1.0) / 2.0
}

/// A statistic of paired values with its bootstrap interval: pairs are drawn with replacement, as many as there are; resamples
/// in which the statistic does not exist do not count. `None` if the sample itself has none.
#[must_use]
pub fn estimate(
    statistic: fn(&[f64], &[f64]) -> Option<f64>,
    x: &[f64],
    y: &[f64],
    seed: u64,
    stream: u64,
) -> Option<Estimate> {
    let value = statistic(x, y)?;
    let n = x.len();
    let mut values: Vec<f64> = (0..RESAMPLES)
        .filter_map(|sample| {
            let pick = |k: usize| {
                let at = sample * n as u64 + k as u64;
                ((Philox::uniform_53(seed, stream, at)[0] * n as f64) as usize).min(n - 1)
            };
            let (a, b): (Vec<f64>, Vec<f64>) = (0..n).map(pick).map(|i| (x[i], y[i])).unzip();
            statistic(&a, &b)
        })
        .collect();
    values.sort_by(f64::total_cmp);
    let (low, high) = (quantile(&values, 0.025), quantile(&values, 0.975));
    Some(Estimate {
        value,
        low: low.unwrap_or(value),
        high: high.unwrap_or(value),
    })
}
