//! Stable radix sort of (key, value) pairs (`kernels/sort.cl`).

use crate::base::constants::{SORT_BINS, SORT_BLOCK_BITS};
use crate::base::error::Result;
use crate::device::tuning::status::{self, SLOTS};
use crate::device::{Array, Kernels, Program, Real};
use crate::pipeline::buffers::SortBuffers;

/// Bits of the keys of [`Keys::depths`]. Depths are above 0, so that the highest is never set: without it there would be as many passes, four
/// of 8 bits or three of 12.
const BITS: u32 = 32;
/// Most elements that one work-item sorts on a device whose work-items are whole cores: a second core does not make up for the
/// launches that it takes (`docs/results/speed.md`).
const FEW: usize = 1 << 14;
/// Elements that a work-group sorts at least before there is another.
const PER_GROUP: usize = 1 << SORT_BLOCK_BITS;

/// Number and range of the keys to be sorted.
#[derive(Debug, Clone, Copy)]
pub struct Keys {
    /// Slot of the status array that holds the number of elements.
    pub counter: u32,
    /// Most elements that there may be.
    pub most: usize,
    /// Bits that keys differ in, from the lowest on.
    pub bits: u32,
}

impl Keys {
    /// Depths of the visible ones of `most` Gaussians.
    #[must_use]
    pub fn depths(most: usize) -> Self {
        Self::rows(most, BITS)
    }

    /// Keys of so many rows and bits, the status telling of all of them as visible ones.
    #[must_use]
    pub fn rows(most: usize, bits: u32) -> Self {
        Self {
            counter: status::VISIBLE,
            most,
            bits,
        }
    }

    /// Tiles of at most `most` pairs.
    #[must_use]
    pub fn tiles(most: usize, tiles: usize) -> Self {
        Self {
            counter: status::INTERSECTIONS,
            most,
            bits: tiles.next_power_of_two().ilog2().max(1),
        }
    }
}

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
        // One chunk has the digits of all passes, which are fewer than 32.
        let rows = tuning.chunks.max(BITS as usize);
        Ok(Self {
            program: kernels.build::<R>("sort")?,
            histogram: Array::zeros(device, "sort histogram", max_bins * rows)?,
            totals: Array::zeros(device, "sort totals", max_bins + 1)?,
        })
    }

    /// Number of passes: the one of the fewest bins and sweeps over all elements together.
    fn passes(&self, keys: &Keys, chunks: usize) -> u32 {
        let (tuning, bits) = (self.program.defines().tuning, keys.bits);
        let min = bits.div_ceil(tuning.radix_bits);
        if tuning.group_style {
            // The counters of a group are in local memory: fewer launches are expected to count for more.
            return min;
        }
        let cost = |passes: &u32| {
            let bins = 1usize << bits.div_ceil(*passes);
            // Every element is read twice and written; every counter of a chunk and bin is zeroed, summed and rewritten.
            *passes as usize * 3 * (keys.most + chunks * bins)
        };
        (min..=bits).min_by_key(cost).unwrap_or(min)
    }

    /// Chunks that the elements are cut into.
    pub fn chunks(&self, keys: &Keys) -> usize {
        let tuning = self.program.defines().tuning;
        match tuning.group_style {
            true => keys.most.div_ceil(PER_GROUP).clamp(1, tuning.chunks),
            false => tuning.chunks,
        }
    }

    /// Bins of a pass, and the array that has the elements of each chunk and bin, for who counts those of the first pass.
    pub fn first_pass(&self, keys: &Keys) -> (usize, &Array<u32>) {
        let passes = self.passes(keys, self.chunks(keys));
        (1 << keys.bits.div_ceil(passes), &self.histogram)
    }

    /// Sorts by key as many elements as the status array says.
    pub fn run(&self, elements: &mut SortBuffers, keys: &Keys, status: &Array<u32>) -> Result<()> {
        self.run_passes(elements, keys, status, None)
    }

    /// [`Sort::run`] in the group style, elements being cut into [`Sort::chunks`] that begin at these places for the first pass and counted for it
    /// ([`Sort::first_pass`]).
    pub fn run_counted(
        &self,
        elements: &mut SortBuffers,
        keys: &Keys,
        status: &Array<u32>,
        starts: &Array<u32>,
    ) -> Result<()> {
        self.run_passes(elements, keys, status, Some(starts))
    }

    fn run_passes(
        &self,
        elements: &mut SortBuffers,
        keys: &Keys,
        status: &Array<u32>,
        counted: Option<&Array<u32>>,
    ) -> Result<()> {
        let (program, tuning, most) = (&self.program, self.program.defines().tuning, keys.most);
        if most <= FEW && !tuning.group_style {
            self.run_few(elements, keys, status)?;
            // None at all are sorted both ways: warming up builds the kernels so.
            if most > 0 {
                return Ok(());
            }
        }
        let chunks = self.chunks(keys);
        let passes = self.passes(keys, chunks);
        let per_pass = keys.bits.div_ceil(passes);
        let bins = 1 << per_pass;
        for pass in 0..passes {
            let (from, shift) = (pass as usize % 2, (pass * per_pass) as usize);
            let over_keys = |kernel| {
                program
                    .launch(kernel)
                    .array(&elements.keys[from], most)
                    .array(status, SLOTS)
                    .uints([keys.counter as usize, chunks, shift, bins])
                    .array(&self.histogram, chunks * bins)
            };
            let starts = counted.filter(|_| pass == 0);
            if starts.is_none() {
                over_keys("sort_histogram").over_groups(chunks)?;
            }
            self.first_places(&self.histogram, [chunks, bins], &self.totals)?;
            let mut scatter = over_keys("sort_scatter");
            if tuning.group_style {
                // Any array if all chunks are as long.
                scatter = match starts {
                    Some(starts) => scatter.array(starts, chunks + 1).uints([1]),
                    None => scatter.array(&self.totals, 1).uints([0]),
                };
            }
            scatter
                .array(&self.totals, bins + 1)
                .array(&elements.values[from], most)
                .arrays([&elements.keys[1 - from], &elements.values[1 - from]], most)
                .over_groups(chunks)?;
        }
        elements.sorted = passes as usize % 2;
        Ok(())
    }

    /// All passes in one launch.
    fn run_few(&self, elements: &mut SortBuffers, keys: &Keys, status: &Array<u32>) -> Result<()> {
        let passes = self.passes(keys, 1);
        let bits = keys.bits.div_ceil(passes);
        let launch = self.program.launch("sort_few").array(status, SLOTS);
        let launch = launch.uints([keys.counter as usize, passes as usize, bits as usize]);
        let launch = launch.array(&self.histogram, (passes as usize) << bits);
        [0, 1]
            .into_iter()
            .fold(launch, |l, k| {
                l.arrays([&elements.keys[k], &elements.values[k]], keys.most)
            })
            .once()?;
        elements.sorted = passes as usize % 2;
        Ok(())
    }

    /// Turns the numbers of elements \[chunks, bins\] of each chunk and bin into those of the chunks before. Writes the first
    /// place of each bin, then the number of all elements, to `totals`; in the group style the number of elements of each bin.
    pub fn first_places(
        &self,
        histogram: &Array<u32>,
        [chunks, bins]: [usize; 2],
        totals: &Array<u32>,
    ) -> Result<()> {
        let launch = |kernel| {
            self.program
                .launch(kernel)
                .array(histogram, chunks * bins)
                .uints([chunks, bins])
                .array(totals, bins + 1)
        };
        match self.program.defines().tuning.group_style {
            true => launch("sort_totals").over_groups(bins.div_ceil(SORT_BINS as usize)),
            false => launch("sort_bins").once(),
        }
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
