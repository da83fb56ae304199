//! The amount of work of a view: pixel lanes counted from the device's own lists, bytes estimated from array shapes.

use crate::base::constants::SUMS;
use crate::base::error::Result;
use crate::device::tuning::{Tuning, status};
use crate::device::{Projected, Real};
use crate::pipeline::forward::Renderer;
use crate::pipeline::stage::sort::Keys;

/// The stages of an iteration, in the order of the tables.
pub const STAGES: [&str; 8] = [
    "project",
    "bin",
    "scan",
    "sort",
    "splat",
    "loss",
    "splat_grad",
    "project_grad",
];

/// FLOP of a lane in the innermost block of `kernels/splat.cl`, a multiply-add counting two and comparisons, selections and
/// integers nothing: u 3, exponent 6, 2^x 14, weight 1, three channels 6, transmittance 1.
pub const SPLAT_FLOP: f64 = 31.0;
/// FLOP of a lane of `kernels/splat_grad.cl`, counted alike: u 3, exponent 6, 2^x 14, weight 1, colour along the gradient 5, its share 1, what
/// is behind 1, α / (1 − α) 2, transmittance 1, g 2, its product with u 1, six sums 11. Not counted: the sums over the lanes and with dy.
pub const SPLAT_GRAD_FLOP: f64 = 48.0;

/// Tile lists that the splat kernels read in one view.
#[derive(Debug, Clone, Default)]
pub struct TileWork {
    /// Packed pixel bounds in x and y of each Gaussian, as in [`Projected`]; of culled ones, anything.
    pub bounds: Vec<[u32; 2]>,
    /// Gaussians of each tile up to the last one looked at, front to back.
    pub tiles: Vec<Vec<u32>>,
    /// Tiles per row.
    pub tiles_x: usize,
    /// Visible Gaussians.
    pub visible: usize,
    /// Pairs, looked at or not.
    pub pairs: usize,
}

impl TileWork {
    /// Reads the lists of the view that `renderer` rendered last back from the device.
    pub fn read<R: Real>(renderer: &Renderer<R>) -> Result<Self> {
        let frame = &renderer.frame;
        let counters = frame.status.to_vec()?;
        let pairs = counters[status::INTERSECTIONS as usize] as usize;
        let size = frame.camera.image();
        let [tiles_x, tiles] = [size.tiles()[0], size.tile_count()];
        let order = frame.order().read(0, pairs)?;
        let owner = frame.isect_owner.read(0, pairs)?;
        let start = frame.tile_start.read(0, tiles)?;
        let used = frame.tile_used.read(0, tiles)?;
        let of_tile = |(first, n): (&u32, &u32)| {
            let slots = &order[*first as usize..(*first + *n) as usize];
            slots.iter().map(|slot| owner[*slot as usize]).collect()
        };
        let bounds = |r: &Projected<R>| [r.bx, r.by];
        Ok(Self {
            bounds: frame
                .records
                .read(0, frame.count)?
                .iter()
                .map(bounds)
                .collect(),
            tiles: start.iter().zip(&used).map(of_tile).collect(),
            tiles_x,
            visible: counters[status::VISIBLE as usize] as usize,
            pairs,
        })
    }

    /// Pairs looked at.
    #[must_use]
    pub fn used(&self) -> usize {
        self.tiles.iter().map(Vec::len).sum()
    }

    /// Pixel lanes that the kernels of this tuning evaluate: the blocks that a Gaussian's pixel bounds reach (`block_range`
    /// in `kernels/pixels.clh`), or the pixels within the bounds where a work-group takes a tile.
    #[must_use]
    pub fn lanes(&self, tuning: &Tuning) -> u64 {
        let block = [tuning.block_width, tuning.vector_width / tuning.block_width];
        let blocks = |bounds: u32, tile: usize, k: usize| -> u64 {
            let (first, block) = (tile as i64 * i64::from(tuning.tile), i64::from(block[k]));
            let low = (i64::from(bounds & 0xffff) - first).max(0) / block;
            let high = (i64::from(bounds >> 16) - first).min(i64::from(tuning.tile) - 1) / block;
            (high - low + 1).max(0) as u64
        };
        let mut total = 0;
        for (tile, list) in self.tiles.iter().enumerate() {
            for gaussian in list {
                let [bx, by] = self.bounds[*gaussian as usize];
                total += blocks(bx, tile % self.tiles_x, 0) * blocks(by, tile / self.tiles_x, 1);
            }
        }
        total * u64::from(tuning.vector_width)
    }
}

/// Counts that the byte estimates depend on; means over views.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Load {
    /// Gaussians.
    pub gaussians: f64,
    /// Parameter planes in use.
    pub planes: f64,
    /// Visible Gaussians.
    pub visible: f64,
    /// Pairs.
    pub pairs: f64,
    /// Pixels of the padded image.
    pub pixels: f64,
    /// Tiles.
    pub tiles: f64,
    /// Radix passes of the sort by depth.
    pub passes: f64,
    /// Those of the sort of pairs by tile, none where every pair goes straight to its place.
    pub pair_passes: f64,
    /// Pixel lanes.
    pub lanes: f64,
}

impl Load {
    /// Fewest radix passes of the sorts by depth and by tile.
    #[must_use]
    pub fn passes(tuning: &Tuning, tiles: usize) -> [f64; 2] {
        let of = |keys: Keys| f64::from(keys.bits.div_ceil(tuning.radix_bits));
        let sorts_pairs = f64::from(u8::from(tuning.group_style));
        [of(Keys::depths(0)), sorts_pairs * of(Keys::tiles(0, tiles))]
    }

    /// FLOP per lane of a splat stage; `None` of the others.
    #[must_use]
    pub fn flop_per_lane(stage: &str) -> Option<f64> {
        match stage {
            "splat" => Some(SPLAT_FLOP),
            "splat_grad" => Some(SPLAT_GRAD_FLOP),
            _ => None,
        }
    }

    /// Bytes that a stage must move in f32: every input read and every output written once per launch, scratch that fits a
    /// cache (chunk sums, histograms) and what the drivers fetch besides left out. 0 for the splat stages.
    #[must_use]
    pub fn bytes(&self, stage: &str) -> f64 {
        debug_assert!(STAGES.contains(&stage));
        let (real, uint) = (size_of::<f32>() as f64, size_of::<u32>() as f64);
        let record = size_of::<Projected<f32>>() as f64;
        let (n, v, p) = (self.gaussians, self.visible, self.pairs);
        match stage {
            // Geometry of all, colour of the visible; keys and pair counts of all, records of the visible.
            "project" => {
                n * (11.0 * real + 2.0 * uint) + v * ((self.planes - 11.0) * real + record)
            }
            // Keys twice and a compacted (key, index); records, indices, counts and covers; indices and covers again, and again
            // with first slots, into pairs: Gaussian and slot, and the tile if they are to be sorted.
            "bin" => {
                let compact = 2.0 * n * uint + 2.0 * v * uint;
                let count = v * (record + 4.0 * uint);
                let each = if self.pair_passes > 0.0 { 3.0 } else { 2.0 };
                let emit = v * (3.0 + 4.0) * uint + each * p * uint;
                compact + count + emit
            }
            // Counts read twice, first slots written.
            "scan" => 3.0 * n * uint,
            // A pass reads the keys for the histogram, then keys and values, and writes both; first pairs of the tiles.
            "sort" => {
                let elements = self.passes * v + self.pair_passes * p;
                (elements * 5.0 + self.tiles) * uint
            }
            // Forward: render and photo in, nine maps out. Backward: maps, render and photo in, gradient out.
            "loss" => self.pixels * ((3.0 + 9.0 + 9.0 + 3.0 + 3.0) * real + 6.0),
            // Parameters and both moments in and out; pairs' sums, counts and first slots in.
            "project_grad" => n * (6.0 * self.planes * real + 2.0 * uint) + p * SUMS as f64 * real,
            _ => 0.0,
        }
    }
}
