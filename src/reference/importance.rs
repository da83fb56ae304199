//! Twin of `kernels/importance.cl`.

use super::{Camera64, Scene64};

/// Values of two error maps \[height, width\] at the pixel under the projected centre of Gaussian `i`, if it is in front
/// of the camera and inside the image.
#[must_use]
pub fn importance(
    scene: &Scene64,
    i: usize,
    camera: &Camera64,
    maps: [&[f64]; 2],
) -> Option<[f64; 2]> {
    let t = camera.apply(scene.position(i));
    if t[2].is_nan() || t[2] <= camera.near {
        return None;
    }
    let pixel: [f64; 2] =
        std::array::from_fn(|k| (camera.focal[k] * t[k] / t[2] + camera.principal[k]).floor());
    let inside = (0..2).all(|k| pixel[k] >= 0.0 && pixel[k] < f64::from(camera.size[k]));
    inside.then(|| {
        let at = pixel[1] as usize * camera.size[0] as usize + pixel[0] as usize;
        maps.map(|m| m[at])
    })
}
