//! OpenSfM's `reconstruction.json`, which OpenDroneMap writes, too.
//!
//! Format and lens models: OpenSfM's documentation, "Reconstruction file format" and "Coordinate systems",
//! <https://opensfm.org/docs/>. Poses are world-to-camera, the rotation an axis times an angle, with x right, y down, z forward. Lengths on a
//! photo are normalised by its larger side and counted from its middle.

use std::collections::BTreeMap;
use std::path::Path;

use glam::{DMat3, DQuat, DVec3};
use serde::Deserialize;

use crate::base::error::{Error, Result};
use crate::capture::assemble::RawScene;
use crate::capture::camera::Camera;
use crate::capture::dataset::Layout;
use crate::capture::exports::shared::{document, scene};
use crate::capture::lens::Lens;
use crate::capture::panorama;
use crate::capture::source;

/// True for a text that begins as a reconstruction does.
pub(super) fn is_reconstruction(text: &str) -> bool {
    text.trim_start().starts_with('[') && text.contains("\"projection_type\"")
}

/// Photos that are connected with each other.
#[derive(Deserialize)]
struct Reconstruction {
    cameras: BTreeMap<String, Calibration>,
    shots: BTreeMap<String, Shot>,
    #[serde(default)]
    points: BTreeMap<String, Point>,
}

#[derive(Deserialize)]
struct Shot {
    camera: String,
    rotation: [f64; 3],
    translation: [f64; 3],
}

#[derive(Deserialize)]
struct Point {
    coordinates: [f64; 3],
    #[serde(default)]
    color: [f64; 3],
}

/// Lens and focal lengths; what a model does not have is left out of the file.
#[derive(Deserialize)]
struct Calibration {
    projection_type: String,
    focal: Option<f64>,
    focal_x: Option<f64>,
    focal_y: Option<f64>,
    #[serde(default)]
    c_x: f64,
    #[serde(default)]
    c_y: f64,
    #[serde(default)]
    k1: f64,
    #[serde(default)]
    k2: f64,
    #[serde(default)]
    k3: f64,
    #[serde(default)]
    k4: f64,
    #[serde(default)]
    p1: f64,
    #[serde(default)]
    p2: f64,
}

impl Calibration {
    /// Focal lengths and principal point (fx, fy, cx, cy) on a photo of this size, and the lens; or what is wrong.
    fn on(&self, [width, height]: [u32; 2]) -> std::result::Result<([f64; 4], Lens), String> {
        let lens = match self.projection_type.as_str() {
            "perspective" | "simple_radial" | "radial" | "brown" => {
                Lens::of_coefficients(&[self.k1, self.k2, self.p1, self.p2, self.k3], false)
            }
            "fisheye" | "fisheye_opencv" => Lens::Fisheye {
                radial: [self.k1, self.k2, self.k3, self.k4],
            },
            "spherical" | "equirectangular" => {
                return Ok((panorama::intrinsics(width, height), Lens::Equirectangular));
            }
            other => {
                return Err(format!(
                    "of the projection type {other}, which is not read; give OpenSfM's undistorted photos with their reconstruction.json"
                ));
            }
        };
        let [x, y] = [self.focal_x, self.focal_y].map(|f| f.or(self.focal).unwrap_or(0.0));
        if !(x > 0.0 && y > 0.0) {
            return Err("without a focal length".into());
        }
        let side = f64::from(width.max(height));
        let [w, h] = [width, height].map(|s| f64::from(s) / 2.0);
        let of = [side * x, side * y, side * self.c_x + w, side * self.c_y + h];
        Ok((of, lens))
    }
}

/// The views and points of the reconstruction of most photos in a file in `root`.
///
/// # Errors
/// JSON of another kind, no photo, a lens that is not read; what [`scene`] refuses.
pub(super) fn load(root: &Path, file: &Path, asked: Option<&Path>) -> Result<RawScene> {
    let bad = |what: String| Error::input(file, what, "export the reconstruction again");
    let all: Vec<Reconstruction> = document(file)?;
    let several = all.len();
    let most = all.into_iter().rev().max_by_key(|part| part.shots.len());
    let Some(part) = most.filter(|part| !part.shots.is_empty()) else {
        return Err(bad("no photo with a pose".into()));
    };
    let (names, shots): (Vec<&str>, Vec<&Shot>) =
        part.shots.iter().map(|(n, s)| (n.as_str(), s)).unzip();
    let mut scene = scene((root, file, Layout::OpenSfm), asked, &names, |i, image| {
        let (name, shot) = (names[i], shots[i]);
        let Some(found) = part.cameras.get(&shot.camera) else {
            return Err(bad(format!("{name} has a camera that is not there")));
        };
        let header = source::header(image)?;
        let size = [header.width, header.height];
        let (of, lens) = found
            .on(size)
            .map_err(|what| bad(format!("the camera of {name} is {what}")))?;
        let turn = DQuat::from_scaled_axis(DVec3::from_array(shot.rotation));
        let pose = (DMat3::from_quat(turn), DVec3::from_array(shot.translation));
        Ok((Camera::new(of, size, pose), lens))
    })?;
    for point in part.points.values() {
        scene.positions.push(DVec3::from_array(point.coordinates));
        scene
            .colors
            .push(point.color.map(|v| v.clamp(0.0, 255.0) as u8));
    }
    if several > 1 {
        scene.remarks.push(format!(
            "warning: only the {} photos of the largest of {several} reconstructions are used; the others are not connected with it",
            names.len()
        ));
    }
    Ok(scene)
}
