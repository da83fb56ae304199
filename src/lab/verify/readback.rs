//! What the stages left on the device, read back in one precision for all.

use crate::base::constants::TILE;
use crate::device::{CameraArg, Real};

pub(super) fn widen<R: Real>(values: Vec<R>) -> Vec<f64> {
    values.into_iter().map(Into::into).collect()
}

/// Planes of a padded image without the padding.
pub(super) fn crop<R: Real>(
    padded: &[f64],
    camera: &CameraArg<R>,
    planes: std::ops::Range<usize>,
) -> Vec<f64> {
    let [w, h] = camera.size.map(|s| s as usize);
    let [stride, rows] = camera.tiles.map(|t| t as usize * TILE as usize);
    planes
        .flat_map(|c| (0..h).map(move |y| (c * rows + y) * stride))
        .flat_map(|from| padded[from..from + w].iter().copied())
        .collect()
}
