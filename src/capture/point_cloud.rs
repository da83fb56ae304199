//! Plain point clouds as PLY files: the sparse points beside a transforms file.

use std::io::Write;
use std::path::Path;

use glam::DVec3;

use crate::base::error::{Error, Result};
use crate::base::ply;
use crate::capture::Points;
use crate::capture::frame::Frame;

/// Reads a plain point cloud (`x y z`, and `red green blue` where there are any; grey otherwise) into the local frame.
///
/// # Errors
/// [`Error::Input`] for what is no such file, is truncated or holds a value that is not finite; [`Error::Io`].
pub fn read(path: &Path, frame: &Frame) -> Result<Points> {
    from_table(path, &ply::Table::read(path)?, frame)
}

/// As [`read`], of a file that is read already.
///
/// # Errors
/// As [`read`].
pub(crate) fn from_table(path: &Path, table: &ply::Table, frame: &Frame) -> Result<Points> {
    let (positions, colors) = table.points()?;
    let local = |p: DVec3| frame.to_local(p).as_vec3().to_array();
    let positions: Vec<[f32; 3]> = positions.into_iter().map(local).collect();
    let far = |p: &[f32; 3]| p.iter().any(|v| !v.is_finite());
    if let Some(row) = positions.iter().position(far) {
        let what = format!("vertex {row} is beyond single precision");
        return Err(Error::input(path, what, "remove the vertex"));
    }
    Ok(Points { positions, colors })
}

/// Writes a plain point cloud (`x y z red green blue`, double precision) in the dataset's frame, atomically.
///
/// # Errors
/// [`Error::Numerics`] for unequal lengths or a coordinate that is not finite, [`Error::Io`].
pub fn write(path: &Path, points: &Points, frame: &Frame) -> Result<()> {
    let (n, colors) = (points.positions.len(), points.colors.len());
    let finite = |p: &[f32; 3]| p.iter().all(|v| v.is_finite());
    if n != colors || !points.positions.iter().all(finite) {
        return Err(Error::Numerics {
            stage: "export".into(),
            what: format!("{n} points, not all finite or not matched by {colors} colours"),
        });
    }
    crate::base::files::write(path, |out| {
        let (xyz, rgb) = (["x", "y", "z"], ["red", "green", "blue"]);
        let line = |scalar: &str, name: &str| format!("property {scalar} {name}\n");
        let coordinates: String = xyz.iter().map(|c| line("double", c)).collect();
        let channels: String = rgb.iter().map(|c| line("uchar", c)).collect();
        write!(
            out,
            "ply\nformat binary_little_endian 1.0\nelement vertex {n}\n{coordinates}{channels}end_header\n"
        )?;
        for (p, color) in points.positions.iter().zip(&points.colors) {
            let p = frame.to_dataset(DVec3::from_array(p.map(f64::from)));
            for v in p.to_array() {
                out.write_all(&v.to_le_bytes())?;
            }
            out.write_all(color)?;
        }
        Ok(())
    })
}
