//! Stable radix sort of (key, value) pairs (`kernels/sort.cl`).

use crate::base::error::Result;
use crate::device::tuning::status::SLOTS;
use crate::device::{Array, Kernels, Program, Real};
use crate::pipeline::buffers::SortBuffers;

/// The kernels and their scratch.
#[derive(Debug)]
pub struct Sort {
    program: Program,
    histogram: Array<u32>,
    totals: Array<u32>,
}

impl Sort {
    /// Builds the kernels.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let (device, tuning) = (kernels.device(), kernels.defines().tuning);
        let max_bins = 1usize << tuning.radix_bits;
        Ok(Self {
            program: kernels.build::<R>("sort")?,
            histogram: Array::zeros(device, "sort histogram", max_bins * tuning.chunks)?,
            totals: Array::zeros(device, "sort totals", max_bins)?,
        })
    }

    /// Number of passes for keys of `bits` bits: the one of the fewest bins and sweeps over at most `n` elements together.
    fn passes(&self, bits: u32, n: usize) -> u32 {
        let tuning = self.program.defines().tuning;
        let min = bits.div_ceil(tuning.radix_bits).max(1);
        let cost = |passes: &u32| {
            let bins = 1usize << bits.div_ceil(*passes);
            // Every element is read twice and written; every counter of a chunk and bin is zeroed, summed and rewritten.
            *passes as usize * 3 * (n + tuning.chunks * bins)
        };
        (min..=bits.max(min)).min_by_key(cost).unwrap_or(min)
    }

    /// Sorts as many elements as the status array says by the lowest `bits` bits of their keys.
    pub fn run(&self, elements: &mut SortBuffers, status: &Array<u32>, bits: u32) -> Result<()> {
        let (program, chunks) = (&self.program, self.program.chunks());
        let passes = self.passes(bits, elements.keys[0].len());
        let per_pass = bits.div_ceil(passes).max(1);
        let bins = 1 << per_pass;
        for pass in 0..passes {
            let (from, shift) = (pass as usize % 2, (pass * per_pass) as usize);
            let over_keys = |kernel| {
                program
                    .launch(kernel)
                    .array(&elements.keys[from], 1)
                    .array(status, SLOTS)
                    .uints([elements.count_slot as usize, chunks, shift, bins])
                    .array(&self.histogram, chunks * bins)
            };
            let over_bins = |kernel| {
                program
                    .launch(kernel)
                    .array(&self.histogram, chunks * bins)
                    .uints([chunks, bins])
                    .array(&self.totals, bins)
                    .over_items([bins, 1])
            };
            over_keys("sort_histogram").over_chunks([chunks, 1])?;
            over_bins("sort_totals")?;
            let totals = program.launch("sort_bins").array(&self.totals, bins);
            totals.uints([bins]).once()?;
            over_bins("sort_offsets")?;
            over_keys("sort_scatter")
                .array(&elements.values[from], 1)
                .arrays([&elements.keys[1 - from], &elements.values[1 - from]], 1)
                .over_chunks([chunks, 1])?;
        }
        elements.sorted = passes as usize % 2;
        Ok(())
    }
}

// Definition in f64.

/// Positions of the keys in ascending order, equal keys in their old order.
#[must_use]
pub fn sort(keys: &[u32]) -> Vec<u32> {
    let mut order: Vec<u32> = (0..keys.len() as u32).collect();
    order.sort_by_key(|i| keys[*i as usize]);
    order
}
