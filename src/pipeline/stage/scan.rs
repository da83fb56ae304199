//! Exclusive prefix sums (`kernels/scan.cl`).

use crate::base::error::Result;
use crate::device::tuning::status::{INTERSECTIONS, SLOTS};
use crate::device::{Array, Launch, Program};

/// Sums of the chunks of what is added up, the status that gets the total, and the total beyond which it raises the overflow flag instead.
#[derive(Debug, Clone, Copy)]
pub struct Totals<'a> {
    /// One number for each chunk.
    pub chunk_sums: &'a Array<u32>,
    /// Counters.
    pub status: &'a Array<u32>,
    /// The largest total.
    pub most: usize,
}

/// Writes the sums of the pairs before each of `n` elements and the number of pairs to the status; more pairs than there is
/// room for raise the overflow flag.
pub fn sum_pairs(
    stage: &Program,
    totals: &Totals<'_>,
    n: usize,
    [values, sums]: [&Array<u32>; 2],
) -> Result<()> {
    over_values(stage, "scan_sums", values, n, totals.chunk_sums).over_groups(stage.chunks())?;
    sum_counted(stage, totals, n, [values, sums])
}

/// The same where the sums of the chunks are there already.
pub fn sum_counted(
    stage: &Program,
    totals: &Totals<'_>,
    n: usize,
    [values, sums]: [&Array<u32>; 2],
) -> Result<()> {
    over_values(stage, "scan_write", values, n, totals.chunk_sums)
        .array(sums, n)
        .array(totals.status, SLOTS)
        .uints([INTERSECTIONS as usize, totals.most])
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
