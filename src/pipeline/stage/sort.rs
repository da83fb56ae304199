//! Stable radix sort of (key, value) pairs (`kernels/sort.cl`).

use crate::base::error::Result;
use crate::device::tuning::status::SLOTS;
use crate::device::{Array, Device, Kernel, Kernels, Real};

/// The sort stage with its scratch.
#[derive(Debug)]
pub struct Sort {
    histogram: Kernel,
    totals: Kernel,
    bins: Kernel,
    offsets: Kernel,
    scatter: Kernel,
    counts: Array<u32>,
    sums: Array<u32>,
    chunks: usize,
    radix_bits: u32,
    local: usize,
    coarse_local: usize,
}

/// Arguments of [`Sort::run`]: the elements lie in `keys[0]`, `values[0]`; the other pair is scratch.
#[derive(Debug)]
pub struct SortArgs<'a> {
    /// Keys, in and scratch \[n\].
    pub keys: [&'a Array<u32>; 2],
    /// Values, in and scratch \[n\].
    pub values: [&'a Array<u32>; 2],
    /// Status array.
    pub status: &'a Array<u32>,
    /// Slot of n.
    pub n_slot: u32,
    /// Bits of the keys that differ, from the lowest.
    pub bits: u32,
}

impl Sort {
    /// Builds the kernels.
    ///
    /// # Errors
    /// A build failure.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let [histogram, totals, bins, offsets, scatter] = kernels.build::<R, 5>(
            "sort",
            [
                "sort_histogram",
                "sort_totals",
                "sort_bins",
                "sort_offsets",
                "sort_scatter",
            ],
        )?;
        let tuning = kernels.defines().tuning;
        let device: &Device = kernels.device();
        let most = 1usize << tuning.radix_bits;
        Ok(Self {
            histogram,
            totals,
            bins,
            offsets,
            scatter,
            counts: Array::zeros(device, "sort histogram", most * tuning.chunks)?,
            sums: Array::zeros(device, "sort totals", most)?,
            chunks: tuning.chunks,
            radix_bits: tuning.radix_bits,
            local: tuning.local,
            coarse_local: tuning.coarse_local(),
        })
    }

    /// Passes for keys of `bits` bits: the fewest bins and sweeps over at most `n` elements together.
    fn passes(&self, bits: u32, n: usize) -> u32 {
        let least = bits.div_ceil(self.radix_bits).max(1);
        let cost = |passes: u32| {
            let bins = 1usize << bits.div_ceil(passes);
            // Every element is read twice and written; every counter of a chunk and bin is zeroed, summed and rewritten.
            passes as usize * 3 * (n + self.chunks * bins)
        };
        (least..=bits.max(least))
            .min_by_key(|p| cost(*p))
            .unwrap_or(least)
    }

    /// Enqueues the passes; answers which of the two pairs of arrays holds the result.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn run(&self, a: &SortArgs<'_>) -> Result<usize> {
        let passes = self.passes(a.bits, a.keys[0].len());
        let per_pass = a.bits.div_ceil(passes).max(1);
        for pass in 0..passes {
            let (from, to) = (pass as usize % 2, (pass as usize + 1) % 2);
            let (shift, bins) = (pass * per_pass, 1u32 << per_pass);
            let chunks = self.chunks as u32;
            let cells = self.chunks * bins as usize;
            self.histogram
                .launch()
                .array(a.keys[from], 1)
                .array(a.status, SLOTS)
                .value(a.n_slot)
                .value(chunks)
                .value(shift)
                .value(bins)
                .array(&self.counts, cells)
                .run([self.chunks, 1], [self.coarse_local, 1])?;
            self.totals
                .launch()
                .array(&self.counts, cells)
                .value(chunks)
                .value(bins)
                .array(&self.sums, bins as usize)
                .run([bins as usize, 1], [self.local, 1])?;
            self.bins
                .launch()
                .array(&self.sums, bins as usize)
                .value(bins)
                .run([1, 1], [1, 1])?;
            self.offsets
                .launch()
                .array(&self.counts, cells)
                .value(chunks)
                .value(bins)
                .array(&self.sums, bins as usize)
                .run([bins as usize, 1], [self.local, 1])?;
            self.scatter
                .launch()
                .array(a.keys[from], 1)
                .array(a.values[from], 1)
                .array(a.status, SLOTS)
                .value(a.n_slot)
                .value(chunks)
                .value(shift)
                .value(bins)
                .array(&self.counts, cells)
                .array(a.keys[to], 1)
                .array(a.values[to], 1)
                .run([self.chunks, 1], [self.coarse_local, 1])?;
        }
        Ok(passes as usize % 2)
    }
}

/// Positions of the keys in ascending order, equal keys in their old order.
#[must_use]
pub fn sort(keys: &[u32]) -> Vec<u32> {
    let mut order: Vec<u32> = (0..keys.len() as u32).collect();
    order.sort_by_key(|i| keys[*i as usize]);
    order
}
