//! Plain point clouds as PLY files: the sparse points beside a transforms file.

use std::io::Write;
use std::path::Path;

use glam::DVec3;

use crate::base::error::{Error, Result};
use crate::base::ply;
use crate::capture::frame::Frame;

/// Sparse points in the local frame.
#[derive(Debug, Clone, Default)]
pub struct Points {
    /// Positions, local units.
    pub positions: Vec<[f32; 3]>,
    /// 8-bit RGB colours, one per position.
    pub colors: Vec<[u8; 3]>,
}

impl Points {
    /// Points of the dataset's frame, moved to the local one in f64; `path` is the place of any error.
    ///
    /// # Errors
    /// [`Error::Input`] for a position beyond single precision.
    pub(crate) fn local(
        path: &Path,
        frame: &Frame,
        (positions, colors): (Vec<DVec3>, Vec<[u8; 3]>),
    ) -> Result<Self> {
        let local = |p: DVec3| frame.to_local(p).as_vec3().to_array();
        let positions: Vec<[f32; 3]> = positions.into_iter().map(local).collect();
        let far = |p: &[f32; 3]| p.iter().any(|v| !v.is_finite());
        if let Some(i) = positions.iter().position(far) {
            let what = format!("point {i} lies too far from the cameras for single precision");
            return Err(Error::input(path, what, "remove the point"));
        }
        Ok(Self { positions, colors })
    }
}

/// Writes a plain point cloud (`x y z red green blue`, double precision) in the dataset's frame, atomically.
///
/// # Errors
/// [`Error::Numerics`] for unequal lengths or a coordinate that is not finite, [`Error::Io`].
pub fn write(path: &Path, points: &Points, frame: &Frame) -> Result<()> {
    let (n, colors) = (points.positions.len(), points.colors.len());
    let finite = |p: &[f32; 3]| p.iter().all(|v| v.is_finite());
    if n != colors || !points.positions.iter().all(finite) {
        let what = format!("{n} points, not all finite or not matched by {colors} colours");
        return Err(Error::numerics("export", what));
    }
    let xyz = ["x", "y", "z"].map(|name| ("double", name));
    let rgb = ["red", "green", "blue"].map(|name| ("uchar", name));
    ply::write(path, "", n, xyz.into_iter().chain(rgb), |out| {
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
