//! PLY: scenes with the properties of 3DGS in Inria's order, and plain coloured point clouds.

use std::path::Path;

use glam::DVec3;

use super::ply_header::{Table, parse};
use crate::dataset::{Frame, Points};
use crate::error::{Error, Result};
use crate::model::{Plane, Splats, sh_coefficients};
use crate::report::write_atomic;

/// Names of the properties of a scene, in Inria's order, and the plane of each (none: zero).
fn properties(sh_degree: u32) -> Vec<(String, Option<usize>)> {
    let k = sh_coefficients(sh_degree);
    let mut out: Vec<(String, Option<usize>)> = Vec::new();
    for (c, name) in ["x", "y", "z"].into_iter().enumerate() {
        out.push((name.into(), Some(Plane::POSITION + c)));
    }
    for name in ["nx", "ny", "nz"] {
        out.push((name.into(), None));
    }
    for c in 0..3 {
        out.push((format!("f_dc_{c}"), Some(Plane::SH + c)));
    }
    // Inria keeps all coefficients of one channel together; the planes here keep the channels of one together.
    for c in 0..3 {
        for j in 1..k {
            out.push((
                format!("f_rest_{}", c * (k - 1) + j - 1),
                Some(Plane::SH + 3 * j + c),
            ));
        }
    }
    out.push(("opacity".into(), Some(Plane::OPACITY)));
    for c in 0..3 {
        out.push((format!("scale_{c}"), Some(Plane::LOG_SCALE + c)));
    }
    for c in 0..4 {
        out.push((format!("rot_{c}"), Some(Plane::ROTATION + c)));
    }
    out
}

/// Writes a scene in the dataset's own frame, binary, whole or not at all.
///
/// # Errors
/// A value that is not finite in that frame, or [`Error::Io`].
pub fn write(path: &Path, splats: &Splats, frame: &Frame) -> Result<()> {
    let properties = properties(splats.sh_degree());
    let mut out = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\n",
        splats.len()
    );
    for (name, _) in &properties {
        out.push_str(&format!("property float {name}\n"));
    }
    out.push_str("end_header\n");
    let mut bytes = out.into_bytes();
    bytes.reserve(splats.len() * properties.len() * 4);
    let ln_scale = frame.scale.ln();
    for i in 0..splats.len() {
        let local = DVec3::from_array(splats.gather::<3>(Plane::POSITION, i).map(f64::from));
        let world = frame.to_dataset(local).to_array();
        for (name, plane) in &properties {
            let value = match *plane {
                None => 0.0,
                Some(p) if p < Plane::LOG_SCALE => world[p] as f32,
                Some(p) if p < Plane::ROTATION => {
                    (f64::from(splats.planes()[p][i]) + ln_scale) as f32
                }
                Some(p) => splats.planes()[p][i],
            };
            if !value.is_finite() {
                return Err(Error::Numerics {
                    stage: format!("export {}", path.display()),
                    what: format!("{name} of Gaussian {i} is {value}"),
                });
            }
            bytes.extend(value.to_le_bytes());
        }
    }
    write_atomic(path, &bytes)
}

fn not_a_scene(path: &Path, what: impl Into<String>) -> Error {
    Error::input(
        path,
        what,
        "give a PLY with the 3DGS properties (x, f_dc_0, opacity, scale_0, rot_0, …), as 3DGS trainers write it",
    )
}

fn column<'a>(table: &'a Table, path: &Path, name: &str) -> Result<&'a [f64]> {
    table
        .column(name)
        .ok_or_else(|| not_a_scene(path, format!("has no property {name}")))
}

/// Reads a scene into a local frame. Properties are found by name; the SH degree follows from the number of f_rest.
///
/// # Errors
/// A file that is missing, damaged, no 3DGS scene, or holds a value that is not finite.
pub fn read(path: &Path, frame: &Frame) -> Result<Splats> {
    let table = parse(path)?;
    let rest = (0..)
        .take_while(|k| table.column(&format!("f_rest_{k}")).is_some())
        .count();
    let Some(degree) = (0..=3).find(|d| 3 * (sh_coefficients(*d) - 1) == rest) else {
        return Err(not_a_scene(
            path,
            format!("has {rest} f_rest properties; 0, 9, 24 or 45 expected"),
        ));
    };
    let mut planes = vec![vec![0.0f32; table.rows]; Plane::count(degree)];
    let ln_scale = frame.scale.ln();
    for (name, plane) in properties(degree) {
        let Some(p) = plane else { continue };
        let values = column(&table, path, &name)?;
        for (row, (to, v)) in planes[p].iter_mut().zip(values).enumerate() {
            *to = if p < Plane::LOG_SCALE {
                ((v - frame.center[p]) / frame.scale) as f32
            } else if p < Plane::ROTATION {
                (v - ln_scale) as f32
            } else {
                *v as f32
            };
            if !to.is_finite() {
                return Err(not_a_scene(path, format!("{name} of row {row} is {v}")));
            }
        }
    }
    Splats::new(degree, planes)
}

/// Reads a point cloud (x, y, z and, where given, red, green, blue) into a local frame.
///
/// # Errors
/// As [`read`].
pub fn read_points(path: &Path, frame: &Frame) -> Result<Points> {
    let table = parse(path)?;
    let axes = ["x", "y", "z"].map(|n| column(&table, path, n));
    let [x, y, z] = axes;
    let (x, y, z) = (x?, y?, z?);
    let rgb = ["red", "green", "blue"].map(|n| table.column(n));
    let mut points = Points::default();
    for i in 0..table.rows {
        let p = frame.to_local(DVec3::new(x[i], y[i], z[i])).as_vec3();
        if !p.is_finite() {
            return Err(Error::input(
                path,
                format!(
                    "point {i} lies at ({}, {}, {}); finite numbers expected",
                    x[i], y[i], z[i]
                ),
                "remove the point",
            ));
        }
        points.positions.push(p.to_array());
        points
            .colors
            .push(rgb.map(|c| c.map_or(128, |c| c[i].clamp(0.0, 255.0) as u8)));
    }
    Ok(points)
}
