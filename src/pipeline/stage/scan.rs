//! Exclusive prefix sums (`kernels/scan.cl`).

use crate::base::error::Result;
use crate::device::tuning::status::{INTERSECTIONS, SLOTS};
use crate::device::{Array, Launch, Program, Real};
use crate::pipeline::buffers::ViewBuffers;

/// Writes the sums of the pairs before each of `n` elements and the number of pairs to the status; more pairs than there is
/// room for raise the overflow flag.
pub fn sum_pairs<R: Real>(
    stage: &Program,
    view: &ViewBuffers<R>,
    n: usize,
    [values, sums]: [&Array<u32>; 2],
) -> Result<()> {
    over_values(stage, "scan_sums", values, n, &view.pair_sums).over_groups(stage.chunks())?;
    sum_counted(stage, view, n, [values, sums])
}

/// The same where the sums of the chunks are in `pair_sums` already.
pub fn sum_counted<R: Real>(
    stage: &Program,
    view: &ViewBuffers<R>,
    n: usize,
    [values, sums]: [&Array<u32>; 2],
) -> Result<()> {
    over_values(stage, "scan_write", values, n, &view.pair_sums)
        .array(sums, n)
        .array(&view.status, SLOTS)
        .uints([INTERSECTIONS as usize, view.capacity])
        .over_groups(stage.chunks())
}

fn over_values<'k>(
    stage: &'k Program,
    kernel: &'static str,
    values: &Array<u32>,
    n: usize,
    chunk_sums: &Array<u32>,
) -> Launch<'k> {
    let chunks = stage.chunks();
    stage
        .launch(kernel)
        .array(values, n)
        .uints([n, chunks])
        .array(chunk_sums, chunks)
}

// Definition in f64.

/// Exclusive prefix sums and the total.
#[must_use]
pub fn scan(values: &[u32]) -> (Vec<u32>, u64) {
    let mut total = 0u64;
    let sums = values
        .iter()
        .map(|v| {
            let before = total as u32;
            total += u64::from(*v);
            before
        })
        .collect();
    (sums, total)
}
