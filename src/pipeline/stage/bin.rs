//! Visible Gaussians → (tile, Gaussian) pairs → ranges per tile (`kernels/bin.cl`).

use crate::base::constants::TILE_SLACK;
use crate::base::error::Result;
use crate::device::tuning::status::SLOTS;
use crate::device::{Array, Kernel, Kernels, Launch, Real, Record};
use crate::pipeline::reference::{Camera64, TILE};
use crate::pipeline::stage::project::Record64;

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

/// Whether the smallest value of the record's quadratic form over the tile's rectangle of pixel centres is within its
/// reach. The minimum of a convex form over a rectangle lies at its centre or on the boundary; here every edge is looked
/// at, whether it faces the mean or not.
#[must_use]
pub fn touches(g: &Record64, tx: i32, ty: i32, alpha_min: f64) -> bool {
    let inside = |k: usize, t: i32| g.bounds[k][0] / TILE <= t && t <= g.bounds[k][1] / TILE;
    if !inside(0, tx) || !inside(1, ty) {
        return false;
    }
    let low = [tx, ty].map(|t| f64::from(t * TILE) + 0.5);
    let x = [low[0] - g.mean[0], low[0] - g.mean[0] + f64::from(TILE - 1)];
    let y = [low[1] - g.mean[1], low[1] - g.mean[1] + f64::from(TILE - 1)];
    let q = |dx: f64, dy: f64| g.a * (dx - g.r * dy).powi(2) + g.c * dy * dy;
    let mut least = f64::INFINITY;
    if x[0] <= 0.0 && x[1] >= 0.0 && y[0] <= 0.0 && y[1] >= 0.0 {
        least = 0.0;
    }
    for dx in x {
        least = least.min(q(
            dx,
            (g.a * g.r * dx / (g.a * g.r * g.r + g.c)).clamp(y[0], y[1]),
        ));
    }
    for dy in y {
        least = least.min(q((g.r * dy).clamp(x[0], x[1]), dy));
    }
    least <= g.lo - alpha_min.log2() + TILE_SLACK
}

/// Gaussians of each tile (row major), sorted by the f32 depth, ties by index.
#[must_use]
pub fn bin(records: &[Option<Record64>], camera: &Camera64, alpha_min: f64) -> Vec<Vec<u32>> {
    let [tiles_x, tiles_y] = camera.tiles();
    let mut order: Vec<(f32, u32)> = records
        .iter()
        .enumerate()
        .filter_map(|(i, r)| r.as_ref().map(|g| (g.depth as f32, i as u32)))
        .collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut tiles = vec![Vec::new(); (tiles_x * tiles_y) as usize];
    for (_, i) in order {
        let Some(g) = &records[i as usize] else {
            continue;
        };
        for ty in g.bounds[1][0] / TILE..=g.bounds[1][1] / TILE {
            for tx in g.bounds[0][0] / TILE..=g.bounds[0][1] / TILE {
                if touches(g, tx, ty, alpha_min) {
                    tiles[(ty * tiles_x + tx) as usize].push(i);
                }
            }
        }
    }
    tiles
}
