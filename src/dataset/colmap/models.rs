//! COLMAP's camera models: the two pinhole ones are read, the others refused by name.

use std::path::Path;

use super::ColmapCamera;
use crate::error::{Error, Result};

/// Names in the order of COLMAP's identifiers (`src/colmap/sensor/models.h`).
const NAMES: [&str; 14] = [
    "SIMPLE_PINHOLE",
    "PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
    "OPENCV_FISHEYE",
    "FULL_OPENCV",
    "FOV",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
    "THIN_PRISM_FISHEYE",
    "RAD_TAN_THIN_PRISM_FISHEYE",
    "SIMPLE_DIVISION",
    "DIVISION",
];

/// Identifier of `PINHOLE`, the model that is written.
pub(super) const PINHOLE: i32 = 1;

/// A camera model that can be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Model {
    /// f, cx, cy.
    SimplePinhole,
    /// fx, fy, cx, cy.
    Pinhole,
}

impl Model {
    /// # Errors
    /// Every model but the pinhole ones.
    pub(super) fn from_name(file: &Path, camera: u32, name: &str) -> Result<Self> {
        match name {
            "SIMPLE_PINHOLE" => Ok(Self::SimplePinhole),
            "PINHOLE" => Ok(Self::Pinhole),
            known if NAMES.contains(&known) => Err(refused(file, camera, known)),
            other => Err(refused(file, camera, &format!("'{other}' (unknown)"))),
        }
    }

    /// # Errors
    /// Every model but the pinhole ones.
    pub(super) fn from_id(file: &Path, camera: u32, id: i32) -> Result<Self> {
        match usize::try_from(id).ok().and_then(|i| NAMES.get(i)) {
            Some(name) => Self::from_name(file, camera, name),
            None => Err(refused(file, camera, &format!("number {id} (unknown)"))),
        }
    }

    /// Number of parameters in the file.
    pub(super) const fn count(self) -> usize {
        match self {
            Self::SimplePinhole => 3,
            Self::Pinhole => 4,
        }
    }

    /// A camera from as many parameters as [`Model::count`] says.
    ///
    /// # Errors
    /// Another number of parameters, or an image of more than `u32::MAX` pixels on a side.
    pub(super) fn camera(
        self,
        file: &Path,
        id: u32,
        (width, height): (u64, u64),
        params: &[f64],
    ) -> Result<ColmapCamera> {
        let params = match (self, params) {
            (Self::SimplePinhole, &[f, cx, cy]) => [f, f, cx, cy],
            (Self::Pinhole, &[fx, fy, cx, cy]) => [fx, fy, cx, cy],
            _ => {
                let what = format!(
                    "camera {id} has {} parameters; {} expected",
                    params.len(),
                    self.count()
                );
                return Err(Error::input(file, what, super::REBUILD));
            }
        };
        match (u32::try_from(width), u32::try_from(height)) {
            (Ok(width), Ok(height)) => Ok(ColmapCamera {
                id,
                width,
                height,
                params,
            }),
            _ => Err(Error::input(
                file,
                format!("camera {id} is {width}×{height} pixels"),
                super::REBUILD,
            )),
        }
    }
}

fn refused(file: &Path, camera: u32, model: &str) -> Error {
    Error::input(
        file,
        format!("camera {camera} has the model {model}; PINHOLE or SIMPLE_PINHOLE expected"),
        "undistort first: colmap image_undistorter --image_path <photos> --input_path <this folder> --output_path <new dataset>",
    )
}
