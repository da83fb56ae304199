//! Exclusive prefix sums (`kernels/scan.cl`).

use crate::base::error::Result;
use crate::device::tuning::status::{INTERSECTIONS, SLOTS, VISIBLE};
use crate::device::{Array, Program, Real};
use crate::pipeline::buffers::ViewBuffers;
use crate::pipeline::launch::Arguments;

/// Number of elements.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Count {
    /// The value that this slot of the status array holds when the kernel runs.
    Slot(u32),
    /// A number that the host knows.
    Known(usize),
}

/// Writes the sums of the pairs before each of `n` elements and the number of pairs to the status; more pairs than there is
/// room for raise the overflow flag.
pub fn sum_pairs<R: Real>(
    stage: &Program,
    view: &ViewBuffers<R>,
    n: Count,
    [values, sums]: [&Array<u32>; 2],
) -> Result<()> {
    let chunks = stage.chunks();
    let [slot, known] = match n {
        Count::Slot(slot) => [slot as usize, 0],
        Count::Known(n) => [SLOTS, n],
    };
    let over_values = |kernel| {
        stage
            .launch(kernel)
            .array(values, 1)
            .status(view)
            .uints([slot, known, chunks])
            .array(&view.chunk_sums, chunks)
    };
    over_values("scan_sums").over_chunks([chunks, 1])?;
    sum_chunks(stage, view, INTERSECTIONS, view.intersection_capacity())?;
    over_values("scan_write")
        .array(sums, 1)
        .over_chunks([chunks, 1])
}

/// Writes the sums of the visible Gaussians before each chunk and their number to the status.
pub fn sum_visible<R: Real>(stage: &Program, view: &ViewBuffers<R>) -> Result<()> {
    sum_chunks(stage, view, VISIBLE, view.keys.len())
}

fn sum_chunks<R: Real>(
    stage: &Program,
    view: &ViewBuffers<R>,
    slot: u32,
    capacity: usize,
) -> Result<()> {
    stage
        .launch("scan_chunks")
        .array(&view.chunk_sums, stage.chunks())
        .uints([stage.chunks()])
        .status(view)
        .uints([slot as usize, capacity])
        .once()
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
