//! Stable radix sort of (key, value) pairs (`kernels/sort.cl`).

use crate::base::error::Result;
use crate::device::tuning::status::SLOTS;
use crate::device::{Array, Kernel, Kernels, Real};
use crate::pipeline::buffers::SortBuffers;

/// The kernels and their scratch.
#[derive(Debug)]
pub struct Sort {
    histogram: Kernel,
    totals: Kernel,
    bins: Kernel,
    offsets: Kernel,
    scatter: Kernel,
    counts: Array<u32>,
    sums: Array<u32>,
}

impl Sort {
    /// Builds the kernels.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let names = [
            "sort_histogram",
            "sort_totals",
            "sort_bins",
            "sort_offsets",
            "sort_scatter",
        ];
        let [histogram, totals, bins, offsets, scatter] = kernels.build::<R, 5>("sort", names)?;
        let (device, tuning) = (kernels.device(), kernels.defines().tuning);
        let max_bins = 1usize << tuning.radix_bits;
        Ok(Self {
            histogram,
            totals,
            bins,
            offsets,
            scatter,
            counts: Array::zeros(device, "sort histogram", max_bins * tuning.chunks)?,
            sums: Array::zeros(device, "sort totals", max_bins)?,
        })
    }

    /// Number of passes for keys of `bits` bits: the one of the fewest bins and sweeps over at most `n` elements together.
    fn passes(&self, bits: u32, n: usize) -> u32 {
        let tuning = self.scatter.defines().tuning;
        let min = bits.div_ceil(tuning.radix_bits).max(1);
        let cost = |passes: u32| {
            let bins = 1usize << bits.div_ceil(passes);
            // Every element is read twice and written; every counter of a chunk and bin is zeroed, summed and rewritten.
            passes as usize * 3 * (n + tuning.chunks * bins)
        };
        (min..=bits.max(min))
            .min_by_key(|p| cost(*p))
            .unwrap_or(min)
    }

    /// Sorts as many elements as the slot `n_slot` of the status array says by the lowest `bits` bits of their keys.
    pub fn run(
        &self,
        elements: &mut SortBuffers,
        status: &Array<u32>,
        n_slot: u32,
        bits: u32,
    ) -> Result<()> {
        let passes = self.passes(bits, elements.keys[0].len());
        let per_pass = bits.div_ceil(passes).max(1);
        for pass in 0..passes {
            self.pass(elements, status, n_slot, pass, per_pass)?;
        }
        elements.sorted = passes as usize % 2;
        Ok(())
    }

    fn pass(
        &self,
        SortBuffers { keys, values, .. }: &SortBuffers,
        status: &Array<u32>,
        n_slot: u32,
        pass: u32,
        bits: u32,
    ) -> Result<()> {
        let (from, to) = (pass as usize % 2, (pass as usize + 1) % 2);
        let (shift, bins) = ((pass * bits) as usize, 1usize << bits);
        let (n_slot, chunks) = (n_slot as usize, self.scatter.chunks());
        let cells = chunks * bins;
        self.histogram
            .launch()
            .array(&keys[from], 1)
            .array(status, SLOTS)
            .uints([n_slot, chunks, shift, bins])
            .array(&self.counts, cells)
            .over_chunks([chunks, 1])?;
        self.totals
            .launch()
            .array(&self.counts, cells)
            .uints([chunks, bins])
            .array(&self.sums, bins)
            .over_items([bins, 1])?;
        self.bins
            .launch()
            .array(&self.sums, bins)
            .uints([bins])
            .once()?;
        self.offsets
            .launch()
            .array(&self.counts, cells)
            .uints([chunks, bins])
            .array(&self.sums, bins)
            .over_items([bins, 1])?;
        self.scatter
            .launch()
            .array(&keys[from], 1)
            .array(&values[from], 1)
            .array(status, SLOTS)
            .uints([n_slot, chunks, shift, bins])
            .array(&self.counts, cells)
            .array(&keys[to], 1)
            .array(&values[to], 1)
            .over_chunks([chunks, 1])
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
