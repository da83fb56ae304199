//! Exclusive prefix sums (`kernels/scan.cl`).

use crate::base::error::Result;
use crate::device::tuning::status::{INTERSECTIONS, SLOTS};
use crate::device::{Array, Program, Real};
use crate::pipeline::buffers::ViewBuffers;

/// Writes the sums of the pairs before each of `n` elements and the number of pairs to the status; more pairs than there is
/// room for raise the overflow flag.
pub fn sum_pairs<R: Real>(
    stage: &Program,
    view: &ViewBuffers<R>,
    n: usize,
    [values, sums]: [&Array<u32>; 2],
) -> Result<()> {
    let chunks = stage.chunks();
    let over_values = |kernel| {
        stage
            .launch(kernel)
            .array(values, n)
            .uints([n, chunks])
            .array(&view.chunk_sums, chunks)
    };
    over_values("scan_sums").over_groups(chunks)?;
    over_values("scan_write")
        .array(sums, n)
        .array(&view.status, SLOTS)
        .uints([INTERSECTIONS as usize, view.capacity])
        .over_groups(chunks)
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
