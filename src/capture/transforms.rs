//! `transforms*.json`: NeRF-synthetic (Blender) and nerfstudio / instant-ngp datasets.
//!
//! Format: <https://docs.nerf.studio/quickstart/data_conventions.html>. Matrices are camera-to-world in OpenGL axes
//! (x right, y up, z back). `applied_transform` and depth maps are not used.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};
use serde::Deserialize;
use serde_json::{Value, json};

use crate::base::error::{Error, Result};
use crate::base::ply::Table;
use crate::capture::assemble::{RawScene, RawView, find_mask, inside, locate};
use crate::capture::camera::{Camera, camera_axes};
use crate::capture::dataset::Layout;
use crate::capture::images::{Images, short};
use crate::capture::lens::Lens;
use crate::capture::panorama::intrinsics;
use crate::capture::source;

/// Remedy for an unusable value.
const CORRECT: &str = "correct the file";

/// Remedy for a lens that has no place in such files.
const UNDISTORT: &str = "undistort the photos first (colmap image_undistorter, for example)";

/// Coefficients of a fisheye lens, in order.
const FISHEYE: [&str; 4] = ["k1", "k2", "k3", "k4"];
/// Coefficients of a perspective lens, in order; the last three in `FULL_OPENCV` alone.
const PERSPECTIVE: [&str; 8] = ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"];
/// Camera model of panoramas.
const SPHERE: &str = "EQUIRECTANGULAR";
/// Keys of distortion that have a place in none of these.
const OTHERS: [&str; 3] = ["p3", "p4", "is_fisheye"];

#[derive(Deserialize)]
struct File {
    frames: Vec<Frame>,
    ply_file_path: Option<String>,
    /// True for a part of a dataset that `split` has written.
    #[serde(default)]
    part: bool,
    #[serde(flatten)]
    lens: Intrinsics,
}

#[derive(Deserialize)]
struct Frame {
    file_path: String,
    mask_path: Option<String>,
    transform_matrix: Vec<Vec<f64>>,
    #[serde(flatten)]
    lens: Intrinsics,
}

/// Intrinsics; a frame's own win over the file's.
#[derive(Deserialize)]
struct Intrinsics {
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    w: Option<f64>,
    h: Option<f64>,
    camera_model: Option<String>,
    #[serde(flatten)]
    other: BTreeMap<String, Value>,
}

/// The transforms file to train from, if `root` has one.
pub(super) fn find(root: &Path) -> Option<PathBuf> {
    ["transforms_train.json", "transforms.json"]
        .iter()
        .map(|name| root.join(name))
        .find(|file| file.is_file())
}

/// Reads `file`; next to a `transforms_train.json`, a `transforms_test.json` gives the held-out views.
///
/// # Errors
/// Unreadable JSON, an unknown camera model, poses that are no rotation, paths that leave `root`.
pub(super) fn load(root: &Path, file: &Path, asked: Option<&Path>) -> Result<RawScene> {
    let held_out = root.join("transforms_test.json");
    let named_split = file.ends_with("transforms_train.json") && held_out.is_file();
    let train = read(file)?;
    // A list of held-out views may be empty: then none is held out.
    if train.frames.is_empty() {
        return Err(Error::input(
            file,
            "no view in `frames`",
            "list one frame per photo, with `file_path` and `transform_matrix`",
        ));
    }
    let test = named_split.then(|| read(&held_out)).transpose()?;
    let frames = || {
        train
            .frames
            .iter()
            .chain(test.iter().flat_map(|t| &t.frames))
    };
    let names = frames().map(|frame| frame.file_path.as_str());
    let mut found = Images::new(root, root.to_path_buf(), asked)?.find(names)?;
    let (positions, colors) = match &train.ply_file_path {
        Some(name) => Table::read(&inside(root, name)?)?.points()?,
        None => (Vec::new(), Vec::new()),
    };
    let mut missing = Vec::new();
    let place = match found.place.as_str() {
        "photos in this folder" => short(root, file),
        other => format!("{}, {other}", short(root, file)),
    };
    let mut views = |file: &Path, parsed: &File| {
        let rest = found.files.split_off(parsed.frames.len());
        let files = std::mem::replace(&mut found.files, rest);
        views((root, file, asked.is_some()), parsed, files, &mut missing)
    };
    let part = train.part;
    let train = views(file, &train)?;
    let test = test.map(|test| views(&held_out, &test)).transpose()?;
    Ok(RawScene {
        layout: Layout::Transforms,
        place,
        remarks: Vec::new(),
        train,
        test,
        part,
        missing,
        positions,
        colors,
    })
}

/// The content of one file.
fn read(file: &Path) -> Result<File> {
    let text = crate::base::files::read_text(file)?;
    let mut parsed: File = serde_json::from_slice(&text).map_err(|e| {
        let fix = "a list `frames` with `file_path` and a 4×4 `transform_matrix` each is expected";
        Error::input(file, e.to_string(), fix)
    })?;
    let root = file.parent().unwrap_or(file);
    let frames = parsed.frames.iter_mut();
    let named = frames.flat_map(|f| [Some(&mut f.file_path), f.mask_path.as_mut()]);
    for path in named.chain([parsed.ply_file_path.as_mut()]).flatten() {
        // Some programs on Windows write another sign between folders.
        if path.contains('\\') && !root.join(&*path).exists() {
            *path = path.replace('\\', "/");
        }
    }
    Ok(parsed)
}

/// The views of one file in a folder, with their images; names of images that are not there are added to `missing`. `resized` if the
/// images are others than those that the file was written for.
fn views(
    (root, file, resized): (&Path, &Path, bool),
    parsed: &File,
    images: Vec<Option<PathBuf>>,
    missing: &mut Vec<String>,
) -> Result<Vec<RawView>> {
    let mut views = Vec::with_capacity(parsed.frames.len());
    for (frame, image) in parsed.frames.iter().zip(images) {
        let at = Place {
            file,
            frame,
            lenses: [&frame.lens, &parsed.lens],
            resized,
        };
        let Some(image) = image else {
            missing.push(normal_name(&frame.file_path));
            continue;
        };
        let lens = at.lens()?;
        views.push(RawView {
            name: normal_name(&frame.file_path),
            camera: at.camera(&image, lens)?,
            lens,
            mask: at.mask(root)?,
            file: image,
            side: None,
        });
    }
    Ok(views)
}

fn normal_name(name: &str) -> String {
    name.trim_start_matches("./").to_string()
}

/// A frame of a file.
struct Place<'a> {
    file: &'a Path,
    frame: &'a Frame,
    /// Its own intrinsics, and those of the file.
    lenses: [&'a Intrinsics; 2],
    /// True if the photos may have another size than those of the file.
    resized: bool,
}

impl Place<'_> {
    fn bad(&self, what: &str, fix: &str) -> Error {
        let what = format!("frame {}: {what}", self.frame.file_path);
        Error::input(self.file, what, fix)
    }

    /// The file that the frame names as its mask, or one in the folder `masks`.
    fn mask(&self, root: &Path) -> Result<Option<PathBuf>> {
        let Some(name) = &self.frame.mask_path else {
            return Ok(find_mask(root, &self.frame.file_path));
        };
        let found = locate(root, name)?;
        if found.is_none() {
            let what = format!("its mask {name} is not there");
            return Err(self.bad(&what, "copy the mask to its place, or remove mask_path"));
        }
        Ok(found)
    }

    /// A value from the frame, else from the file.
    fn find<T>(&self, of: impl Fn(&'_ Intrinsics) -> Option<T>) -> Option<T> {
        self.lenses.iter().find_map(|l| of(l))
    }

    /// Distortion from the frame, then the file; zero by default.
    fn lens(&self) -> Result<Lens> {
        let value = |key: &str| {
            let found = self.find(|l| l.other.get(key).filter(|v| !v.is_null()).cloned());
            let number = match &found {
                None | Some(Value::Bool(false)) => Some(0.0),
                Some(Value::Bool(true)) => Some(1.0),
                Some(v) => v.as_f64().filter(|k| k.is_finite()),
            };
            let found = found.unwrap_or_default();
            number.ok_or_else(|| self.bad(&format!("{key} = {found}; a number expected"), CORRECT))
        };
        let model = self.find(|l| l.camera_model.clone());
        let used: &[&str] = match model.as_deref() {
            Some("OPENCV_FISHEYE" | "FISHEYE") => &FISHEYE,
            None | Some("OPENCV") if value("is_fisheye")? != 0.0 => &FISHEYE,
            None | Some("PINHOLE" | "SIMPLE_PINHOLE" | "OPENCV" | "SIMPLE_RADIAL" | "RADIAL") => {
                &PERSPECTIVE[..5]
            }
            Some("FULL_OPENCV") => &PERSPECTIVE,
            Some(SPHERE) => &[],
            Some(other) => {
                let what = format!("the camera model {other} is not read");
                return Err(self.bad(&what, UNDISTORT));
            }
        };
        let fisheye = used == FISHEYE;
        for key in PERSPECTIVE.into_iter().chain(OTHERS) {
            let v = value(key)?;
            let right = used.contains(&key) || (fisheye && key == "is_fisheye");
            if v != 0.0 && !right {
                let what = format!("{key} = {v} has no place in this camera model");
                return Err(self.bad(&what, UNDISTORT));
            }
        }
        if model.as_deref() == Some(SPHERE) {
            return Ok(Lens::Equirectangular);
        }
        let used = used.iter().map(|key| value(key));
        let coefficients: Vec<f64> = used.collect::<Result<_>>()?;
        Ok(Lens::of_coefficients(&coefficients, fisheye))
    }

    /// Intrinsics from the frame, then the file, then defaults: the image's size, its centre, fy = fx.
    fn camera(&self, image: &Path, lens: Lens) -> Result<Camera> {
        let (width, height) = match (self.find(|l| l.w), self.find(|l| l.h)) {
            (Some(w), Some(h)) => (self.pixels("w", w)?, self.pixels("h", h)?),
            _ if self.resized
                && lens != Lens::Equirectangular
                && self.find(|l| l.fl_x).is_some() =>
            {
                let what = "fl_x is given without w and h, and the photos of --images may have another size";
                return Err(self.bad(what, "add w and h"));
            }
            _ => {
                let header = source::header(image)?;
                (header.width, header.height)
            }
        };
        let intrinsics = match lens {
            Lens::Equirectangular => self.sphere(width, height)?,
            _ => self.intrinsics(width, height)?,
        };
        let (rotation, center) = self.pose()?;
        let pose = (rotation, -(rotation * center));
        Ok(Camera::new(intrinsics, [width, height], pose))
    }

    /// Intrinsics of a panorama. What the file says of them must be what nerfstudio says of the whole sphere: focal lengths of half
    /// the width, the principal point in the middle.
    fn sphere(&self, width: u32, height: u32) -> Result<[f64; 4]> {
        let (w, h) = (f64::from(width), f64::from(height));
        let given = [
            ("fl_x", self.find(|l| l.fl_x), w / 2.0),
            ("fl_y", self.find(|l| l.fl_y), w / 2.0),
            ("cx", self.find(|l| l.cx), w / 2.0),
            ("cy", self.find(|l| l.cy), h / 2.0),
        ];
        for (key, value, expected) in given {
            // NaN is near nothing.
            let near = |v: &f64| (v - expected).abs() <= 0.01 * expected;
            if let Some(v) = value.filter(|v| !near(v)) {
                let what =
                    format!("{key} = {v}; {expected} expected for a whole panorama ({SPHERE})");
                return Err(self.bad(&what, "remove fl_x, fl_y, cx and cy, or correct them"));
            }
        }
        Ok(intrinsics(width, height))
    }

    /// Focal lengths and principal point fx, fy, cx, cy of a pinhole, with a lens or without.
    fn intrinsics(&self, width: u32, height: u32) -> Result<[f64; 4]> {
        let (w, h) = (f64::from(width), f64::from(height));
        let from_angle = |side: f64, angle: f64| side / (2.0 * (angle / 2.0).tan());
        // A frame's field of view wins over the file's focal length, hence frame by frame.
        let focal_x = |l: &Intrinsics| l.fl_x.or(l.camera_angle_x.map(|a| from_angle(w, a)));
        let focal_y = |l: &Intrinsics| l.fl_y.or(l.camera_angle_y.map(|a| from_angle(h, a)));
        let Some(fx) = self.find(focal_x) else {
            let what = "neither fl_x nor camera_angle_x is given";
            return Err(self.bad(what, "add one of them"));
        };
        let fy = self.find(|l| focal_y(l).or_else(|| focal_x(l)));
        let fy = fy.unwrap_or(fx);
        let cx = self.find(|l| l.cx).unwrap_or(w / 2.0);
        let cy = self.find(|l| l.cy).unwrap_or(h / 2.0);
        let good = fx > 0.0 && fy > 0.0 && [fx, fy, cx, cy].iter().all(|v| v.is_finite());
        if !good || width == 0 || height == 0 {
            let what = format!(
                "{width}×{height} pixels with focal lengths {fx}, {fy} and principal point {cx}, {cy}; positive sizes and focal lengths expected"
            );
            return Err(self.bad(&what, CORRECT));
        }
        Ok([fx, fy, cx, cy])
    }

    fn pixels(&self, key: &str, value: f64) -> Result<u32> {
        if (1.0..=1e6).contains(&value) && value.fract() == 0.0 {
            return Ok(value as u32);
        }
        let what = format!("{key} = {value}; a whole number of pixels expected");
        Err(self.bad(&what, CORRECT))
    }

    /// World-to-camera rotation in OpenCV axes, and the camera's centre.
    fn pose(&self) -> Result<(DMat3, DVec3)> {
        let m = &self.frame.transform_matrix;
        if !matches!(m.len(), 3 | 4) || m.iter().any(|row| row.len() != 4) {
            return Err(self.bad("transform_matrix is not 4×4 (or 3×4)", CORRECT));
        }
        let column = |k: usize| DVec3::new(m[0][k], m[1][k], m[2][k]);
        let center = column(3);
        let axes = camera_axes([column(0), -column(1), -column(2)]);
        let rotation = axes.filter(|_| center.is_finite());
        let Some(rotation) = rotation else {
            let what = format!("transform_matrix is no rigid pose (centre {center})");
            return Err(self.bad(&what, CORRECT));
        };
        Ok((rotation, center))
    }
}

/// A view as a transforms file lists it.
pub(super) struct Listed {
    /// Path of the image, relative to the file's folder.
    pub name: String,
    /// Camera in the dataset's frame.
    pub camera: Camera,
    /// Its lens.
    pub lens: Lens,
    /// Path of the mask, relative to the file's folder.
    pub mask: Option<String>,
}

/// Writes a nerfstudio-style transforms file for cameras in the dataset's frame, named by image path relative to the
/// file's folder; `points` is the relative path of a PLY with sparse points. Every frame carries its own intrinsics.
///
/// # Errors
/// [`Error::Numerics`] for numbers that are not finite, [`Error::Io`] if the system refuses.
pub fn write_transforms(
    file: &Path,
    views: &[(String, Camera)],
    points: Option<&str>,
) -> Result<()> {
    let pinhole = |(name, camera): &(String, Camera)| Listed {
        name: name.clone(),
        camera: *camera,
        lens: Lens::Pinhole,
        mask: None,
    };
    let views: Vec<Listed> = views.iter().map(pinhole).collect();
    write_listed(file, &views, points, false)
}

/// Writes what [`write_transforms`] does, with lenses and masks.
///
/// # Errors
/// Those of [`write_transforms`], and [`Error::Input`] for a lens that a transforms file has no keys for.
pub(super) fn write_listed(
    file: &Path,
    views: &[Listed],
    points: Option<&str>,
    part: bool,
) -> Result<()> {
    let frames: Vec<Value> = views
        .iter()
        .map(|v| frame(file, v))
        .collect::<Result<_>>()?;
    let mut root = json!({ "frames": frames });
    if let Some(points) = points {
        root["ply_file_path"] = json!(points);
    }
    if part {
        root["part"] = json!(true);
    }
    std::fs::write(file, format!("{root:#}")).map_err(|e| Error::io(file, e))
}

/// Camera model, keys and coefficients of a lens.
type Keys = (Option<&'static str>, &'static [&'static str], Vec<f64>);

/// The keys of a photo's lens in a transforms file.
///
/// # Errors
/// [`Error::Input`], about this path, for a lens that there are none for.
pub(super) fn keys_of(file: &Path, name: &str, lens: Lens) -> Result<Keys> {
    Ok(match lens {
        Lens::Pinhole => (None, &[], Vec::new()),
        Lens::Equirectangular => (Some(SPHERE), &[], Vec::new()),
        Lens::Fisheye { radial } => (Some("OPENCV_FISHEYE"), &FISHEYE, radial.to_vec()),
        Lens::Perspective { radial, tangential } => {
            let k = [&radial[..2], &tangential, &radial[2..]].concat();
            (Some("FULL_OPENCV"), &PERSPECTIVE, k)
        }
        lens => {
            let what = format!("the lens of {name} ({lens:?}) has no place in a transforms file");
            return Err(Error::input(file, what, UNDISTORT));
        }
    })
}

/// The frame of a view.
fn frame(file: &Path, view: &Listed) -> Result<Value> {
    let (name, camera) = (&view.name, &view.camera);
    let c = camera.center();
    let [x, y, z] = camera.rotation.transpose().to_cols_array_2d();
    let intrinsics = [camera.fx, camera.fy, camera.cx, camera.cy];
    let finite = c.is_finite() && camera.rotation.is_finite();
    if !finite || intrinsics.iter().any(|v| !v.is_finite()) {
        let what = format!("the camera of {name} is not finite");
        return Err(Error::numerics("transforms", what));
    }
    let row = |k: usize, c: f64| json!([x[k], -y[k], -z[k], c]);
    let mut frame = json!({
        "file_path": name,
        "w": camera.width, "h": camera.height,
        "transform_matrix": [row(0, c.x), row(1, c.y), row(2, c.z), json!([0.0, 0.0, 0.0, 1.0])],
    });
    let (model, keys, coefficients) = keys_of(file, name, view.lens)?;
    if view.lens != Lens::Equirectangular {
        let named = ["fl_x", "fl_y", "cx", "cy"].into_iter().zip(intrinsics);
        named.for_each(|(key, v)| frame[key] = json!(v));
    }
    if let Some(model) = model {
        frame["camera_model"] = json!(model);
    }
    let lens = keys.iter().zip(coefficients);
    lens.for_each(|(key, k)| frame[*key] = json!(k));
    if let Some(mask) = &view.mask {
        frame["mask_path"] = json!(mask);
    }
    Ok(frame)
}
