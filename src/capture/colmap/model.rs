//! Cameras, images and points of a COLMAP sparse model.

use std::collections::HashSet;
use std::path::PathBuf;

use glam::DQuat;

use crate::base::error::{Error, Result};
use crate::capture::camera::Camera;
use crate::capture::lens::Lens;

/// Fix in the messages about damaged model files.
pub(super) const REBUILD: &str = "export the COLMAP model again";

/// A camera of a COLMAP model (a `SIMPLE_PINHOLE` has `fx == fy`).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ColmapCamera {
    /// Identifier, unique within the model.
    pub id: u32,
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Focal lengths and principal point fx, fy, cx, cy, pixels; pixel centres at +0.5.
    pub params: [f64; 4],
    /// Distortion; a model is written without it.
    pub lens: Lens,
}

/// A registered image of a COLMAP model.
#[derive(Debug, Clone, PartialEq)]
pub struct ColmapImage {
    /// Identifier, unique within the model.
    pub id: u32,
    /// World-to-camera rotation as a quaternion w, x, y, z (normalised on use).
    pub rotation: [f64; 4],
    /// World-to-camera translation, dataset units.
    pub translation: [f64; 3],
    /// Identifier of its camera.
    pub camera_id: u32,
    /// File name relative to `images/`, with forward slashes.
    pub name: String,
}

/// A triangulated point of a COLMAP model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ColmapPoint {
    /// Identifier, unique within the model.
    pub id: u64,
    /// Position, dataset units.
    pub position: [f64; 3],
    /// RGB colour.
    pub color: [u8; 3],
    /// Mean reprojection error, pixels.
    pub error: f64,
}

/// A COLMAP sparse model.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ColmapModel {
    /// Cameras, in the file's order.
    pub cameras: Vec<ColmapCamera>,
    /// Registered images, in the file's order.
    pub images: Vec<ColmapImage>,
    /// Points, in the file's order.
    pub points: Vec<ColmapPoint>,
}

impl ColmapModel {
    /// A model of named cameras in the dataset's frame; images with equal intrinsics share a camera. Identifiers count
    /// from 1.
    #[must_use]
    pub fn from_views(views: &[(String, Camera)], points: Vec<ColmapPoint>) -> Self {
        let mut model = Self {
            points,
            ..Self::default()
        };
        for (name, camera) in views {
            let wanted = ColmapCamera {
                id: model.cameras.len() as u32 + 1,
                width: camera.width,
                height: camera.height,
                params: [camera.fx, camera.fy, camera.cx, camera.cy],
                lens: Lens::Pinhole,
            };
            let same = |c: &&ColmapCamera| ColmapCamera { id: c.id, ..wanted } == **c;
            let camera_id = if let Some(c) = model.cameras.iter().find(same) {
                c.id
            } else {
                model.cameras.push(wanted);
                wanted.id
            };
            let q = DQuat::from_mat3(&camera.rotation);
            model.images.push(ColmapImage {
                id: model.images.len() as u32 + 1,
                rotation: [q.w, q.x, q.y, q.z],
                translation: camera.translation.to_array(),
                camera_id,
                name: name.clone(),
            });
        }
        model
    }

    /// Refuses non-finite numbers, unusable intrinsics, repeated identifiers and unknown cameras. `file` gives the path of each
    /// of the three files by its stem.
    pub(super) fn validate(&self, file: impl Fn(&str) -> PathBuf) -> Result<()> {
        let bad = |stem: &str, what: String| Err(Error::input(file(stem), what, REBUILD));
        let mut ids = HashSet::new();
        for c in &self.cameras {
            let [fx, fy, cx, cy] = c.params;
            let finite = c.lens.is_finite() && c.params.iter().all(|v| v.is_finite());
            if !(finite && fx > 0.0 && fy > 0.0 && c.width > 0 && c.height > 0) {
                return bad(
                    "cameras",
                    format!(
                        "camera {} is {}×{} with fx {fx}, fy {fy}, cx {cx}, cy {cy}, {:?}; positive sizes and focal lengths expected",
                        c.id, c.width, c.height, c.lens
                    ),
                );
            }
            if !ids.insert(c.id) {
                return bad("cameras", format!("camera {} is given twice", c.id));
            }
        }
        let mut names = HashSet::new();
        for (i, image) in self.images.iter().enumerate() {
            let [w, x, y, z] = image.rotation;
            let norm = (w * w + x * x + y * y + z * z).sqrt();
            let good = norm > 1e-6 && norm < 1e6 && image.translation.iter().all(|v| v.is_finite());
            if !good {
                return bad(
                    "images",
                    format!(
                        "image {i} ({}) has the pose q = {:?}, t = {:?}; finite numbers and a non-zero quaternion expected",
                        image.name, image.rotation, image.translation
                    ),
                );
            }
            if !ids.contains(&image.camera_id) {
                let what = format!("{} uses camera {}, which", image.name, image.camera_id);
                return bad("images", format!("{what} the cameras file does not hold"));
            }
            if !names.insert(image.name.as_str()) {
                return bad("images", format!("image {} is given twice", image.name));
            }
        }
        for (i, p) in self.points.iter().enumerate() {
            if !p.position.iter().all(|v| v.is_finite()) {
                return bad(
                    "points3D",
                    format!(
                        "point {i} lies at {:?}; finite numbers expected",
                        p.position
                    ),
                );
            }
        }
        if self.images.is_empty() {
            return bad(
                "images",
                "no registered image; at least one expected".into(),
            );
        }
        Ok(())
    }
}
