//! `transforms*.json` of Blender (NeRF synthetic) and nerfstudio: camera-to-world matrices in OpenGL axes.

use std::path::{Component, Path, PathBuf};

use glam::{DMat3, DVec3};
use serde::Deserialize;

use super::Camera;
use crate::error::{Error, Result};

/// Intrinsics, for the whole file or for one frame.
#[derive(Debug, Clone, Default, Deserialize)]
pub struct Intrinsics {
    /// Focal length x, pixels.
    pub fl_x: Option<f64>,
    /// Focal length y, pixels (fl_x where absent).
    pub fl_y: Option<f64>,
    /// Principal point x, pixels (the middle where absent).
    pub cx: Option<f64>,
    /// Principal point y, pixels (the middle where absent).
    pub cy: Option<f64>,
    /// Width that the intrinsics are meant for, pixels (the image's where absent).
    pub w: Option<f64>,
    /// Height, likewise.
    pub h: Option<f64>,
    /// Horizontal field of view, radians.
    pub camera_angle_x: Option<f64>,
    /// Lens distortion and anything else.
    #[serde(flatten)]
    pub other: serde_json::Map<String, serde_json::Value>,
}

/// One image.
#[derive(Debug, Clone, Deserialize)]
pub struct Frame {
    /// Path relative to the JSON file, with or without its extension.
    pub file_path: String,
    /// Camera to world, OpenGL axes, row by row.
    pub transform_matrix: Vec<Vec<f64>>,
    /// Intrinsics of this frame alone.
    #[serde(flatten)]
    pub intrinsics: Intrinsics,
}

/// A transforms file.
#[derive(Debug, Clone, Deserialize)]
pub struct Transforms {
    /// Images.
    pub frames: Vec<Frame>,
    /// Sparse points, a PLY file.
    pub ply_file_path: Option<String>,
    /// Intrinsics of all frames.
    #[serde(flatten)]
    pub intrinsics: Intrinsics,
}

const DISTORTION: [&str; 8] = ["k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"];

/// Reads a transforms file.
///
/// # Errors
/// A file that is missing or is no such JSON; lens distortion; a matrix that is not a finite 4×4 or 3×4.
pub fn read(path: &Path) -> Result<Transforms> {
    let fix = "export it again; `frames` with `file_path` and `transform_matrix` are needed";
    let text = std::fs::read_to_string(path)
        .map_err(|e| Error::input(path, format!("cannot be read: {e}"), fix))?;
    let t: Transforms = serde_json::from_str(&text)
        .map_err(|e| Error::input(path, format!("is not a transforms file: {e}"), fix))?;
    if t.frames.is_empty() {
        return Err(Error::input(path, "has no frames", fix));
    }
    for part in std::iter::once(&t.intrinsics).chain(t.frames.iter().map(|f| &f.intrinsics)) {
        let bent = |k: &&str| {
            part.other
                .get(*k)
                .and_then(serde_json::Value::as_f64)
                .is_some_and(|v| v != 0.0)
        };
        if let Some(k) = DISTORTION.iter().find(|k| bent(k)) {
            return Err(Error::input(
                path,
                format!("has lens distortion ({k} is not 0), which is not supported yet"),
                "undistort the images first (COLMAP's image_undistorter) and leave k1, k2, p1, p2 out",
            ));
        }
    }
    for f in &t.frames {
        let m = &f.transform_matrix;
        let good = m.len() >= 3
            && m.iter()
                .take(3)
                .all(|r| r.len() == 4 && r.iter().all(|v| v.is_finite()));
        if !good {
            return Err(Error::input(
                path,
                format!(
                    "the transform_matrix of {} is not a finite 4x4 matrix",
                    f.file_path
                ),
                fix,
            ));
        }
    }
    Ok(t)
}

impl Transforms {
    /// The image file of a frame below `folder`: as named, or with a common extension.
    ///
    /// # Errors
    /// A path that leaves the folder. A missing file is answered with the path as named.
    pub fn image_file(&self, frame: &Frame, folder: &Path) -> Result<PathBuf> {
        inside(folder, &frame.file_path)?;
        let named = folder.join(&frame.file_path);
        if named.is_file() {
            return Ok(named);
        }
        let with = |e: &str| PathBuf::from(format!("{}.{e}", named.display()));
        Ok(["png", "jpg", "jpeg", "webp", "PNG", "JPG"]
            .iter()
            .map(|e| with(e))
            .find(|p| p.is_file())
            .unwrap_or(named))
    }

    /// Camera of a frame whose image file has `size` pixels, in world units.
    ///
    /// # Errors
    /// No focal length, or a matrix that is no rotation with translation.
    pub fn camera_of(&self, frame: &Frame, size: [u32; 2], path: &Path) -> Result<Camera> {
        let pick = |f: fn(&Intrinsics) -> Option<f64>| f(&frame.intrinsics).or(f(&self.intrinsics));
        let wrong = |what: String| Error::input(path, what, "export it again");
        let w = pick(|i| i.w).unwrap_or(f64::from(size[0]));
        let h = pick(|i| i.h).unwrap_or(f64::from(size[1]));
        let by_angle = pick(|i| i.camera_angle_x).map(|a| 0.5 * w / (0.5 * a).tan());
        let fx = pick(|i| i.fl_x).or(by_angle).unwrap_or(0.0);
        let fy = pick(|i| i.fl_y).unwrap_or(fx);
        if !(fx > 0.0 && fy > 0.0 && fx.is_finite() && fy.is_finite() && w >= 1.0 && h >= 1.0) {
            return Err(wrong(format!(
                "{} has no usable focal length; fl_x or camera_angle_x expected",
                frame.file_path
            )));
        }
        let m = |r: usize, c: usize| frame.transform_matrix[r][c];
        // Columns of camera-to-world; OpenGL's y up and z backward become OpenCV's y down and z forward. A uniform
        // scale in the matrix (some exporters leave one) is taken out.
        let column = |c: usize| DVec3::new(m(0, c), m(1, c), m(2, c));
        let [x, y, z] = [column(0), -column(1), -column(2)].map(DVec3::normalize_or_zero);
        let to_world = DMat3::from_cols(x, y, z);
        if (to_world.determinant() - 1.0).abs() > 1e-3 {
            return Err(wrong(format!(
                "the transform_matrix of {} is not a rotation",
                frame.file_path
            )));
        }
        let rotation = to_world.transpose();
        Ok(Camera {
            rotation,
            translation: -(rotation * column(3)),
            fx,
            fy,
            cx: pick(|i| i.cx).unwrap_or(0.5 * w),
            cy: pick(|i| i.cy).unwrap_or(0.5 * h),
            width: w as u32,
            height: h as u32,
        })
    }
}

/// Refuses a path that leaves `folder`.
///
/// # Errors
/// An absolute path, or one with `..`.
pub fn inside(folder: &Path, relative: &str) -> Result<()> {
    let leaves = Path::new(relative)
        .components()
        .any(|c| !matches!(c, Component::Normal(_) | Component::CurDir));
    if leaves {
        return Err(Error::input(
            folder,
            format!("names the image {relative:?} outside of the dataset"),
            "use paths below the dataset's folder",
        ));
    }
    Ok(())
}
