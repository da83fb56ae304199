//! RealityScan's (RealityCapture's) "Internal/External camera parameters": a CSV with a row for each photo.
//!
//! Conventions: M. Hornáček, "On the Coordinate Systems Employed in the Import, Estimation, and Export of Camera Geometry by
//! RealityScan", 2026: yaw, pitch and roll of a body in the north-east-down system with the nadir-facing default mount (§5.1); lengths
//! normalised by the larger image side around the centre of the image (Eq. 27–31); Brown's lens with the tangential terms the other way
//! round than OpenCV's (Eq. 47). The column `f` is the focal length for a film 36 wide; the shipped template writes `px` and `py` as
//! normalised lengths, which newer headers say (`px_norm`), and older ones are read alike. A division lens, which the columns cannot tell
//! from Brown's, is read as Brown's.

use std::path::Path;

use glam::{DMat3, DVec3};

use crate::base::error::{Error, Result};
use crate::capture::assemble::RawScene;
use crate::capture::camera::Camera;
use crate::capture::dataset::Layout;
use crate::capture::exports::shared::{add_cloud, scene};
use crate::capture::lens::Lens;
use crate::capture::source;

/// Width of a film to which focal lengths are equivalent, mm.
const FILM: f64 = 36.0;

/// Columns that every such file has, each with its names.
const NEEDED: [&[&str]; 8] = [
    &["name"],
    &["x"],
    &["y"],
    &["alt", "z"],
    &["heading", "yaw"],
    &["pitch"],
    &["roll"],
    &["f", "f_35mm"],
];
/// Columns that may be left out, and then are 0.
const OTHERS: [&[&str]; 8] = [
    &["px", "px_norm"],
    &["py", "py_norm"],
    &["k1"],
    &["k2"],
    &["k3"],
    &["k4"],
    &["t1"],
    &["t2"],
];

/// Remedy for a file that cannot be used.
const EXPORT: &str = "export \"Internal/External camera parameters\" again";

/// The columns of a header, first those of [`NEEDED`], then those of [`OTHERS`]; `None` for another header.
fn columns(header: &str) -> Option<Vec<Option<usize>>> {
    let header = header.trim();
    let names = header.strip_prefix('#').unwrap_or(header).split(',');
    let names: Vec<String> = names.map(|n| n.trim().to_ascii_lowercase()).collect();
    let column = |known: &&[&str]| names.iter().position(|n| known.contains(&n.as_str()));
    let needed: Vec<_> = NEEDED.iter().map(column).collect();
    let complete = needed.iter().all(Option::is_some);
    complete.then(|| {
        needed
            .into_iter()
            .chain(OTHERS.iter().map(column))
            .collect()
    })
}

/// The number of the header's line; a line with the number of cameras may stand before it.
fn header_line(text: &str) -> Option<usize> {
    let first = text.lines().position(|line| !line.trim().is_empty())?;
    let counted = text.lines().nth(first)?.trim().starts_with("#cameras");
    Some(first + usize::from(counted))
}

/// True for a text that begins with the header.
pub(super) fn is_header(text: &str) -> bool {
    let line = header_line(text).and_then(|at| text.lines().nth(at));
    line.is_some_and(|line| columns(line).is_some())
}

/// A row: position; heading, pitch and roll, degrees; focal length; and the values of [`OTHERS`].
struct Row {
    name: String,
    position: DVec3,
    angles: [f64; 3],
    focal: f64,
    others: [f64; 8],
}

fn rows(file: &Path, text: &str) -> Result<Vec<Row>> {
    let at = header_line(text).unwrap_or_default();
    let header = text.lines().nth(at).and_then(columns);
    let Some(columns) = header else {
        let what = "no header #name,x,y,alt,heading,pitch,roll,f,...";
        return Err(Error::input(file, what, EXPORT));
    };
    let body: String = text.split_inclusive('\n').skip(at + 1).collect();
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .trim(csv::Trim::All)
        .from_reader(body.as_bytes());
    let mut rows = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|e| Error::input(file, e.to_string(), EXPORT))?;
        let field = |column: usize| columns[column].and_then(|at| record.get(at));
        let name = field(0).unwrap_or_default().to_owned();
        let number = |column: usize| -> Result<f64> {
            let text = match columns[column] {
                Some(at) => record.get(at).unwrap_or_default(),
                None => "0",
            };
            let number = text.parse().ok().filter(|v: &f64| v.is_finite());
            let names = NEEDED.iter().chain(&OTHERS).nth(column);
            let names = names.map(|n| n.join(" or ")).unwrap_or_default();
            let what = format!("the column {names} of {name} is '{text}'; a number expected");
            number.ok_or_else(|| Error::input(file, what, EXPORT))
        };
        let mut others = [0.0; 8];
        for (i, v) in others.iter_mut().enumerate() {
            *v = number(NEEDED.len() + i)?;
        }
        let focal = number(7)?;
        if name.is_empty() || focal <= 0.0 {
            let what = format!("a row for '{name}' with the focal length {focal}");
            return Err(Error::input(file, what, EXPORT));
        }
        rows.push(Row {
            position: DVec3::new(number(1)?, number(2)?, number(3)?),
            angles: [number(4)?, number(5)?, number(6)?],
            name,
            focal,
            others,
        });
    }
    if rows.is_empty() {
        return Err(Error::input(file, "no camera", EXPORT));
    }
    Ok(rows)
}

impl Row {
    /// The camera of a photo of this size, and its lens.
    fn camera(&self, width: u32, height: u32) -> (Camera, Lens) {
        let [heading, pitch, roll] = self.angles.map(f64::to_radians);
        // Photogrammetric camera axes (x right, y up, z back) in a frame of east, north and up.
        let attitude = DMat3::from_rotation_z(-heading)
            * DMat3::from_rotation_x(pitch)
            * DMat3::from_rotation_y(roll);
        let axes = attitude * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        let rotation = axes.transpose();
        let [w, h] = [width, height].map(f64::from);
        let side = w.max(h);
        let [px, py, k1, k2, k3, k4, t1, t2] = self.others;
        let camera = Camera {
            rotation,
            translation: -(rotation * self.position),
            fx: self.focal / FILM * side,
            fy: self.focal / FILM * side,
            cx: w / 2.0 + px * side,
            cy: h / 2.0 + py * side,
            width,
            height,
        };
        let lens = match [k1, k2, k3, k4, t1, t2] == [0.0; 6] {
            true => Lens::Pinhole,
            false => Lens::Brown {
                fisheye: false,
                radial: [k1, k2, k3, k4],
                tangential: [t2, t1],
                skew: 0.0,
            },
        };
        (camera, lens)
    }
}

/// The views of a file in `root`, and the points beside it.
///
/// # Errors
/// A row that lacks a number; what [`scene`] and [`add_cloud`] refuse.
pub(super) fn load(root: &Path, file: &Path, asked: Option<&Path>) -> Result<RawScene> {
    let bytes = crate::base::files::read_text(file)?;
    let rows = rows(file, &String::from_utf8_lossy(&bytes))?;
    let names: Vec<&str> = rows.iter().map(|row| row.name.as_str()).collect();
    let place = (root, file, Layout::RealityScan);
    let mut scene = scene(place, asked, &names, |i, image| {
        let header = source::header(image)?;
        Ok(rows[i].camera(header.width, header.height))
    })?;
    add_cloud(&mut scene, root, file)?;
    Ok(scene)
}
