//! Exclusive prefix sums (`kernels/scan.cl`).

use crate::base::error::Result;
use crate::device::tuning::status::{INTERSECTIONS, SLOTS, VISIBLE};
use crate::device::{Array, Kernel, Kernels, Launch, Real};
use crate::pipeline::buffers::ViewBuffers;
use crate::pipeline::launch::Arguments;

/// The kernels.
#[derive(Debug)]
pub struct Scan {
    sums: Kernel,
    chunks: Kernel,
    write: Kernel,
}

/// Number of elements.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Count {
    /// The value that this slot of the status array holds when the kernel runs.
    Slot(u32),
    /// A number that the host knows.
    Known(usize),
}

impl Scan {
    /// Builds the kernels.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let names = ["scan_sums", "scan_chunks", "scan_write"];
        let [sums, chunks, write] = kernels.build::<R, 3>("scan", names)?;
        Ok(Self {
            sums,
            chunks,
            write,
        })
    }

    /// Writes the sums of the pairs before each of `n` elements to `out` and the number of pairs to the status; more pairs
    /// than there is room for raise the overflow flag.
    pub fn pairs<R: Real>(
        &self,
        view: &ViewBuffers<R>,
        values: &Array<u32>,
        n: Count,
        out: &Array<u32>,
    ) -> Result<()> {
        let (slot, known) = match n {
            Count::Slot(slot) => (slot as usize, 0),
            Count::Known(n) => (SLOTS, n),
        };
        with_values(&self.sums, view, values, slot, known).over_chunks([self.sums.chunks(), 1])?;
        self.totals(view, INTERSECTIONS, view.intersection_capacity())?;
        with_values(&self.write, view, values, slot, known)
            .array(out, 1)
            .over_chunks([self.write.chunks(), 1])
    }

    /// Writes the sums of the visible Gaussians before each chunk and their number to the status.
    pub fn visible<R: Real>(&self, view: &ViewBuffers<R>) -> Result<()> {
        self.totals(view, VISIBLE, view.keys.len())
    }

    fn totals<R: Real>(&self, view: &ViewBuffers<R>, slot: u32, capacity: usize) -> Result<()> {
        let chunks = self.chunks.chunks();
        self.chunks
            .launch()
            .array(&view.chunk_sums, chunks)
            .uints([chunks])
            .status(view)
            .uints([slot as usize, capacity])
            .once()
    }
}

/// The arguments that both sweeps over the values begin with.
fn with_values<'k, R: Real>(
    kernel: &'k Kernel,
    view: &ViewBuffers<R>,
    values: &Array<u32>,
    slot: usize,
    known: usize,
) -> Launch<'k> {
    let chunks = kernel.chunks();
    kernel
        .launch()
        .array(values, 1)
        .status(view)
        .uints([slot, known, chunks])
        .array(&view.chunk_sums, chunks)
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
