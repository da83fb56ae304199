//! COLMAP models (`sparse/0`), binary and text: cameras, images, points3D.

mod bin;
mod txt;
mod write;

use std::path::{Path, PathBuf};

use glam::{DMat3, DQuat, DVec3};

pub use write::{write_bin, write_txt};

use super::{Camera, Layout};
use crate::error::{Error, Result};

/// A camera of the model.
#[derive(Debug, Clone, PartialEq)]
pub struct ColmapCamera {
    /// COLMAP's id.
    pub id: u32,
    /// Model, always one of [`MODELS`].
    pub model: &'static str,
    /// Width, pixels.
    pub width: u64,
    /// Height, pixels.
    pub height: u64,
    /// Parameters in COLMAP's order.
    pub params: Vec<f64>,
}

/// A registered image.
#[derive(Debug, Clone, PartialEq)]
pub struct ColmapImage {
    /// COLMAP's id.
    pub id: u32,
    /// Rotation world → camera, w x y z.
    pub rotation: [f64; 4],
    /// Translation world → camera.
    pub translation: [f64; 3],
    /// Id of its camera.
    pub camera: u32,
    /// File name below `images/`.
    pub name: String,
}

/// A sparse point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ColmapPoint {
    /// Position, world.
    pub position: [f64; 3],
    /// 8-bit RGB.
    pub color: [u8; 3],
}

/// A sparse model.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ColmapModel {
    /// Cameras.
    pub cameras: Vec<ColmapCamera>,
    /// Images.
    pub images: Vec<ColmapImage>,
    /// Points.
    pub points: Vec<ColmapPoint>,
}

/// Names and numbers of parameters of COLMAP's camera models, by their ids from 0 on.
pub const MODELS: [(&str, usize); 18] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    ("SIMPLE_DIVISION", 4),
    ("DIVISION", 5),
    ("SIMPLE_FISHEYE", 3),
    ("FISHEYE", 4),
    ("EQUIRECTANGULAR", 2),
    ("OTHER", 0),
];

/// The camera file of a model in `folder`, binary preferred.
#[must_use]
pub fn find(folder: &Path) -> Option<(PathBuf, Layout)> {
    [
        ("cameras.bin", Layout::ColmapBin),
        ("cameras.txt", Layout::ColmapTxt),
    ]
    .into_iter()
    .map(|(name, layout)| (folder.join(name), layout))
    .find(|(file, _)| file.exists())
}

/// Reads the model in `folder`.
///
/// # Errors
/// A missing or damaged file, or values that are not finite.
pub fn read(folder: &Path, layout: Layout) -> Result<ColmapModel> {
    let model = match layout {
        Layout::ColmapBin => bin::read(folder)?,
        _ => txt::read(folder)?,
    };
    let extension = if layout == Layout::ColmapBin {
        "bin"
    } else {
        "txt"
    };
    check(&model, folder, extension)?;
    Ok(model)
}

fn check(model: &ColmapModel, folder: &Path, extension: &str) -> Result<()> {
    let bad = |stem: &str, what: String| {
        Err(Error::input(
            folder.join(format!("{stem}.{extension}")),
            what,
            "run the reconstruction again, or remove the entry",
        ))
    };
    for (k, p) in model.points.iter().enumerate() {
        if !p.position.iter().all(|v| v.is_finite()) {
            return bad(
                "points3D",
                format!(
                    "point {k} lies at {:?}; finite numbers expected",
                    p.position
                ),
            );
        }
    }
    for i in &model.images {
        let finite = i
            .rotation
            .iter()
            .chain(&i.translation)
            .all(|v| v.is_finite());
        if !finite || i.rotation.iter().all(|v| *v == 0.0) {
            return bad(
                "images",
                format!("the pose of {} is not finite, or no rotation", i.name),
            );
        }
    }
    if model.images.is_empty() {
        return bad("images", "no registered image".into());
    }
    for c in &model.cameras {
        let focal_good = c.params.first().is_some_and(|f| *f > 0.0);
        if !c.params.iter().all(|v| v.is_finite()) || !focal_good || c.width == 0 || c.height == 0 {
            return bad(
                "cameras",
                format!("camera {} has unusable size or parameters", c.id),
            );
        }
    }
    Ok(())
}

impl ColmapModel {
    /// The pinhole camera of an image, in world units.
    ///
    /// # Errors
    /// A camera model with lens distortion, named with the remedy; or an id that no camera has.
    pub fn camera_of(&self, image: &ColmapImage, folder: &Path) -> Result<Camera> {
        let file = |stem: &str| find(folder).map_or_else(|| folder.join(stem), |(f, _)| f);
        let Some(c) = self.cameras.iter().find(|c| c.id == image.camera) else {
            return Err(Error::input(
                file("cameras"),
                format!(
                    "no camera {}, which {} was taken with",
                    image.camera, image.name
                ),
                "export the model again",
            ));
        };
        let (fx, fy, cx, cy) = match (c.model, c.params.as_slice()) {
            ("SIMPLE_PINHOLE", [f, cx, cy]) => (*f, *f, *cx, *cy),
            ("PINHOLE", [fx, fy, cx, cy]) => (*fx, *fy, *cx, *cy),
            (model, _) => {
                return Err(Error::input(
                    file("cameras"),
                    format!(
                        "camera {} has the model {model}; PINHOLE or SIMPLE_PINHOLE expected",
                        c.id
                    ),
                    "undistort first: `colmap image_undistorter --image_path images --input_path sparse/0 --output_path undistorted`",
                ));
            }
        };
        let [w, x, y, z] = image.rotation;
        Ok(Camera {
            rotation: DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize()),
            translation: DVec3::from_array(image.translation),
            fx,
            fy,
            cx,
            cy,
            width: u32::try_from(c.width).unwrap_or(u32::MAX),
            height: u32::try_from(c.height).unwrap_or(u32::MAX),
        })
    }
}
