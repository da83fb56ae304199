//! Photos and points of the exports of other programs.

use std::fs;
use std::path::{Path, PathBuf};

use glam::DVec3;
use serde::de::DeserializeOwned;

use crate::base::error::{Error, Result};
use crate::base::math::{order_statistic, sorted};
use crate::base::ply;
use crate::base::ply::Table;
use crate::capture::assemble::{RawScene, RawView, find_mask};
use crate::capture::camera::Camera;
use crate::capture::dataset::Layout;
use crate::capture::images::{Images, short};
use crate::capture::lens::Lens;

/// Points whose median distance from the cameras is this many times the cameras' extent are in another coordinate system.
const ELSEWHERE: f64 = 1000.0;

/// A name of a photo from another machine without its root, its drive and its steps upwards: relative, with forward slashes.
fn plain_name(name: &str) -> String {
    let parts = name.trim().split(['/', '\\']);
    let plain = |part: &&str| !matches!(*part, "" | "." | "..") && !part.ends_with(':');
    parts.filter(plain).collect::<Vec<_>>().join("/")
}

/// The views of an export: of each named photo that is there, the camera and lens that `camera` tells by its number and its file.
///
/// # Errors
/// A file name that is in several places; what `camera` refuses.
pub(super) fn scene(
    (root, file, layout): (&Path, &Path, Layout),
    asked: Option<&Path>,
    names: &[&str],
    mut camera: impl FnMut(usize, &Path) -> Result<(Camera, Lens)>,
) -> Result<RawScene> {
    let names: Vec<String> = names.iter().map(|name| plain_name(name)).collect();
    let images = root.join("images");
    let usual = match images.is_dir() {
        true => images,
        false => root.to_path_buf(),
    };
    let found = Images::new(root, usual, asked)?.find(names.iter().map(String::as_str))?;
    let (mut train, mut missing) = (Vec::new(), Vec::new());
    for (i, (name, image)) in names.into_iter().zip(found.files).enumerate() {
        let Some(image) = image else {
            missing.push(name);
            continue;
        };
        let (camera, lens) = camera(i, &image)?;
        train.push(RawView {
            mask: find_mask(root, &name),
            name,
            file: image,
            camera,
            lens,
            side: None,
        });
    }
    Ok(RawScene {
        layout,
        place: format!("{}, {}", short(root, file), found.place),
        remarks: Vec::new(),
        train,
        test: None,
        part: false,
        missing,
        positions: Vec::new(),
        colors: Vec::new(),
    })
}

/// The content of a JSON file.
///
/// # Errors
/// A file that cannot be read, or of another kind.
pub(super) fn document<T: DeserializeOwned>(file: &Path) -> Result<T> {
    let text = crate::base::files::read_text(file)?;
    serde_json::from_slice(&text).map_err(|error| {
        let fix = "export the cameras again";
        Error::input(file, format!("not what it seems to be: {error}"), fix)
    })
}

/// The point cloud beside an export: of its name, else `points.ply`, else the only PLY there is. Scenes are none.
fn cloud(root: &Path, file: &Path) -> Option<PathBuf> {
    let entries = fs::read_dir(root).into_iter().flatten().flatten();
    let is_cloud = |path: &PathBuf| {
        let named = path
            .extension()
            .is_some_and(|e| e.eq_ignore_ascii_case("ply"));
        named && path.is_file() && !ply::is_scene(path)
    };
    let mut clouds: Vec<PathBuf> = entries.map(|entry| entry.path()).filter(is_cloud).collect();
    let named = [file.with_extension("ply"), root.join("points.ply")];
    let named = named.into_iter().find(|name| clouds.contains(name));
    named.or_else(|| clouds.pop().filter(|_| clouds.is_empty()))
}

/// Adds the points of the PLY file beside an export, if there is one in the coordinate system of the cameras.
///
/// # Errors
/// A PLY file that cannot be read.
pub(super) fn add_cloud(scene: &mut RawScene, root: &Path, file: &Path) -> Result<()> {
    let Some(cloud) = cloud(root, file) else {
        return Ok(());
    };
    let (positions, colors) = Table::read(&cloud)?.points()?;
    let centers: Vec<DVec3> = scene.train.iter().map(|v| v.camera.center()).collect();
    let middle = centers.iter().sum::<DVec3>() / centers.len().max(1) as f64;
    let median = |points: &[DVec3]| {
        let far = sorted(points.iter().map(|p| p.distance(middle)));
        order_statistic(&far, 0.5).unwrap_or_default()
    };
    let name = short(root, &cloud);
    let extent = median(&centers);
    if extent > 0.0 && median(&positions) > ELSEWHERE * extent {
        scene.remarks.push(format!(
            "warning: the points of {name} lie far from all cameras and are left out; export both in the same coordinate system"
        ));
        return Ok(());
    }
    scene.place = format!("{}, points in {name}", scene.place);
    (scene.positions, scene.colors) = (positions, colors);
    Ok(())
}
