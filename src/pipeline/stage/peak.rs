//! The device at its best: fused multiply-adds in registers, and a copy through memory (`kernels/peak.cl`).

use crate::base::constants::PEAK_CHAINS;
use crate::base::error::Result;
use crate::device::{Array, Program, Real};

/// Smallest number of values that a group of the copy moves on a CPU.
const GROUP_LANES: usize = 1024;

/// FLOP of one launch of [`multiply_add`] (a multiply-add is two).
#[must_use]
pub fn flop(stage: &Program, items: usize, steps: u32) -> f64 {
    2.0 * f64::from(PEAK_CHAINS) * stage.lanes() as f64 * items as f64 * f64::from(steps)
}

/// Runs the chains x → a·x + b for `steps` steps in each of `items` work-items and writes the sum of each lane to `out`.
pub fn multiply_add<R: Real>(
    stage: &Program,
    items: usize,
    steps: u32,
    factors: [f64; 2],
    out: &Array<R>,
) -> Result<()> {
    // A CPU's thread takes one work-item at a time, as in the splat kernels.
    let local = stage.defines().tuning.run_local();
    stage
        .launch("peak_fma")
        .uints([items, steps as usize])
        .reals::<R>(factors)
        .array(out, items * stage.lanes())
        .run([items, 1], [local, 1])
}

/// Copies as many whole vectors as `from` holds.
pub fn copy<R: Real>(stage: &Program, from: &Array<R>, to: &Array<R>) -> Result<()> {
    let (tuning, lanes) = (stage.defines().tuning, stage.lanes());
    // A CPU's thread takes a whole group: one large enough that starting it costs nothing.
    let group = tuning.local.max(GROUP_LANES / lanes);
    let local = match tuning.group_style {
        true => tuning.local,
        false => group.min(stage.info().max_work_group.max(1)),
    };
    let vectors = from.len() / lanes;
    stage
        .launch("peak_copy")
        .array(from, vectors * lanes)
        .uints([vectors])
        .array(to, vectors * lanes)
        .run([vectors, 1], [local, 1])
}

// Definition in f64.

/// Sum of `chains` chains that go x → a·x + b `steps` times from 1, 2, 3 …
#[must_use]
pub fn fma_chains(chains: u32, steps: u32, a: f64, b: f64) -> f64 {
    (1..=chains)
        .map(|c| (0..steps).fold(f64::from(c), |x, _| a.mul_add(x, b)))
        .sum()
}
