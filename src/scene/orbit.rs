//! Cameras around a scene that has no photos.

use glam::{DMat3, DVec3};

use crate::base::math::order_statistic;
use crate::capture::Camera;

/// `n` cameras on a circle around the median of the positions (`axes` = x, y, z of every Gaussian), in the plane in which
/// they extend most, at 2.5 times the radius that holds 80 % of them along each axis. `size` is width, height in pixels.
#[must_use]
pub fn orbit(axes: [&[f32]; 3], n: u32, size: [u32; 2]) -> Vec<Camera> {
    let sorted = axes.map(|axis| {
        let mut v = axis.to_vec();
        v.sort_by(f32::total_cmp);
        v
    });
    let quantile = |k: usize, q: f64| f64::from(order_statistic(&sorted[k], q).unwrap_or(0.0));
    let center = DVec3::from_array(std::array::from_fn(|k| quantile(k, 0.5)));
    let spread = DVec3::from_array(std::array::from_fn(|k| quantile(k, 0.9) - quantile(k, 0.1)));
    let up_axis = (0..3)
        .min_by(|a, b| spread[*a].total_cmp(&spread[*b]))
        .unwrap_or(1);
    let radius = 1.25 * spread.max_element().max(1e-6);
    // Captures are upright far more often than not; y points down in COLMAP's frames, z up in Blender's.
    let up = if up_axis == 1 {
        -DVec3::Y
    } else {
        DVec3::AXES[up_axis]
    };
    let (u, v) = up.any_orthonormal_pair();
    let [w, h] = size.map(f64::from);
    (0..n)
        .map(|k| {
            let a = std::f64::consts::TAU * f64::from(k) / f64::from(n.max(1));
            let eye = center + (u * a.cos() + v * a.sin() + up * 0.35) * radius;
            let z = (center - eye).normalize();
            let x = z.cross(up).normalize();
            let rotation = DMat3::from_cols(x, z.cross(x), z).transpose();
            Camera {
                rotation,
                translation: -(rotation * eye),
                fx: 0.9 * w,
                fy: 0.9 * w,
                cx: w / 2.0,
                cy: h / 2.0,
                width: size[0],
                height: size[1],
            }
        })
        .collect()
}
