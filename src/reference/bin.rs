//! Twin of `kernels/bin.cl`: records → Gaussians of each tile, front to back.

use super::project::Record64;
use super::{Camera64, TILE};
use crate::constants::TILE_SLACK;

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
