//! COLMAP's camera models: supported ones, and refusal of the others by name.

use std::path::Path;

use crate::base::error::{Error, Result};
use crate::capture::colmap::model::{ColmapCamera, REBUILD};
use crate::capture::lens::Lens;

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
    /// f, cx, cy, k1.
    SimpleRadial,
    /// f, cx, cy, k1, k2.
    Radial,
    /// fx, fy, cx, cy, k1, k2, p1, p2.
    OpenCv,
    /// fx, fy, cx, cy, k1, k2, k3, k4.
    OpenCvFisheye,
    /// fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6.
    FullOpenCv,
    /// f, cx, cy, k1.
    SimpleRadialFisheye,
    /// f, cx, cy, k1, k2.
    RadialFisheye,
}

impl Model {
    /// The model of a name in a text file.
    ///
    /// # Errors
    /// An unsupported model.
    pub(super) fn from_name(file: &Path, camera: u32, name: &str) -> Result<Self> {
        match name {
            "SIMPLE_PINHOLE" => Ok(Self::SimplePinhole),
            "PINHOLE" => Ok(Self::Pinhole),
            "SIMPLE_RADIAL" => Ok(Self::SimpleRadial),
            "RADIAL" => Ok(Self::Radial),
            "OPENCV" => Ok(Self::OpenCv),
            "OPENCV_FISHEYE" => Ok(Self::OpenCvFisheye),
            "FULL_OPENCV" => Ok(Self::FullOpenCv),
            "SIMPLE_RADIAL_FISHEYE" => Ok(Self::SimpleRadialFisheye),
            "RADIAL_FISHEYE" => Ok(Self::RadialFisheye),
            known if NAMES.contains(&known) => Err(refused(file, camera, known)),
            other => Err(refused(file, camera, &format!("'{other}' (unknown)"))),
        }
    }

    /// The model of an identifier in a binary file.
    ///
    /// # Errors
    /// An unsupported model.
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
            Self::Pinhole | Self::SimpleRadial | Self::SimpleRadialFisheye => 4,
            Self::Radial | Self::RadialFisheye => 5,
            Self::OpenCv | Self::OpenCvFisheye => 8,
            Self::FullOpenCv => 12,
        }
    }

    /// fx, fy, cx, cy and the lens; `None` for another number of parameters.
    fn split(self, params: &[f64]) -> Option<([f64; 4], Lens)> {
        let perspective = |radial: &[f64], tangential: [f64; 2]| {
            let mut k = [0.0; 6];
            k[..radial.len()].copy_from_slice(radial);
            Lens::Perspective {
                radial: k,
                tangential,
            }
        };
        let fisheye = |radial: &[f64]| {
            let mut k = [0.0; 4];
            k[..radial.len()].copy_from_slice(radial);
            Lens::Fisheye { radial: k }
        };
        let (pinhole, lens) = match (self, params) {
            (Self::SimplePinhole, &[f, cx, cy]) => ([f, f, cx, cy], Lens::Pinhole),
            (Self::Pinhole, &[fx, fy, cx, cy]) => ([fx, fy, cx, cy], Lens::Pinhole),
            (Self::SimpleRadial, &[f, cx, cy, k1]) => {
                ([f, f, cx, cy], perspective(&[k1], [0.0; 2]))
            }
            (Self::Radial, &[f, cx, cy, k1, k2]) => {
                ([f, f, cx, cy], perspective(&[k1, k2], [0.0; 2]))
            }
            (Self::OpenCv, &[fx, fy, cx, cy, k1, k2, p1, p2]) => {
                ([fx, fy, cx, cy], perspective(&[k1, k2], [p1, p2]))
            }
            (Self::FullOpenCv, &[fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6]) => (
                [fx, fy, cx, cy],
                perspective(&[k1, k2, k3, k4, k5, k6], [p1, p2]),
            ),
            (Self::OpenCvFisheye, &[fx, fy, cx, cy, ref k @ ..]) if k.len() == 4 => {
                ([fx, fy, cx, cy], fisheye(k))
            }
            (Self::SimpleRadialFisheye, &[f, cx, cy, k1]) => ([f, f, cx, cy], fisheye(&[k1])),
            (Self::RadialFisheye, &[f, cx, cy, k1, k2]) => ([f, f, cx, cy], fisheye(&[k1, k2])),
            _ => return None,
        };
        Some((pinhole, lens.simplified()))
    }

    /// A camera from [`Model::count`] parameters.
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
        let Some((params, lens)) = self.split(params) else {
            let what = format!(
                "camera {id} ({self:?}) has {} parameters; {} expected",
                params.len(),
                self.count()
            );
            return Err(Error::input(file, what, REBUILD));
        };
        match (u32::try_from(width), u32::try_from(height)) {
            (Ok(width), Ok(height)) => Ok(ColmapCamera {
                id,
                width,
                height,
                params,
                lens,
            }),
            _ => Err(Error::input(
                file,
                format!("camera {id} is {width}×{height} pixels"),
                REBUILD,
            )),
        }
    }
}

/// The error for an unsupported camera model.
fn refused(file: &Path, camera: u32, model: &str) -> Error {
    Error::input(
        file,
        format!("camera {camera} has the model {model}, which is not read"),
        "undistort first: colmap image_undistorter --image_path <photos> --input_path <this folder> --output_path <new dataset>",
    )
}
