//! Circles of cameras.

use glam::{DMat3, DVec2, DVec3};

use crate::base::math::{order_statistic, sorted, upper_median};
use crate::capture::{Camera, up_axis};

/// Share of the largest circle within the cameras' hull that a [`Ring::inside`] has as its radius.
const WITHIN: f64 = 0.9;

/// A circle around what cameras look at is taken if the hull leaves it at least this share of their distance from there.
const FAR_ENOUGH: f64 = 0.5;

/// A circle on which cameras stand, and the point that they look at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ring {
    /// Point that the circle is around.
    pub center: DVec3,
    /// Point that the cameras look at.
    pub target: DVec3,
    /// Radius, > 0.
    pub radius: f64,
    /// Height of the circle's plane over `center`.
    pub height: f64,
    /// Unit vector that is up.
    pub up: DVec3,
}

/// Horizontal field of view for scenes without photos, radians: a focal length of 0.9 widths.
#[must_use]
pub fn usual_fov() -> f64 {
    2.0 * (0.5f64 / 0.9).atan()
}

/// `n` cameras on [`Ring::around`] the positions, with [`usual_fov`]. `size` is width, height in pixels.
#[must_use]
pub fn orbit(axes: [&[f32]; 3], n: u32, size: [u32; 2]) -> Vec<Camera> {
    Ring::around(axes).cameras(n, size, usual_fov())
}

/// A camera without distortion at a place, of square pixels. `fov` is horizontal, in radians.
#[must_use]
pub fn pinhole(eye: DVec3, rotation: DMat3, size: [u32; 2], fov: f64) -> Camera {
    let [w, h] = size.map(f64::from);
    let focal = 0.5 * w / (0.5 * fov).tan();
    Camera {
        rotation,
        translation: -(rotation * eye),
        fx: focal,
        fy: focal,
        cx: w / 2.0,
        cy: h / 2.0,
        width: size[0],
        height: size[1],
    }
}

/// Rotation from the scene to a camera at `eye` that looks at `target`; any with that direction if it is parallel to `up`.
#[must_use]
pub fn look_at(eye: DVec3, target: DVec3, up: DVec3) -> DMat3 {
    let z = (target - eye).try_normalize().unwrap_or(DVec3::Z);
    let x = z.cross(up).try_normalize();
    let x = x.unwrap_or_else(|| z.any_orthonormal_vector());
    DMat3::from_cols(x, z.cross(x), z).transpose()
}

impl Ring {
    /// A circle around the median of positions (`axes` = x, y, z of every Gaussian), over the plane in which they extend most, at
    /// 2.5 times the radius that holds 80 % of them along each axis.
    #[must_use]
    pub fn around(axes: [&[f32]; 3]) -> Self {
        let sorted = axes.map(|axis| {
            let mut v = axis.to_vec();
            v.sort_by(f32::total_cmp);
            v
        });
        let quantile = |k: usize, q: f64| f64::from(order_statistic(&sorted[k], q).unwrap_or(0.0));
        let center = DVec3::from_array(std::array::from_fn(|k| quantile(k, 0.5)));
        let spread = |k: usize| quantile(k, 0.9) - quantile(k, 0.1);
        let spread = DVec3::from_array(std::array::from_fn(spread));
        let up_axis = (0..3)
            .min_by(|a, b| spread[*a].total_cmp(&spread[*b]))
            .unwrap_or(1);
        let radius = 1.25 * spread.max_element().max(1e-6);
        // Captures are upright far more often than not; y points down in COLMAP's frames, z up in Blender's.
        let up = match up_axis {
            1 => -DVec3::Y,
            axis => DVec3::AXES[axis],
        };
        Self {
            center,
            target: center,
            radius,
            height: 0.35 * radius,
            up,
        }
    }

    /// A circle within the hull of a capture's cameras, where nothing stands between them and what they saw: around what they
    /// look at if they stand around it, else around their own middle. There they look at what the cameras look at, or, if those
    /// look in all directions, across the circle. `None` without cameras.
    #[must_use]
    pub fn inside(cameras: &[Camera]) -> Option<Self> {
        let centers: Vec<DVec3> = cameras.iter().map(Camera::center).collect();
        let middle = centers.iter().sum::<DVec3>() / centers.len() as f64;
        let up = up_axis(cameras);
        let (u, v) = up.any_orthonormal_pair();
        let flat = |p: DVec3| DVec2::new((p - middle).dot(u), (p - middle).dot(v));
        let hull = hull(centers.iter().map(|c| flat(*c)).collect());
        let focus = focus(cameras);
        if let Some(focus) = focus {
            let away = centers.iter().map(|c| flat(*c).distance(flat(focus)));
            let away = upper_median(away)?;
            let room = inscribed(&hull, flat(focus));
            if room > 0.0 && room >= FAR_ENOUGH * away {
                let heights = centers.iter().map(|c| (*c - focus).dot(up));
                return Some(Self {
                    center: focus,
                    target: focus,
                    radius: WITHIN * room,
                    height: upper_median(heights)?,
                    up,
                });
            }
        }
        let spread = upper_median(centers.iter().map(|c| c.distance(middle)))?;
        let least = (0.1 * spread).max(1e-3);
        Some(Self {
            center: middle,
            target: focus.unwrap_or(middle),
            radius: (WITHIN * inscribed(&hull, DVec2::ZERO)).max(least),
            height: 0.0,
            up,
        })
    }

    /// `n` cameras evenly on the circle. `size` is width, height in pixels, `fov` horizontal in radians.
    #[must_use]
    pub fn cameras(&self, n: u32, size: [u32; 2], fov: f64) -> Vec<Camera> {
        let (u, v) = self.up.any_orthonormal_pair();
        let camera = |k: u32| {
            let a = std::f64::consts::TAU * f64::from(k) / f64::from(n.max(1));
            let ray = (u * a.cos() + v * a.sin()) * self.radius;
            let eye = self.center + ray + self.up * self.height;
            pinhole(eye, look_at(eye, self.target, self.up), size, fov)
        };
        (0..n).map(camera).collect()
    }
}

/// The point nearest to the optical axes of the cameras, by least squares, if it lies before most of them; `None` else.
fn focus(cameras: &[Camera]) -> Option<DVec3> {
    let (mut a, mut b) = (DMat3::ZERO, DVec3::ZERO);
    for c in cameras {
        let d = c.rotation.row(2);
        let across = DMat3::IDENTITY - DMat3::from_cols(d * d.x, d * d.y, d * d.z);
        a += across;
        b += across * c.center();
    }
    let n = cameras.len() as f64;
    let clear = a.determinant() > 1e-4 * n.powi(3);
    let focus = clear.then(|| a.inverse() * b)?;
    let before = |c: &&Camera| (focus - c.center()).dot(c.rotation.row(2)) > 0.0;
    let before = cameras.iter().filter(before).count();
    (4 * before >= 3 * cameras.len()).then_some(focus)
}

/// Corners of the convex hull of points, anticlockwise (Andrew's monotone chain).
fn hull(mut points: Vec<DVec2>) -> Vec<DVec2> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    let half = |points: &mut dyn Iterator<Item = &DVec2>| {
        let mut chain: Vec<DVec2> = Vec::new();
        for p in points {
            while let [.., a, b] = chain[..]
                && (b - a).perp_dot(*p - a) <= 0.0
            {
                chain.pop();
            }
            chain.push(*p);
        }
        chain.pop();
        chain
    };
    let mut corners = half(&mut points.iter());
    corners.extend(half(&mut points.iter().rev()));
    corners
}

/// Radius of the largest circle around `p` in a hull; negative outside of it, 0 for a hull without area.
fn inscribed(hull: &[DVec2], p: DVec2) -> f64 {
    let next = hull.iter().cycle().skip(1);
    let edges = hull.iter().zip(next).filter(|(a, b)| a != b);
    let room = edges.map(|(a, b)| (*b - *a).normalize().perp_dot(p - *a));
    let room = sorted(room);
    room.first().copied().unwrap_or(0.0)
}

/// Median horizontal field of view of cameras, radians; [`usual_fov`] without any.
#[must_use]
pub fn fov_of(cameras: &[Camera]) -> f64 {
    let fov = |c: &Camera| 2.0 * (0.5 * f64::from(c.width) / c.fx).atan();
    upper_median(cameras.iter().map(fov)).unwrap_or_else(usual_fov)
}
