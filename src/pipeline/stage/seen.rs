//! Gaussians that any pixel of a view shows (`kernels/seen.cl`).

use crate::base::error::Result;
use crate::device::{Array, Program, Real};
use crate::pipeline::buffers::ViewBuffers;
use crate::pipeline::launch::Arguments;
use crate::pipeline::reference::Camera64;
use crate::pipeline::stage::project::Projected64;
use crate::pipeline::stage::splat::{contributions, list_at};

/// Marks the Gaussians that a view with sorted pairs shows in `seen`, which has a value for each; `shown` is scratch with
/// one for each pair.
pub fn mark<R: Real>(
    stage: &Program,
    view: &ViewBuffers<R>,
    shown: &Array<u8>,
    seen: &Array<u32>,
) -> Result<()> {
    let (size, count) = (view.camera.image(), seen.len());
    stage
        .launch("seen_pairs")
        .tile_lists(view)
        .tiles(size)
        .ints(size.pixels)
        .array(seen, count)
        .array(shown, view.isect_owner.len())
        .over_tiles(size, &view.band)?;
    stage
        .launch("seen_gather")
        .uints([count])
        .arrays([&view.isect_start, &view.isect_counts], count)
        .array(shown, 1)
        .array(seen, count)
        .over_items([count, 1])
}

// Definition in f64.

/// True for each Gaussian that a pixel of a view shows: it adds α·T > 0 of its colour.
#[must_use]
pub fn seen(
    projected: &[Option<Projected64>],
    tiles: &[Vec<u32>],
    camera: &Camera64,
    alpha_min: f64,
) -> Vec<bool> {
    let mut seen = vec![false; projected.len()];
    for y in 0..camera.size[1] {
        for x in 0..camera.size[0] {
            let list = list_at(tiles, camera, x, y);
            for part in contributions(projected, list, x, y, alpha_min).0 {
                seen[part.gaussian as usize] |= part.alpha * part.transmittance > 0.0;
            }
        }
    }
    seen
}
