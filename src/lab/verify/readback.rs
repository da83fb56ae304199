//! Results of the forward and backward stages, read back in f64 from either precision.

use std::ops::Range;

use crate::base::constants::{SUMS, TILE};
use crate::base::error::Result;
use crate::device::tuning::{KEY_CULLED, status};
use crate::device::{CameraArg, Real};
use crate::pipeline::buffers::ViewBuffers;

/// Numbers in f64.
pub(super) fn widen<R: Real>(values: Vec<R>) -> Vec<f64> {
    values.into_iter().map(Into::into).collect()
}

/// Planes of a padded image without the padding.
pub(super) fn crop<R: Real>(
    padded: &[f64],
    camera: &CameraArg<R>,
    planes: Range<usize>,
) -> Vec<f64> {
    let [w, h] = camera.size.map(|s| s as usize);
    let [stride, rows] = camera.tiles.map(|t| t as usize * TILE as usize);
    planes
        .flat_map(|c| (0..h).map(move |y| (c * rows + y) * stride))
        .flat_map(|from| padded[from..from + w].iter().copied())
        .collect()
}

/// Projected Gaussians as numbers: mean, quadratic form, opacity, depth, colour, pixel bounds; zeros when culled.
pub(super) fn records<R: Real>(f: &ViewBuffers<R>, count: usize) -> Result<Vec<[f64; 14]>> {
    let keys = f.keys.read(0, count)?;
    let records = f.records.read(0, count)?;
    let bounds = |b: u32| [f64::from(b & 0xffff), f64::from(b >> 16)];
    let of = |(key, r): (&u32, &crate::device::Projected<R>)| {
        if *key == KEY_CULLED {
            return [0.0; 14];
        }
        let ([x0, x1], [y0, y1]) = (bounds(r.bx), bounds(r.by));
        let [red, green, blue] = r.rgb.map(Into::into);
        let [x, y, a, rho, c, lo, depth] = [r.x, r.y, r.a, r.r, r.c, r.lo, r.depth].map(Into::into);
        [x, y, a, rho, c, lo, depth, red, green, blue, x0, x1, y0, y1]
    };
    Ok(keys.iter().zip(&records).map(of).collect())
}

/// Sum of the tile counts of the visible Gaussians.
pub(super) fn counted<R: Real>(f: &ViewBuffers<R>) -> Result<f64> {
    let visible = f.status.read(status::VISIBLE as usize, 1)?[0] as usize;
    let counts = f.counts.read(0, visible)?;
    Ok(counts.into_iter().map(f64::from).sum())
}

/// Gaussians of each tile from front to back.
pub(super) fn tiles<R: Real>(f: &ViewBuffers<R>, camera: &CameraArg<R>) -> Result<Vec<Vec<u32>>> {
    let pairs = f.status.read(status::INTERSECTIONS as usize, 1)?[0] as usize;
    let order = f.order.sorted_values().read(0, pairs)?;
    let owner = f.isect_owner.read(0, pairs)?;
    let start = f.tile_start.read(0, camera.tile_count() + 1)?;
    let tile = |w: &[u32]| {
        let slots = &order[w[0] as usize..w[1] as usize];
        slots.iter().map(|slot| owner[*slot as usize]).collect()
    };
    Ok(start.windows(2).map(tile).collect())
}

/// Nine sums of each Gaussian over its tile intersections \[N, 9\].
pub(super) fn sums<R: Real>(f: &ViewBuffers<R>, count: usize) -> Result<Vec<f64>> {
    let counts = f.isect_counts.read(0, count)?;
    let starts = f.isect_start.read(0, count)?;
    let all = widen(f.sums.to_vec()?);
    let of = |(n, first): (&u32, &u32)| {
        let mut total = [0.0; SUMS];
        for p in 0..*n as usize {
            for (k, t) in total.iter_mut().enumerate() {
                *t += all[(*first as usize + p) * SUMS + k];
            }
        }
        total
    };
    Ok(counts.iter().zip(&starts).flat_map(of).collect())
}
