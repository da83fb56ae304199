//! Twin of `kernels/weight.cl`: what a view shows of every Gaussian.

use super::Camera64;
use super::project::Record64;
use super::splat::{contributions, list_at};

/// Sum of α·T over the pixels of a view, of each Gaussian.
#[must_use]
pub fn weights(
    records: &[Option<Record64>],
    tiles: &[Vec<u32>],
    camera: &Camera64,
    alpha_min: f64,
) -> Vec<f64> {
    let mut total = vec![0.0; records.len()];
    for y in 0..camera.size[1] {
        for x in 0..camera.size[0] {
            let list = list_at(tiles, camera, x, y);
            for part in contributions(records, list, x, y, alpha_min).0 {
                total[part.gaussian as usize] += part.alpha * part.transmittance;
            }
        }
    }
    total
}
