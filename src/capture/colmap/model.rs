//! Cameras, images and points of a COLMAP sparse model.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use glam::DQuat;

use crate::base::error::{Error, Result};
use crate::capture::camera::Camera;
use crate::capture::colmap::form::{Fields, Output, REBUILD, records};
use crate::capture::lens::Lens;
use crate::capture::panorama::intrinsics;

/// Name of a camera model, number of its focal lengths (f, or fx and fy; none: a panorama, with its size in the place of the principal
/// point) and of its distortion coefficients, and the lens of these.
type CameraModel = (&'static str, usize, usize, fn(&[f64]) -> Lens);

/// COLMAP's camera models in the order of its identifiers (`src/colmap/sensor/models.h`).
const MODELS: [CameraModel; 18] = [
    ("SIMPLE_PINHOLE", 1, 0, perspective),
    ("PINHOLE", 2, 0, perspective),
    ("SIMPLE_RADIAL", 1, 1, perspective),
    ("RADIAL", 1, 2, perspective),
    ("OPENCV", 2, 4, perspective),
    ("OPENCV_FISHEYE", 2, 4, fisheye),
    ("FULL_OPENCV", 2, 8, perspective),
    ("FOV", 2, 1, fov),
    ("SIMPLE_RADIAL_FISHEYE", 1, 1, fisheye),
    ("RADIAL_FISHEYE", 1, 2, fisheye),
    ("THIN_PRISM_FISHEYE", 2, 8, thin_prism_fisheye),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 2, 12, rad_tan_thin_prism),
    ("SIMPLE_DIVISION", 1, 1, division),
    ("DIVISION", 2, 1, division),
    ("SIMPLE_FISHEYE", 1, 0, fisheye),
    ("FISHEYE", 2, 0, fisheye),
    ("EUCM", 2, 2, eucm),
    ("EQUIRECTANGULAR", 0, 0, sphere),
];

fn sphere(_: &[f64]) -> Lens {
    Lens::Equirectangular
}

fn perspective(k: &[f64]) -> Lens {
    Lens::of_coefficients(k, false)
}

fn fisheye(k: &[f64]) -> Lens {
    Lens::of_coefficients(k, true)
}

/// ω; 0, the limit of the model, is a pinhole.
fn fov(k: &[f64]) -> Lens {
    match k[0] == 0.0 {
        true => Lens::Pinhole,
        false => Lens::Fov { omega: k[0].abs() },
    }
}

/// k1 k2 p1 p2 k3 k4 sx1 sy1.
fn thin_prism_fisheye(k: &[f64]) -> Lens {
    Lens::ThinPrismFisheye {
        radial: [k[0], k[1], k[4], k[5]],
        tangential: [k[2], k[3]],
        prism: [k[6], k[7]],
    }
}

/// k0 to k5, p0 p1, s0 to s3.
fn rad_tan_thin_prism(k: &[f64]) -> Lens {
    Lens::RadTanThinPrismFisheye {
        radial: std::array::from_fn(|i| k[i]),
        tangential: [k[6], k[7]],
        prism: std::array::from_fn(|i| k[8 + i]),
    }
}

fn division(k: &[f64]) -> Lens {
    match k[0] == 0.0 {
        true => Lens::Pinhole,
        false => Lens::Division { radial: k[0] },
    }
}

fn eucm(k: &[f64]) -> Lens {
    Lens::Eucm {
        alpha: k[0],
        beta: k[1],
    }
}

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

/// Reads a camera.
fn camera(from: &mut Fields<'_>) -> Result<ColmapCamera> {
    let id = from.number("CAMERA_ID", u32::from_le_bytes)?;
    let (found, known) = if from.binary {
        let number = from.number("MODEL", i32::from_le_bytes)?;
        let known = usize::try_from(number).ok().and_then(|i| MODELS.get(i));
        (format!("number {number}"), known)
    } else {
        let name = from.word("MODEL")?;
        let known = MODELS.iter().find(|m| m.0 == name);
        (format!("'{name}'"), known)
    };
    let size = from.array(["WIDTH", "HEIGHT"], u64::from_le_bytes)?;
    let name = known.map_or_else(|| format!("{found} (unknown)"), |m| m.0.to_owned());
    let Some(&(_, focals, coefficients, lens)) = known else {
        return Err(Error::input(
            from.path,
            format!("camera {id} has the model {name}, which is not read"),
            "undistort first: colmap image_undistorter --image_path <photos> --input_path <this folder> --output_path <new dataset>",
        ));
    };
    let expected = focals + 2 + coefficients;
    let params = from.params(expected)?;
    let found = params.len();
    if found != expected {
        let what = format!("camera {id} ({name}) has {found} parameters; {expected} expected");
        return Err(Error::input(from.path, what, REBUILD));
    }
    let [Ok(width), Ok(height)] = size.map(u32::try_from) else {
        let what = format!("camera {id} is {}×{} pixels", size[0], size[1]);
        return Err(Error::input(from.path, what, REBUILD));
    };
    if focals == 0 && params != [width, height].map(f64::from) {
        let what = format!(
            "camera {id} ({name}) has the parameters {params:?}; the size of its photos expected, {width} and {height}"
        );
        return Err(Error::input(from.path, what, REBUILD));
    }
    Ok(ColmapCamera {
        id,
        width,
        height,
        params: match focals {
            0 => intrinsics(width, height),
            _ => [
                params[0],
                params[focals - 1],
                params[focals],
                params[focals + 1],
            ],
        },
        lens: lens(&params[focals + 2..]),
    })
}

/// Reads an image; its observations are skipped.
fn image(from: &mut Fields<'_>) -> Result<ColmapImage> {
    let image = ColmapImage {
        id: from.number("IMAGE_ID", u32::from_le_bytes)?,
        rotation: from.array(["QW", "QX", "QY", "QZ"], f64::from_le_bytes)?,
        translation: from.array(["TX", "TY", "TZ"], f64::from_le_bytes)?,
        camera_id: from.number("CAMERA_ID", u32::from_le_bytes)?,
        name: from.name()?,
    };
    from.skip_list(24)?; // x, y: f64; point: u64
    Ok(image)
}

/// Reads a point; its track is skipped.
fn point(from: &mut Fields<'_>) -> Result<ColmapPoint> {
    let point = ColmapPoint {
        id: from.number("POINT3D_ID", u64::from_le_bytes)?,
        position: from.array(["X", "Y", "Z"], f64::from_le_bytes)?,
        color: from.array(["R", "G", "B"], u8::from_le_bytes)?,
        error: from.number("ERROR", f64::from_le_bytes)?,
    };
    from.skip_list(8)?; // image, observation: u32
    Ok(point)
}

impl ColmapModel {
    /// Reads `cameras`, `images` and, if there is one, `points3D` in `dir`, of the ending `.bin` or `.txt`.
    ///
    /// # Errors
    /// A missing, truncated or overlong file or line; a camera model that is not read; a number that is not finite; no image.
    pub fn read(dir: &Path, binary: bool) -> Result<Self> {
        let ending = if binary { "bin" } else { "txt" };
        let file = |stem: &str| dir.join(format!("{stem}.{ending}"));
        let points = file("points3D");
        let model = Self {
            cameras: records(&file("cameras"), binary, ("camera", 24, false), camera)?,
            images: records(&file("images"), binary, ("image", 73, true), image)?,
            points: if points.is_file() {
                records(&points, binary, ("point", 51, false), point)?
            } else {
                Vec::new()
            },
        };
        model.validate(file)?;
        Ok(model)
    }

    /// Writes `cameras`, `images` and `points3D` into `dir`, which is created where needed.
    ///
    /// # Errors
    /// [`Error::Io`] if the system refuses.
    pub fn write(&self, dir: &Path, binary: bool) -> Result<()> {
        let start = |count: usize, comment: &str| Output::new(binary, count, comment);
        let mut cameras = start(
            self.cameras.len(),
            "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n",
        );
        for c in &self.cameras {
            cameras.numbers(&[c.id], u32::to_le_bytes);
            if binary {
                cameras.numbers(&[1], i32::to_le_bytes);
            } else {
                cameras.name("PINHOLE");
            }
            cameras.numbers(&[c.width, c.height].map(u64::from), u64::to_le_bytes);
            cameras.numbers(&c.params, f64::to_le_bytes);
            cameras.end(&[], "\n");
        }
        let mut images = start(
            self.images.len(),
            "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n# POINTS2D[]\n",
        );
        for i in &self.images {
            images.numbers(&[i.id], u32::to_le_bytes);
            images.numbers(&i.rotation, f64::to_le_bytes);
            images.numbers(&i.translation, f64::to_le_bytes);
            images.numbers(&[i.camera_id], u32::to_le_bytes);
            images.name(&i.name);
            images.end(&[0; 8], "\n\n");
        }
        let mut points = start(
            self.points.len(),
            "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[]\n",
        );
        for p in &self.points {
            points.numbers(&[p.id], u64::to_le_bytes);
            points.numbers(&p.position, f64::to_le_bytes);
            points.numbers(&p.color, u8::to_le_bytes);
            points.numbers(&[p.error], f64::to_le_bytes);
            points.end(&[0; 8], "\n");
        }
        std::fs::create_dir_all(dir).map_err(|e| Error::io(dir, e))?;
        let ending = if binary { "bin" } else { "txt" };
        for (stem, output) in [
            ("cameras", cameras),
            ("images", images),
            ("points3D", points),
        ] {
            let file = dir.join(format!("{stem}.{ending}"));
            std::fs::write(&file, output.bytes).map_err(|e| Error::io(&file, e))?;
        }
        Ok(())
    }

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

    /// Refuses non-finite numbers, unusable intrinsics, repeated identifiers and unknown cameras. `file` gives the path of each
    /// of the three files by its stem.
    fn validate(&self, file: impl Fn(&str) -> PathBuf) -> Result<()> {
        let bad = |stem: &str, what: String| Err(Error::input(file(stem), what, REBUILD));
        let mut ids = HashSet::new();
        for c in &self.cameras {
            let [fx, fy, cx, cy] = c.params;
            let finite = c.lens.is_valid() && c.params.iter().all(|v| v.is_finite());
            if !(finite && fx > 0.0 && fy > 0.0 && c.width > 0 && c.height > 0) {
                let what = format!(
                    "camera {} is {}×{} with fx {fx}, fy {fy}, cx {cx}, cy {cy}, {:?}; positive sizes and focal lengths, and finite coefficients within the domain of the model expected",
                    c.id, c.width, c.height, c.lens
                );
                return bad("cameras", what);
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
                let what = format!(
                    "image {i} ({}) has the pose q = {:?}, t = {:?}; finite numbers and a non-zero quaternion expected",
                    image.name, image.rotation, image.translation
                );
                return bad("images", what);
            }
            if !ids.contains(&image.camera_id) {
                let what = format!("{} uses camera {}, which", image.name, image.camera_id);
                return bad("images", format!("{what} the cameras file does not hold"));
            }
            if !names.insert(image.name.as_str()) {
                return bad("images", format!("image {} is given twice", image.name));
            }
        }
        let far = |p: &ColmapPoint| p.position.iter().any(|v| !v.is_finite());
        if let Some(i) = self.points.iter().position(far) {
            let place = self.points[i].position;
            let what = format!("point {i} lies at {place:?}; finite numbers expected");
            return bad("points3D", what);
        }
        if self.images.is_empty() {
            let what = "no registered image; at least one expected";
            return bad("images", what.into());
        }
        Ok(())
    }
}
