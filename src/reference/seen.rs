//! Twin of `kernels/seen.cl`: which Gaussians a view shows.

use super::Camera64;
use super::project::Record64;
use super::splat::{contributions, list_at};

/// Whether a pixel of a view shows each Gaussian: adds α·T > 0 of its colour.
#[must_use]
pub fn seen(
    records: &[Option<Record64>],
    tiles: &[Vec<u32>],
    camera: &Camera64,
    alpha_min: f64,
) -> Vec<bool> {
    let mut seen = vec![false; records.len()];
    for y in 0..camera.size[1] {
        for x in 0..camera.size[0] {
            let list = list_at(tiles, camera, x, y);
            for part in contributions(records, list, x, y, alpha_min).0 {
                seen[part.gaussian as usize] |= part.alpha * part.transmittance > 0.0;
            }
        }
    }
    seen
}
