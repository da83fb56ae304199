//! COLMAP sparse models: `cameras`, `images` and `points3D`, binary or text.
//!
//! Format: <https://colmap.github.io/format.html>. Poses are world-to-camera in OpenCV axes, which is the convention of
//! [`Camera`] too. Point tracks and 2D observations are skipped when reading and left empty when writing.
//!
//! COLMAP 3.12 and later also write `rigs` and `frames`, which are not read: `images` still has the registered images alone,
//! each with its whole pose, sensor_from_rig ∘ rig_from_world.

mod bin;
mod models;
mod txt;

pub use crate::capture::colmap::bin::{read_bin, write_bin};
pub use crate::capture::colmap::txt::{read_txt, write_txt};

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use glam::{DMat3, DQuat, DVec3};

use crate::base::error::{Error, Result};
use crate::capture::Layout;
use crate::capture::assemble::{RawScene, RawView, find_mask, locate};
use crate::capture::camera::Camera;
use crate::capture::lens::Lens;

/// Remedy for anything wrong inside of a model file.
const REBUILD: &str = "export the COLMAP model again";

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

    /// What both readers check: finite numbers, usable intrinsics, unique identifiers, known cameras. `file` gives the
    /// path of each of the three files by its stem.
    fn validate(&self, file: impl Fn(&str) -> PathBuf) -> Result<()> {
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

/// The folder below `root` that holds a sparse model, and its layout. `sparse/` itself is accepted too, because that is
/// where `colmap image_undistorter` writes.
pub(in crate::capture) fn find(root: &Path) -> Option<(PathBuf, Layout)> {
    ["sparse/0", "sparse"].iter().find_map(|below| {
        let dir = root.join(below);
        if dir.join("cameras.bin").is_file() {
            Some((dir, Layout::ColmapBin))
        } else if dir.join("cameras.txt").is_file() {
            Some((dir, Layout::ColmapTxt))
        } else {
            None
        }
    })
}

/// Reads the model in `dir` with photos in `root/images`.
///
/// # Errors
/// See [`read_bin`] and [`read_txt`]; also a missing `images` folder or image names that leave it.
pub(in crate::capture) fn load(root: &Path, dir: &Path, layout: Layout) -> Result<RawScene> {
    let model = if layout == Layout::ColmapBin {
        read_bin(dir)?
    } else {
        read_txt(dir)?
    };
    let folder = root.join("images");
    if !folder.is_dir() {
        return Err(Error::input(
            &folder,
            "no such folder; the photos of a COLMAP dataset are expected there",
            "copy or link the photos to it",
        ));
    }
    let cameras: HashMap<u32, &ColmapCamera> = model.cameras.iter().map(|c| (c.id, c)).collect();
    let mut train = Vec::with_capacity(model.images.len());
    let mut missing = Vec::new();
    for image in &model.images {
        let Some(c) = cameras.get(&image.camera_id) else {
            continue; // validate() refused unknown cameras
        };
        let [w, x, y, z] = image.rotation;
        let [fx, fy, cx, cy] = c.params;
        let Some(file) = locate(&folder, &image.name)? else {
            missing.push(image.name.clone());
            continue;
        };
        train.push(RawView {
            name: image.name.clone(),
            mask: find_mask(root, &image.name),
            file,
            camera: Camera {
                rotation: DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize()),
                translation: DVec3::from_array(image.translation),
                fx,
                fy,
                cx,
                cy,
                width: c.width,
                height: c.height,
            },
            lens: c.lens,
        });
    }
    Ok(RawScene {
        layout,
        train,
        test: None,
        missing,
        positions: model.points.iter().map(|p| p.position.into()).collect(),
        colors: model.points.iter().map(|p| p.color).collect(),
    })
}
