//! OpenMVG's `sfm_data.json` of a reconstruction.
//!
//! Format: what OpenMVG's documentation, "SfM_Data", <https://openmvg.readthedocs.io/>, lists, in the JSON of its serialiser cereal: a class is
//! named where it is first used, and called by its number, without the highest bit, from then on. Poses are a rotation, world to camera, and a
//! centre, with x right, y down, z forward.

use std::collections::HashMap;
use std::path::Path;

use glam::{DMat3, DVec3};
use serde::Deserialize;
use serde_json::{Map, Value};

use crate::base::error::{Error, Result};
use crate::capture::assemble::RawScene;
use crate::capture::camera::{Camera, camera_axes};
use crate::capture::dataset::Layout;
use crate::capture::exports::shared::{document, scene};
use crate::capture::lens::Lens;
use crate::capture::panorama;

/// The bit of a class's number by which cereal marks its first use.
const FIRST: u64 = 1 << 31;

/// True for a text that begins as OpenMVG's data do.
pub(super) fn is_data(text: &str) -> bool {
    text.contains("\"sfm_data_version\"")
}

#[derive(Deserialize)]
struct Document {
    views: Vec<Entry<Held>>,
    intrinsics: Vec<Entry<Held>>,
    #[serde(default)]
    extrinsics: Vec<Entry<Pose>>,
    #[serde(default)]
    structure: Vec<Entry<Landmark>>,
}

#[derive(Deserialize)]
struct Entry<T> {
    key: u64,
    value: T,
}

/// An object that may be of several classes.
#[derive(Deserialize)]
struct Held {
    #[serde(default)]
    polymorphic_id: u64,
    polymorphic_name: Option<String>,
    ptr_wrapper: Pointer,
}

#[derive(Deserialize)]
struct Pointer {
    data: Map<String, Value>,
}

#[derive(Deserialize)]
struct Pose {
    rotation: [[f64; 3]; 3],
    center: [f64; 3],
}

#[derive(Deserialize)]
struct Landmark {
    #[serde(rename = "X")]
    position: [f64; 3],
}

impl Held {
    /// A value of the object or of the class that it extends (`value0`).
    fn get(&self, name: &str) -> Option<&Value> {
        let data = &self.ptr_wrapper.data;
        let base = data.get("value0").and_then(Value::as_object);
        data.get(name)
            .or_else(|| base.and_then(|base| base.get(name)))
    }

    fn number(&self, name: &str) -> Option<f64> {
        self.get(name)?.as_f64()
    }

    fn id(&self, name: &str) -> Option<u64> {
        self.get(name)?.as_u64()
    }

    /// The numbers of a list; none if there is no such list. Or what is wrong.
    fn numbers(&self, name: &str) -> std::result::Result<Vec<f64>, String> {
        let list = self.get(name).and_then(Value::as_array);
        let list = list.into_iter().flatten().map(Value::as_f64);
        let numbers: Option<Vec<f64>> = list.collect();
        numbers.ok_or_else(|| format!("with {name} that are not all numbers"))
    }

    fn text(&self, name: &str) -> &str {
        self.get(name).and_then(Value::as_str).unwrap_or_default()
    }
}

/// A camera without its pose, and its lens; or what is wrong.
fn calibrated(found: &Held, class: &str) -> std::result::Result<(Camera, Lens), String> {
    let side = |name| found.number(name).filter(|v| (1.0..1e6).contains(v));
    let (Some(width), Some(height)) = (side("width"), side("height")) else {
        return Err("without the size of its photos".into());
    };
    let [width, height] = [width as u32, height as u32];
    let origin = (DMat3::IDENTITY, DVec3::ZERO);
    let camera = |of: [f64; 4]| Camera::new(of, [width, height], origin);
    let lens = match class {
        "spherical" => {
            let sphere = camera(panorama::intrinsics(width, height));
            return Ok((sphere, Lens::Equirectangular));
        }
        "pinhole" => Lens::Pinhole,
        "pinhole_radial_k1" => Lens::of_coefficients(&found.numbers("disto_k1")?, false),
        "pinhole_radial_k3" | "pinhole_brown_t2" => {
            let radial = found.numbers("disto_k3")?;
            let brown = [radial, found.numbers("disto_t2")?].concat();
            let k: [f64; 5] = std::array::from_fn(|i| brown.get(i).copied().unwrap_or(0.0));
            Lens::of_coefficients(&[k[0], k[1], k[3], k[4], k[2]], false)
        }
        "fisheye" => Lens::of_coefficients(&found.numbers("fisheye")?, true),
        other => {
            return Err(format!(
                "of the class {other}, which is not read; export undistorted photos with their sfm_data.json"
            ));
        }
    };
    let (focal, center) = (
        found.number("focal_length"),
        found.numbers("principal_point")?,
    );
    match (focal, &center[..]) {
        (Some(f), &[cx, cy]) if f > 0.0 => Ok((camera([f, f, cx, cy]), lens)),
        _ => Err("without a focal length or a principal point".into()),
    }
}

/// Name of a view's photo, its intrinsics' key, its pose.
type Posed<'a> = (String, u64, &'a Pose);

/// The views that have a pose.
fn posed(document: &Document) -> Vec<Posed<'_>> {
    let poses: HashMap<u64, &Pose> = document
        .extrinsics
        .iter()
        .map(|e| (e.key, &e.value))
        .collect();
    let view = |entry: &Entry<Held>| {
        let view = &entry.value;
        let pose = poses.get(&view.id("id_pose")?)?;
        let name = format!("{}/{}", view.text("local_path"), view.text("filename"));
        // Without one it has a key that no camera has.
        let camera = view.id("id_intrinsic").unwrap_or(u64::MAX);
        Some((name, camera, *pose))
    };
    document.views.iter().filter_map(view).collect()
}

/// The views and points of a file in `root`.
///
/// # Errors
/// JSON of another kind, no view with a pose, a lens that is not read; what [`scene`] refuses.
pub(super) fn load(root: &Path, file: &Path, asked: Option<&Path>) -> Result<RawScene> {
    let bad = |what: String| Error::input(file, what, "export the scene again, with its structure");
    let document: Document = document(file)?;
    let mut classes = HashMap::new();
    for entry in &document.intrinsics {
        if let Some(name) = &entry.value.polymorphic_name {
            classes.insert(entry.value.polymorphic_id & !FIRST, name.as_str());
        }
    }
    let cameras: HashMap<u64, _> = document
        .intrinsics
        .iter()
        .map(|entry| {
            let number = entry.value.polymorphic_id & !FIRST;
            let class = classes.get(&number).copied().unwrap_or_default();
            (entry.key, calibrated(&entry.value, class))
        })
        .collect();
    let views = posed(&document);
    if views.is_empty() {
        return Err(bad("no view with a pose".into()));
    }
    let names: Vec<&str> = views.iter().map(|v| v.0.as_str()).collect();
    let mut scene = scene((root, file, Layout::OpenMvg), asked, &names, |i, _| {
        let (name, key, pose) = &views[i];
        let found = cameras.get(key);
        let (camera, lens) = match found {
            Some(Ok(found)) => *found,
            Some(Err(what)) => return Err(bad(format!("the camera of {name} is {what}"))),
            None => return Err(bad(format!("{name} has a camera that is not there"))),
        };
        let axes = pose.rotation.map(DVec3::from_array);
        let Some(rotation) = camera_axes(axes) else {
            return Err(bad(format!("the rotation of {name} is none")));
        };
        let center = DVec3::from_array(pose.center);
        let camera = Camera {
            rotation,
            translation: -(rotation * center),
            ..camera
        };
        Ok((camera, lens))
    })?;
    for landmark in &document.structure {
        scene
            .positions
            .push(DVec3::from_array(landmark.value.position));
    }
    scene.colors = vec![[128; 3]; scene.positions.len()];
    Ok(scene)
}
