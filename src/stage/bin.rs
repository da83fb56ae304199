//! Visible Gaussians → (tile, Gaussian) pairs → ranges per tile (`kernels/bin.cl`).

use crate::error::Result;
use crate::gpu::tuning::status::SLOTS;
use crate::gpu::{Array, Kernel, Kernels, Launch, Real, Record};

/// The bin stage.
#[derive(Debug)]
pub struct Bin {
    visible: Kernel,
    compact: Kernel,
    count: Kernel,
    emit: Kernel,
    ranges: Kernel,
    chunks: usize,
    batch: usize,
    batch_local: usize,
    local: usize,
    coarse_local: usize,
    masked: bool,
}

/// Arguments of [`Bin::count`] and [`Bin::emit`].
#[derive(Debug)]
pub struct BinArgs<'a, R: Real> {
    /// Records \[count\].
    pub records: &'a Array<Record<R>>,
    /// Gaussian indices in depth order \[visible\].
    pub visible: &'a Array<u32>,
    /// Gaussians (upper bound of the visible ones).
    pub count: usize,
    /// Status array.
    pub status: &'a Array<u32>,
    /// Tiles per row.
    pub tiles_x: u32,
    /// Tiles that get pairs \[tiles\], 1 or 0; none: all of them. Of effect for photos with masks alone.
    pub live: Option<&'a Array<u32>>,
    /// Tiles of each visible Gaussian \[visible\], written by [`Bin::count`].
    pub counts: &'a Array<u32>,
    /// The same counts by Gaussian \[count\], written by [`Bin::count`] where there are any.
    pub pair_counts: &'a Array<u32>,
    /// Which tiles those are, if they are few \[visible, 2\], written by [`Bin::count`].
    pub cover: &'a Array<u32>,
}

/// What [`Bin::emit`] goes by and writes.
#[derive(Debug)]
pub struct EmitArgs<'a> {
    /// Exclusive sums of the counts in depth order \[visible\].
    pub offsets: &'a Array<u32>,
    /// Exclusive sums of the counts by Gaussian: its first slot \[count\].
    pub pair_start: &'a Array<u32>,
    /// Out \[pairs\]: tile, in depth order.
    pub tile_keys: &'a Array<u32>,
    /// Out \[pairs\]: slot, in depth order.
    pub slots: &'a Array<u32>,
    /// Out \[pairs\]: Gaussian, by slot.
    pub pair_owner: &'a Array<u32>,
}

impl Bin {
    /// Builds the kernels.
    ///
    /// # Errors
    /// A build failure.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let [visible, compact, count, emit, ranges] = kernels.build::<R, 5>(
            "bin",
            [
                "bin_visible",
                "bin_compact",
                "bin_count",
                "bin_emit",
                "bin_ranges",
            ],
        )?;
        let tuning = kernels.defines().tuning;
        Ok(Self {
            visible,
            compact,
            count,
            emit,
            ranges,
            chunks: tuning.chunks,
            batch: tuning.batch(),
            batch_local: tuning.batch_local(),
            local: tuning.local,
            coarse_local: tuning.coarse_local(),
            masked: kernels.defines().masked(),
        })
    }

    /// Counts the visible Gaussians per chunk.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn visible(&self, keys: &Array<u32>, count: usize, sums: &Array<u32>) -> Result<()> {
        self.visible
            .launch()
            .array(keys, count)
            .value(count as u32)
            .value(self.chunks as u32)
            .array(sums, self.chunks)
            .run([self.chunks, 1], [self.coarse_local, 1])
    }

    /// Writes keys and indices of the visible Gaussians.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn compact(
        &self,
        keys: &Array<u32>,
        count: usize,
        sums: &Array<u32>,
        visible_keys: &Array<u32>,
        visible: &Array<u32>,
    ) -> Result<()> {
        self.compact
            .launch()
            .array(keys, count)
            .value(count as u32)
            .value(self.chunks as u32)
            .array(sums, self.chunks)
            .array(visible_keys, count)
            .array(visible, count)
            .run([self.chunks, 1], [self.coarse_local, 1])
    }

    /// The arguments that both walks over tiles begin with.
    fn with_records<'k, R: Real>(&self, kernel: &'k Kernel, a: &BinArgs<'_, R>) -> Launch<'k> {
        let launch = kernel
            .launch()
            .array(a.records, a.count)
            .array(a.visible, a.count)
            .array(a.status, SLOTS)
            .value(a.tiles_x);
        if self.masked {
            let live = a.live.unwrap_or(a.status);
            launch.array(live, 1).value(i32::from(a.live.is_some()))
        } else {
            launch
        }
    }

    /// Counts the tiles of each visible Gaussian.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn count<R: Real>(&self, a: &BinArgs<'_, R>) -> Result<()> {
        self.with_records(&self.count, a)
            .array(a.counts, a.count)
            .array(a.cover, 2 * a.count)
            .array(a.pair_counts, a.count)
            .run([a.count.div_ceil(self.batch), 1], [self.batch_local, 1])
    }

    /// Writes the pairs.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn emit<R: Real>(&self, a: &BinArgs<'_, R>, out: &EmitArgs<'_>) -> Result<()> {
        self.with_records(&self.emit, a)
            .array(a.cover, 2 * a.count)
            .array(out.offsets, a.count)
            .array(out.pair_start, a.count)
            .array(out.tile_keys, 1)
            .array(out.slots, 1)
            .array(out.pair_owner, 1)
            .run([a.count.div_ceil(self.batch), 1], [self.batch_local, 1])
    }

    /// First pair of each tile (`tiles + 1` values) in the sorted keys.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn ranges(
        &self,
        tile_keys: &Array<u32>,
        status: &Array<u32>,
        tiles: usize,
        tile_start: &Array<u32>,
    ) -> Result<()> {
        self.ranges
            .launch()
            .array(tile_keys, 1)
            .array(status, SLOTS)
            .value(tiles as u32)
            .array(tile_start, tiles + 1)
            .run([tiles + 1, 1], [self.local, 1])
    }
}
