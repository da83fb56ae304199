//! The direction that is up in a capture.

use glam::{DMat3, DVec3};

use crate::capture::camera::Camera;

/// Weight of the mean of the cameras' own upward directions beside the demand that their x axes be level.
const UPRIGHT: f64 = 0.01;

/// The direction that is up for the people who took the photos: the one to which the cameras' x axes are most nearly perpendicular, as
/// photos are seldom tilted sideways, on the side of the mean of their upward directions; near that mean where all x axes
/// are parallel. −y without cameras.
#[must_use]
pub fn up_axis<'a>(cameras: impl IntoIterator<Item = &'a Camera>) -> DVec3 {
    let (mut level, mut mean, mut n) = (DMat3::ZERO, DVec3::ZERO, 0.0);
    for camera in cameras {
        let [right, down] = [0, 1].map(|k| camera.rotation.row(k));
        level += outer(right);
        mean -= down;
        n += 1.0;
    }
    let start = mean.try_normalize().unwrap_or(DVec3::NEG_Y);
    if !(n > 0.0 && start.is_finite()) {
        return DVec3::NEG_Y;
    }
    // Smallest eigenvector by inverse iteration; the last term keeps the matrix regular.
    let upright = (DMat3::IDENTITY - outer(start)) * UPRIGHT;
    let inverse = (level * (1.0 / n) + upright + DMat3::IDENTITY * 1e-6).inverse();
    let up = (0..100).fold(start, |up, _| (inverse * up).normalize_or(start));
    match up.is_finite() {
        true if up.dot(start) < 0.0 => -up,
        true => up,
        false => start,
    }
}

fn outer(v: DVec3) -> DMat3 {
    DMat3::from_cols(v * v.x, v * v.y, v * v.z)
}
