//! `transforms*.json`: NeRF-synthetic (Blender) and nerfstudio / instant-ngp datasets.
//!
//! Format: <https://docs.nerf.studio/quickstart/data_conventions.html>. Matrices are camera-to-world in OpenGL axes
//! (x right, y up, z back). `applied_transform`, masks and depth maps are not used.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};
use serde::Deserialize;
use serde_json::{Value, json};

use super::raw::{RawScene, RawView, inside};
use super::{Camera, Layout, decode, ply};
use crate::error::{Error, Result};

/// Remedy for a value that cannot be used.
const CORRECT: &str = "correct the file";

/// Coefficients that mean lens distortion wherever they are not zero.
const DISTORTION: [&str; 11] = [
    "k1",
    "k2",
    "k3",
    "k4",
    "k5",
    "k6",
    "p1",
    "p2",
    "p3",
    "p4",
    "is_fisheye",
];

#[derive(Deserialize)]
struct File {
    frames: Vec<Frame>,
    ply_file_path: Option<String>,
    #[serde(flatten)]
    lens: Lens,
}

#[derive(Deserialize)]
struct Frame {
    file_path: String,
    transform_matrix: Vec<Vec<f64>>,
    #[serde(flatten)]
    lens: Lens,
}

/// Intrinsics; a frame's own win over the file's.
#[derive(Deserialize)]
struct Lens {
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
/// Unreadable JSON, lens distortion, poses that are no rotation, images that cannot be found, paths that leave `root`.
pub(super) fn load(root: &Path, file: &Path) -> Result<RawScene> {
    let (train, points) = read(root, file)?;
    let held_out = root.join("transforms_test.json");
    let named_split = file.ends_with("transforms_train.json") && held_out.is_file();
    let test = if named_split {
        Some(read(root, &held_out)?.0)
    } else {
        None
    };
    let (positions, colors) = match points {
        Some(name) => ply::read_points(&inside(root, &name)?)?,
        None => (Vec::new(), Vec::new()),
    };
    Ok(RawScene {
        layout: Layout::Transforms,
        train,
        test,
        positions,
        colors,
    })
}

/// The views of one file, and its `ply_file_path`.
fn read(root: &Path, file: &Path) -> Result<(Vec<RawView>, Option<String>)> {
    let text = std::fs::read(file).map_err(|e| Error::io(file, e))?;
    let parsed: File = serde_json::from_slice(&text).map_err(|e| {
        let fix = "a list `frames` with `file_path` and a 4×4 `transform_matrix` each is expected";
        Error::input(file, e.to_string(), fix)
    })?;
    if parsed.frames.is_empty() {
        return Err(Error::input(
            file,
            "no view in `frames`",
            "list one frame per photo, with `file_path` and `transform_matrix`",
        ));
    }
    let mut found = Vec::with_capacity(parsed.frames.len());
    let mut missing = Vec::new();
    for frame in &parsed.frames {
        match locate(root, &frame.file_path)? {
            Some(image) => found.push(image),
            None => missing.push(frame.file_path.as_str()),
        }
    }
    if let Some(first) = missing.first() {
        return Err(Error::input(
            file,
            format!(
                "{} of {} image files are missing, the first is {first} (as it is, or with .png, .jpg, .jpeg or .webp)",
                missing.len(),
                parsed.frames.len()
            ),
            "copy the images to their places or remove their entries",
        ));
    }
    let mut views = Vec::with_capacity(found.len());
    for (frame, image) in parsed.frames.iter().zip(found) {
        let at = Place { file, frame };
        at.refuse_distortion(&parsed.lens)?;
        at.refuse_distortion(&frame.lens)?;
        views.push(RawView {
            name: normal_name(&frame.file_path),
            camera: at.camera(&parsed.lens, &image)?,
            file: image,
        });
    }
    Ok((views, parsed.ply_file_path))
}

/// The image a frame names, with or without its extension; `None` if there is none.
fn locate(root: &Path, name: &str) -> Result<Option<PathBuf>> {
    let exact = inside(root, name)?;
    if exact.is_file() {
        return Ok(Some(exact));
    }
    let extensions = [".png", ".jpg", ".jpeg", ".webp"].iter();
    Ok(extensions
        .map(|extension| {
            let mut longer = exact.clone().into_os_string();
            longer.push(extension);
            PathBuf::from(longer)
        })
        .find(|candidate| candidate.is_file()))
}

fn normal_name(name: &str) -> String {
    name.trim_start_matches("./").to_string()
}

/// A frame of a file, for messages.
struct Place<'a> {
    file: &'a Path,
    frame: &'a Frame,
}

impl Place<'_> {
    fn bad(&self, what: &str, fix: &str) -> Error {
        let what = format!("frame {}: {what}", self.frame.file_path);
        Error::input(self.file, what, fix)
    }

    fn refuse_distortion(&self, lens: &Lens) -> Result<()> {
        let is_zero = |v: &Value| match v {
            Value::Number(n) => n.as_f64() == Some(0.0),
            Value::Null | Value::Bool(false) => true,
            _ => false,
        };
        let fix = "undistort the photos first (colmap image_undistorter, for example)";
        for key in DISTORTION {
            if let Some(value) = lens.other.get(key).filter(|v| !is_zero(v)) {
                let what = format!("{key} = {value}; lens distortion is not supported yet");
                return Err(self.bad(&what, fix));
            }
        }
        match lens.camera_model.as_deref() {
            // OPENCV without coefficients is a pinhole.
            None | Some("PINHOLE" | "SIMPLE_PINHOLE" | "OPENCV" | "SIMPLE_RADIAL" | "RADIAL") => {
                Ok(())
            }
            Some(other) => {
                let what = format!("the camera model {other} is not supported; PINHOLE expected");
                Err(self.bad(&what, fix))
            }
        }
    }

    /// Intrinsics from the frame, then the file, then defaults: the image's size, its centre, fy = fx.
    fn camera(&self, file: &Lens, image: &Path) -> Result<Camera> {
        let own = &self.frame.lens;
        let (width, height) = match (own.w.or(file.w), own.h.or(file.h)) {
            (Some(w), Some(h)) => (self.pixels("w", w)?, self.pixels("h", h)?),
            _ => {
                let header = decode::header(image)?;
                (header.width, header.height)
            }
        };
        let (w, h) = (f64::from(width), f64::from(height));
        let from_angle = |side: f64, angle: f64| side / (2.0 * (angle / 2.0).tan());
        // A frame's field of view wins over the file's focal length, hence frame by frame.
        let focal_x = |l: &Lens| l.fl_x.or(l.camera_angle_x.map(|a| from_angle(w, a)));
        let focal_y = |l: &Lens| l.fl_y.or(l.camera_angle_y.map(|a| from_angle(h, a)));
        let Some(fx) = focal_x(own).or_else(|| focal_x(file)) else {
            return Err(self.bad(
                "neither fl_x nor camera_angle_x is given",
                "add one of them",
            ));
        };
        let own_fy = focal_y(own).or_else(|| focal_x(own));
        let fy = own_fy.or_else(|| focal_y(file)).unwrap_or(fx);
        let cx = own.cx.or(file.cx).unwrap_or(w / 2.0);
        let cy = own.cy.or(file.cy).unwrap_or(h / 2.0);
        let good = fx > 0.0 && fy > 0.0 && [fx, fy, cx, cy].iter().all(|v| v.is_finite());
        if !good || width == 0 || height == 0 {
            let what = format!(
                "{width}×{height} pixels with focal lengths {fx}, {fy} and principal point {cx}, {cy}; positive sizes and focal lengths expected"
            );
            return Err(self.bad(&what, CORRECT));
        }
        let (rotation, center) = self.pose()?;
        Ok(Camera {
            rotation,
            translation: -(rotation * center),
            fx,
            fy,
            cx,
            cy,
            width,
            height,
        })
    }

    fn pixels(&self, key: &str, value: f64) -> Result<u32> {
        if (1.0..=1e6).contains(&value) && value.fract() == 0.0 {
            return Ok(value as u32);
        }
        let what = format!("{key} = {value}; a whole number of pixels expected");
        Err(self.bad(&what, CORRECT))
    }

    /// World-to-camera rotation in OpenCV axes, and the camera's centre. Columns are normalised, which undoes the scale of
    /// a scaled camera object; what is then no rotation within 1 % is refused.
    fn pose(&self) -> Result<(DMat3, DVec3)> {
        let m = &self.frame.transform_matrix;
        let shaped = (m.len() == 3 || m.len() == 4) && m.iter().all(|row| row.len() == 4);
        if !shaped {
            let what = "transform_matrix is not 4×4 (or 3×4)";
            return Err(self.bad(what, CORRECT));
        }
        let column = |k: usize| DVec3::new(m[0][k], m[1][k], m[2][k]);
        let [x, y, z] = [column(0), -column(1), -column(2)].map(DVec3::normalize_or_zero);
        let center = column(3);
        let raw = DMat3::from_cols(x, y, z);
        let rigid = (raw.determinant() - 1.0).abs() < 0.01;
        if !rigid || !center.is_finite() {
            let what = format!(
                "transform_matrix is no rigid pose (determinant of its axes {}, centre {center})",
                raw.determinant()
            );
            return Err(self.bad(&what, CORRECT));
        }
        // Gram–Schmidt from the viewing axis; files with few digits are off by their rounding.
        let x = (x - z * x.dot(z)).normalize();
        let y = z.cross(x);
        Ok((DMat3::from_cols(x, y, z).transpose(), center))
    }
}

/// Writes a nerfstudio-style transforms file for cameras in the dataset's frame, named by image path relative to the
/// file's folder; `points` is the relative path of a PLY with sparse points. Every frame carries its own intrinsics.
///
/// # Errors
/// [`Error::Numerics`] for numbers that are not finite, [`Error::Io`] where the system refuses.
pub fn write_transforms(
    file: &Path,
    views: &[(String, Camera)],
    points: Option<&str>,
) -> Result<()> {
    let mut frames = Vec::with_capacity(views.len());
    for (name, camera) in views {
        let c = camera.center();
        let [x, y, z] = camera.rotation.transpose().to_cols_array_2d();
        let intrinsics = [camera.fx, camera.fy, camera.cx, camera.cy];
        if !c.is_finite()
            || !camera.rotation.is_finite()
            || intrinsics.iter().any(|v| !v.is_finite())
        {
            return Err(Error::Numerics {
                stage: "transforms".into(),
                what: format!("the camera of {name} is not finite"),
            });
        }
        let row = |k: usize, c: f64| json!([x[k], -y[k], -z[k], c]);
        frames.push(json!({
            "file_path": name,
            "fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy,
            "w": camera.width, "h": camera.height,
            "transform_matrix": [row(0, c.x), row(1, c.y), row(2, c.z), json!([0.0, 0.0, 0.0, 1.0])],
        }));
    }
    let mut root = json!({ "frames": frames });
    if let Some(points) = points {
        root["ply_file_path"] = json!(points);
    }
    std::fs::write(file, format!("{root:#}")).map_err(|e| Error::io(file, e))
}
