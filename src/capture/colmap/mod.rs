//! COLMAP sparse models: `cameras`, `images` and `points3D`, binary or text.
//!
//! Format: <https://colmap.github.io/format.html>. Poses are world-to-camera in OpenCV axes, which is the convention of
//! [`Camera`] too. Point tracks and 2D observations are skipped when reading and left empty when writing.
//!
//! COLMAP 3.12 and later also write `rigs` and `frames`, which are not read: `images` still has the registered images alone,
//! each with its whole pose, sensor_from_rig ∘ rig_from_world.

mod form;
mod model;
mod places;

pub use crate::capture::colmap::model::{ColmapCamera, ColmapImage, ColmapModel, ColmapPoint};
pub(crate) use crate::capture::colmap::places::{Place, find, photos};

use std::collections::HashMap;
use std::path::Path;

use glam::{DMat3, DQuat, DVec3};

use crate::base::error::{Error, Result};
use crate::capture::assemble::{RawScene, RawView, find_mask};
use crate::capture::camera::Camera;
use crate::capture::dataset::Layout;
use crate::capture::images::{Images, short};

/// The views and points of a model of `root`.
///
/// # Errors
/// See [`ColmapModel::read`]; also a missing folder of photos or image names that leave it.
pub(crate) fn load(
    root: &Path,
    place: &Place,
    remarks: Vec<String>,
    asked: Option<&Path>,
) -> Result<RawScene> {
    let model = ColmapModel::read(&place.model, place.layout == Layout::ColmapBin)?;
    let folder = &place.photos;
    let names = model.images.iter().map(|image| image.name.as_str());
    let found = Images::new(root, folder.clone(), asked)?.find(names)?;
    if !folder.is_dir() && found.files.iter().all(Option::is_none) {
        return Err(Error::input(
            folder,
            "no such folder; the photos of a COLMAP dataset are expected there",
            "copy or link the photos to it, or name their folder with --images DIR",
        ));
    }
    let cameras: HashMap<u32, &ColmapCamera> = model.cameras.iter().map(|c| (c.id, c)).collect();
    let mut train = Vec::with_capacity(model.images.len());
    let mut missing = Vec::new();
    for (image, file) in model.images.iter().zip(found.files) {
        let Some(c) = cameras.get(&image.camera_id) else {
            continue; // validate() refused unknown cameras
        };
        let [w, x, y, z] = image.rotation;
        let [fx, fy, cx, cy] = c.params;
        let Some(file) = file else {
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
            side: None,
        });
    }
    Ok(RawScene {
        layout: place.layout,
        place: format!("{}, {}", short(root, &place.model), found.place),
        remarks,
        train,
        test: None,
        part: false,
        missing,
        positions: model.points.iter().map(|p| p.position.into()).collect(),
        colors: model.points.iter().map(|p| p.color).collect(),
    })
}
