//! Visible Gaussians → (tile, Gaussian) pairs, by tile and depth (`kernels/bin.cl`).

use crate::base::constants::TILE_SLACK;
use crate::base::error::Result;
use crate::device::{Launch, Program, Real};
use crate::pipeline::buffers::ViewBuffers;
use crate::pipeline::launch::Arguments;
use crate::pipeline::reference::Camera64;
use crate::pipeline::stage::project::Projected64;
use crate::pipeline::stage::sort::{Keys, Sort};

/// Sorts the visible Gaussians by depth and writes their number to the status.
pub fn sort_visible<R: Real>(
    stage: &Program,
    sort: &Sort,
    view: &mut ViewBuffers<R>,
) -> Result<()> {
    let keys = Keys::depths(view.count);
    let chunks = sort.chunks(&keys);
    over_keys(stage.launch("bin_visible"), view, chunks).over_groups(chunks)?;
    let compact = over_keys(stage.launch("bin_compact"), view, chunks)
        .arrays([&view.visible.keys[0], &view.visible.values[0]], view.count)
        .status(view);
    if !stage.defines().tuning.group_style {
        compact.over_groups(chunks)?;
        return sort.run(&mut view.visible, &keys, &view.status);
    }
    let (bins, histogram) = sort.first_pass(&keys);
    compact
        .uints([bins])
        .array(histogram, chunks * bins)
        .array(&view.chunk_starts, chunks + 1)
        .uints([stage.chunks()])
        .array(&view.pair_sums, stage.chunks())
        .over_groups(chunks)?;
    sort.run_counted(&mut view.visible, &keys, &view.status, &view.chunk_starts)
}

/// Counts the tiles of each visible Gaussian, those of a masked photo in which nothing counts left out if `active_only`; in the group
/// style by depth, too, and by chunk of those.
pub fn count<R: Real>(stage: &Program, view: &ViewBuffers<R>, active_only: bool) -> Result<()> {
    let launch = walk(stage.launch("bin_count"), view, active_only);
    let launch = launch.array(&view.isect_counts, view.count);
    match stage.defines().tuning.group_style {
        true => launch
            .uints([view.count])
            .array(view.depth_counts(), view.count)
            .uints([stage.chunks()])
            .array(&view.pair_sums, stage.chunks())
            .over_shared(view.count),
        false => launch.over_batches(view.count),
    }
}

/// Counts the pairs of each chunk of the visible Gaussians by tile (not in the group style).
pub fn count_tiles<R: Real>(
    stage: &Program,
    view: &ViewBuffers<R>,
    active_only: bool,
) -> Result<()> {
    let chunks = view.tile_chunks();
    by_tile(stage.launch("bin_tiles"), view, active_only).over_chunks([chunks, 1])
}

/// Writes the pairs that [`count`] counted: to the places that [`count_tiles`] found for them, or by depth in the group style.
pub fn emit<R: Real>(stage: &Program, view: &ViewBuffers<R>, active_only: bool) -> Result<()> {
    let launch = stage.launch("bin_emit");
    if stage.defines().tuning.group_style {
        let pairs = &view.pairs;
        return walk(launch, view, active_only)
            .arrays([view.depth_start(), &view.isect_start], view.count)
            .arrays([&view.isect_owner, &pairs.keys[0], &pairs.values[0]], 1)
            .over_shared(view.count);
    }
    by_tile(launch, view, active_only)
        .array(&view.tile_start, view.camera.image().tile_count() + 1)
        .array(&view.isect_start, view.count)
        .arrays([view.order(), &view.isect_owner], 1)
        .over_chunks([view.tile_chunks(), 1])
}

/// Looks up the first pair of each tile among the sorted pairs.
pub fn find_tiles<R: Real>(stage: &Program, view: &ViewBuffers<R>) -> Result<()> {
    let tiles = view.camera.image().tile_count();
    stage
        .launch("bin_ranges")
        .array(&view.pairs.keys[view.pairs.sorted], 1)
        .status(view)
        .uints([tiles])
        .array(&view.tile_start, tiles + 1)
        .over_items([tiles + 1, 1])
}

/// Adds the arguments of a walk over the tiles of the visible Gaussians that keeps count of each tile.
fn by_tile<'k, R: Real>(
    launch: Launch<'k>,
    view: &ViewBuffers<R>,
    active_only: bool,
) -> Launch<'k> {
    let (tiles, chunks) = (view.camera.image().tile_count(), view.tile_chunks());
    walk(launch, view, active_only)
        .uints([tiles, chunks])
        .array(&view.tile_counts, chunks * tiles)
}

/// Adds the arguments of a sweep over the keys of all Gaussians.
fn over_keys<'k, R: Real>(launch: Launch<'k>, view: &ViewBuffers<R>, chunks: usize) -> Launch<'k> {
    launch
        .array(&view.keys, view.count)
        .uints([view.count, view.early.start, view.early.len(), chunks])
        .array(&view.chunk_sums, chunks)
}

/// Adds the arguments of a walk over the tiles of the visible Gaussians.
fn walk<'k, R: Real>(launch: Launch<'k>, view: &ViewBuffers<R>, active_only: bool) -> Launch<'k> {
    let camera = &view.camera;
    let mut launch = launch
        .array(&view.records, view.count)
        .array(view.visible.sorted_values(), view.count)
        .status(view)
        .uints([camera.across as usize]);
    if launch.defines().masked() {
        let read = if active_only {
            camera.image().tile_count()
        } else {
            0
        };
        launch = launch
            .array(&view.active_tiles, read)
            .value(i32::from(active_only));
    }
    launch.array(&view.cover, 2 * view.count)
}

// Definition in f64.

/// True if the smallest value of the projected Gaussian's quadratic form over the tile's rectangle of pixel centres is within its
/// reach. The minimum of a convex form over a rectangle lies at its centre or on the boundary; here every edge is looked
/// at, whether it faces the mean or not. Tiles have so many pixels a side.
#[must_use]
pub fn touches(g: &Projected64, [tx, ty]: [i32; 2], tile: i32, alpha_min: f64) -> bool {
    let inside = |k: usize, t: i32| g.bounds[k][0] / tile <= t && t <= g.bounds[k][1] / tile;
    if !inside(0, tx) || !inside(1, ty) {
        return false;
    }
    let low = [tx, ty].map(|t| f64::from(t * tile) + 0.5);
    let x = [low[0] - g.mean[0], low[0] - g.mean[0] + f64::from(tile - 1)];
    let y = [low[1] - g.mean[1], low[1] - g.mean[1] + f64::from(tile - 1)];
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

/// Gaussians of each tile (row major) of so many pixels a side, sorted by the f32 depth, ties by index.
#[must_use]
pub fn bin(
    projected: &[Option<Projected64>],
    camera: &Camera64,
    tile: i32,
    alpha_min: f64,
) -> Vec<Vec<u32>> {
    let [tiles_x, tiles_y] = camera.tiles(tile);
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
        for ty in g.bounds[1][0] / tile..=g.bounds[1][1] / tile {
            for tx in g.bounds[0][0] / tile..=g.bounds[0][1] / tile {
                if touches(g, [tx, ty], tile, alpha_min) {
                    tiles[(ty * tiles_x + tx) as usize].push(i);
                }
            }
        }
    }
    tiles
}
