//! [`Trajectory`]: a smooth camera path through keyframes.

use glam::{DMat3, DQuat, DVec3};

use crate::base::error::{Error, Result};
use crate::capture::Camera;
use crate::scene::orbit::pinhole;

/// Frames between two keyframes of a path along cameras, at least: through every one of many, hand-held, it would shake.
const FRAMES_PER_KEY: usize = 8;

/// Cameras whose neighbours in order are farther apart than this share of the distance of any two are in no order of capture.
const IN_ORDER: f64 = 0.5;

/// Fields of view that are taken, radians.
const FOV: std::ops::RangeInclusive<f64> = 0.001..=3.1;

/// A camera at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Keyframe {
    /// Time, in any unit.
    pub time: f64,
    /// Centre of projection.
    pub position: DVec3,
    /// Rotation from the scene to the camera.
    pub rotation: DQuat,
    /// Horizontal field of view, radians.
    pub fov: f64,
}

/// Numbers of a keyframe that are interpolated: position, quaternion, field of view.
type Numbers = [f64; 8];

/// A path through keyframes: cubic between each two, with one velocity at each (Catmull and Rom, for any distances in time).
#[derive(Debug, Clone, PartialEq)]
pub struct Trajectory {
    times: Vec<f64>,
    keys: Vec<Numbers>,
}

impl Trajectory {
    /// The path through keyframes.
    ///
    /// # Errors
    /// [`Error::Config`] for none, for times that do not ascend, and for numbers that are not finite or no camera's.
    pub fn new(keyframes: &[Keyframe]) -> Result<Self> {
        let wrong = |k: usize, what: &str| Err(Error::config(format!("keyframes[{k}]"), what));
        if keyframes.is_empty() {
            return Err(Error::config("keyframes", "none; at least one expected"));
        }
        let mut keys: Vec<Numbers> = Vec::with_capacity(keyframes.len());
        for (k, key) in keyframes.iter().enumerate() {
            if !key.time.is_finite() || k > 0 && key.time <= keyframes[k - 1].time {
                return wrong(k, "its time is not above that of the keyframe before it");
            }
            if !key.position.is_finite() {
                return wrong(k, "its position is not finite");
            }
            if !FOV.contains(&key.fov) {
                return wrong(k, "its field of view is not between 0.06 and 177.6 degrees");
            }
            let norm = key.rotation.length();
            if !(norm.is_finite() && norm > 1e-9) {
                return wrong(k, "its rotation is no quaternion");
            }
            // A quaternion and its negative are one rotation: the nearer one to that before is on the shorter way.
            let mut q = key.rotation / norm;
            let before = keys
                .last()
                .map(|n| DQuat::from_xyzw(n[3], n[4], n[5], n[6]));
            if before.is_some_and(|b| b.dot(q) < 0.0) {
                q = -q;
            }
            let p = key.position;
            keys.push([p.x, p.y, p.z, q.x, q.y, q.z, q.w, key.fov]);
        }
        let times = keyframes.iter().map(|k| k.time).collect();
        Ok(Self { times, keys })
    }

    /// A path of `frames` frames along cameras in their order; `None` if that is no order of capture, so that a path through them would
    /// cross what they look at.
    ///
    /// # Errors
    /// None for cameras that are finite.
    pub fn along(cameras: &[Camera], fov: f64, frames: usize) -> Result<Option<Self>> {
        let distance = |a: &Camera, b: &Camera| a.center().distance(b.center());
        let mean = |apart: usize| {
            let pairs = cameras.iter().zip(cameras.iter().cycle().skip(apart));
            pairs.map(|(a, b)| distance(a, b)).sum::<f64>() / cameras.len().max(1) as f64
        };
        // Any two, for a number of shifts that divides nothing evenly.
        let shifts: Vec<usize> = (1..8).map(|k| 1 + k * cameras.len() / 9).collect();
        let any = shifts.iter().map(|s| mean(*s)).sum::<f64>() / shifts.len() as f64;
        if cameras.is_empty() || cameras.len() > 8 && mean(1) > IN_ORDER * any {
            return Ok(None);
        }
        let every = cameras
            .len()
            .div_ceil((frames / FRAMES_PER_KEY).max(2))
            .max(1);
        let mut keyframes: Vec<Keyframe> = Vec::new();
        for camera in cameras.iter().step_by(every) {
            let rotation = DQuat::from_mat3(&camera.rotation);
            let time = keyframes.last().map_or(0.0, |before| {
                let moved = before.position.distance(camera.center()) / any.max(1e-9);
                let turned = before.rotation.angle_between(rotation);
                // Even speed, of places and directions alike.
                before.time + (moved + turned).max(1e-3)
            });
            keyframes.push(Keyframe {
                time,
                position: camera.center(),
                rotation,
                fov,
            });
        }
        Self::new(&keyframes).map(Some)
    }

    /// Time from the first keyframe to the last.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.times.last().unwrap_or(&0.0) - self.times.first().unwrap_or(&0.0)
    }

    /// `n` cameras at even times from the first keyframe to the last. `size` is width, height in pixels.
    #[must_use]
    pub fn cameras(&self, n: u32, size: [u32; 2]) -> Vec<Camera> {
        let first = self.times.first().copied().unwrap_or(0.0);
        let step = self.duration() / f64::from(n.saturating_sub(1).max(1));
        let camera = |k: u32| {
            let [x, y, z, i, j, l, w, fov] = self.at(first + f64::from(k) * step);
            let rotation = DMat3::from_quat(DQuat::from_xyzw(i, j, l, w));
            pinhole(DVec3::new(x, y, z), rotation, size, fov)
        };
        (0..n).map(camera).collect()
    }

    /// Position, unit quaternion and field of view at a time.
    fn at(&self, time: f64) -> Numbers {
        let after = self.times.partition_point(|t| *t <= time);
        let k = after.clamp(1, self.keys.len().max(2) - 1) - 1;
        let mut now = match (self.keys.get(k), self.keys.get(k + 1)) {
            (Some(from), Some(to)) => {
                let span = self.times[k + 1] - self.times[k];
                let s = ((time - self.times[k]) / span).clamp(0.0, 1.0);
                let (out, into) = (self.velocity(k), self.velocity(k + 1));
                let (s2, s3) = (s * s, s * s * s);
                std::array::from_fn(|c| {
                    (2.0 * s3 - 3.0 * s2 + 1.0) * from[c]
                        + (s3 - 2.0 * s2 + s) * span * out[c]
                        + (3.0 * s2 - 2.0 * s3) * to[c]
                        + (s3 - s2) * span * into[c]
                })
            }
            (Some(only), None) => *only,
            _ => [0.0; 8],
        };
        let q = DQuat::from_xyzw(now[3], now[4], now[5], now[6]);
        let q = match q.length() > 1e-6 {
            true => q.normalize(),
            false => DQuat::IDENTITY,
        };
        now[3..7].copy_from_slice(&q.to_array());
        now[7] = now[7].clamp(*FOV.start(), *FOV.end());
        now
    }

    /// Velocity at a keyframe: of the parabola through it and its neighbours, or to the only neighbour.
    fn velocity(&self, k: usize) -> Numbers {
        let slope = |a: usize| -> Option<(f64, Numbers)> {
            let span = self.times.get(a + 1)? - self.times[a];
            let (from, to) = (self.keys[a], self.keys[a + 1]);
            Some((span, std::array::from_fn(|c| (to[c] - from[c]) / span)))
        };
        match (k.checked_sub(1).and_then(slope), slope(k)) {
            (Some((before, from)), Some((after, to))) => {
                std::array::from_fn(|c| (from[c] * after + to[c] * before) / (before + after))
            }
            (Some((_, only)), None) | (None, Some((_, only))) => only,
            (None, None) => [0.0; 8],
        }
    }
}
