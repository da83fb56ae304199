//! Visible Gaussians → (tile, Gaussian) pairs → ranges of pairs per tile (`kernels/bin.cl`).

use crate::base::constants::TILE_SLACK;
use crate::base::error::Result;
use crate::device::{CameraArg, Kernels, Launch, Program, Real};
use crate::pipeline::buffers::ViewBuffers;
use crate::pipeline::launch::Arguments;
use crate::pipeline::reference::{Camera64, TILE};
use crate::pipeline::stage::project::Projected64;

/// The kernels.
#[derive(Debug)]
pub struct Bin(Program);

impl Bin {
    /// Builds the kernels.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        kernels.build::<R>("bin").map(Self)
    }

    /// Counts the visible ones of `count` Gaussians in each chunk.
    pub fn visible<R: Real>(&self, view: &ViewBuffers<R>, count: usize) -> Result<()> {
        self.over_keys("bin_visible", view, count)
            .over_chunks([self.0.chunks(), 1])
    }

    /// Writes keys and indices of the visible ones of `count` Gaussians.
    pub fn compact<R: Real>(&self, view: &ViewBuffers<R>, count: usize) -> Result<()> {
        self.over_keys("bin_compact", view, count)
            .arrays([&view.visible.keys[0], &view.visible.values[0]], count)
            .over_chunks([self.0.chunks(), 1])
    }

    /// Counts the tiles of each visible Gaussian, those of a masked photo in which nothing counts left out if `active_only`.
    pub fn count<R: Real>(
        &self,
        view: &ViewBuffers<R>,
        camera: &CameraArg<R>,
        count: usize,
        active_only: bool,
    ) -> Result<()> {
        self.over_records("bin_count", view, camera, count, active_only)
            .arrays([&view.counts, &view.isect_counts], count)
            .over_batches(count)
    }

    /// Writes the pairs that [`Bin::count`] counted.
    pub fn emit<R: Real>(
        &self,
        view: &ViewBuffers<R>,
        camera: &CameraArg<R>,
        count: usize,
        active_only: bool,
    ) -> Result<()> {
        self.over_records("bin_emit", view, camera, count, active_only)
            .arrays([&view.offsets, &view.isect_start], count)
            .arrays([&view.order.keys[0], &view.order.values[0]], 1)
            .array(&view.isect_owner, 1)
            .over_batches(count)
    }

    /// Finds the first of the sorted pairs of each tile.
    pub fn ranges<R: Real>(&self, view: &ViewBuffers<R>, camera: &CameraArg<R>) -> Result<()> {
        let tiles = camera.tile_count();
        self.0
            .launch("bin_ranges")
            .array(view.order.sorted_keys(), 1)
            .status(view)
            .uints([tiles])
            .array(&view.tile_start, tiles + 1)
            .over_items([tiles + 1, 1])
    }

    /// A sweep over the keys of all Gaussians.
    fn over_keys<R: Real>(
        &self,
        kernel: &'static str,
        view: &ViewBuffers<R>,
        count: usize,
    ) -> Launch<'_> {
        let chunks = self.0.chunks();
        self.0
            .launch(kernel)
            .array(&view.keys, count)
            .uints([count, chunks])
            .array(&view.chunk_sums, chunks)
    }

    /// A walk over the tiles of the visible Gaussians.
    fn over_records<R: Real>(
        &self,
        kernel: &'static str,
        view: &ViewBuffers<R>,
        camera: &CameraArg<R>,
        count: usize,
        active_only: bool,
    ) -> Launch<'_> {
        let mut launch = self
            .0
            .launch(kernel)
            .array(&view.records, count)
            .array(view.visible.sorted_values(), count)
            .status(view)
            .uints([camera.tiles[0] as usize]);
        if self.0.defines().masked() {
            let active_tiles = if active_only {
                &view.active_tiles
            } else {
                &view.status
            };
            launch = launch.array(active_tiles, 1).value(i32::from(active_only));
        }
        launch.array(&view.cover, 2 * count)
    }
}

// Definition in f64.

/// True if the smallest value of the projected Gaussian's quadratic form over the tile's rectangle of pixel centres is within its
/// reach. The minimum of a convex form over a rectangle lies at its centre or on the boundary; here every edge is looked
/// at, whether it faces the mean or not.
#[must_use]
pub fn touches(g: &Projected64, tx: i32, ty: i32, alpha_min: f64) -> bool {
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
pub fn bin(projected: &[Option<Projected64>], camera: &Camera64, alpha_min: f64) -> Vec<Vec<u32>> {
    let [tiles_x, tiles_y] = camera.tiles();
    let mut order: Vec<(f32, u32)> = projected
        .iter()
        .enumerate()
        .filter_map(|(i, r)| r.as_ref().map(|g| (g.depth as f32, i as u32)))
        .collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut tiles = vec![Vec::new(); (tiles_x * tiles_y) as usize];
    for (_, i) in order {
        let Some(g) = &projected[i as usize] else {
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
