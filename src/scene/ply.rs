//! 3DGS PLY files, with the properties and their order as in Inria's implementation (Kerbl et al. 2023, `save_ply`).
//!
//! Everything is stored raw: log-scales, opacity logits, quaternions w, x, y, z, SH coefficients. `f_rest_*` goes channel
//! by channel: all coefficients but the first of red, then of green, then of blue.

use std::io::Write;
use std::path::Path;

use glam::DVec3;

use crate::base::error::{Error, Result};
use crate::base::ply::{self as table, Kind, Table};
use crate::capture::{Frame, Points};
use crate::scene::gaussians::{Gaussians, Plane, sh_coefficients};

/// The kind of file that this module writes.
const SCENE: Kind = [
    "a scene PLY of 3DGS (x y z, f_dc_0 to 2, opacity, scale_0 to 2, rot_0 to 3)",
    "export the Gaussians as plain 3DGS PLY, with all these properties",
];

/// Endings of the scene formats that are not read.
const OTHER_FORMATS: [&str; 4] = ["spz", "splat", "ksplat", "sog"];

/// Opacity logit in the place of an infinite one, which formats of 8 bits leave of opacities of 0 and 1: an opacity that no kernel
/// tells from these.
const SATURATED: f64 = 15.0;

/// Beginning of the comment on the filters of a scene.
const MARK: &str = "mhsplat anti-aliasing:";
/// The comment in the header of a scene that was trained with anti-aliasing; the 2D filter's variance in pixels²
/// ([`crate::base::constants::blur`]).
pub const ANTI_ALIASED: &str =
    "mhsplat anti-aliasing: mip-splatting, 2D filter of 0.1, 3D filter applied";

/// Writes the Gaussians in the dataset's frame, into which `frame` takes the local one, binary little endian, atomically.
///
/// Positions are moved in f64 and then rounded to f32, the format's precision: at UTM offsets (10⁶ m) that leaves 0.5 m.
///
/// # Errors
/// [`Error::Numerics`] for a parameter that is not finite (nothing is written then), [`Error::Io`].
pub fn write(path: &Path, splats: &Gaussians, frame: &Frame) -> Result<()> {
    write_filtered(path, splats, &[], frame)
}

/// Writes a scene trained with anti-aliasing: each Gaussian's 3D filter (standard deviations `filter` \[N\], local units) is
/// merged into its scales and opacity, so that any viewer applies it, and a comment in the header says that the opacities are
/// meant for the 2D filter, with its variance. An empty `filter`: as [`write()`].
///
/// # Errors
/// Those of [`write()`]; [`Error::Numerics`] for a filter of another length.
pub fn write_filtered(
    path: &Path,
    splats: &Gaussians,
    filter: &[f32],
    frame: &Frame,
) -> Result<()> {
    let names = property_names(splats.sh_degree());
    let properties = names.iter().map(|name| ("float", name.as_str()));
    let (rows, comment) = if filter.is_empty() {
        (to_rows(splats, frame, &names)?, String::new())
    } else {
        let rows = to_rows(&splats.filtered(filter)?, frame, &names)?;
        (rows, format!("comment {ANTI_ALIASED}\n"))
    };
    table::write(path, &comment, splats.len(), properties, |out| {
        rows.iter()
            .try_for_each(|v| out.write_all(&v.to_le_bytes()))
    })
}

/// True if the header of a PLY file marks its scene as anti-aliased, so that it is to be rendered with the 2D filter. False for
/// a file that cannot be read. [`read`] returns the same with the Gaussians.
#[must_use]
pub fn is_anti_aliased(path: &Path) -> bool {
    table::read_comments(path).is_ok_and(|all| mark(&all) == Some(ANTI_ALIASED))
}

/// The comment on filters among those of a header.
fn mark(comments: &[String]) -> Option<&str> {
    let mut texts = comments.iter().map(String::as_str);
    texts.find(|comment| comment.starts_with(MARK))
}

fn property_names(sh_degree: u32) -> Vec<String> {
    let numbered = |stem: &'static str, n: usize| (0..n).map(move |i| format!("{stem}_{i}"));
    ["x", "y", "z", "nx", "ny", "nz"]
        .into_iter()
        .map(String::from)
        .chain(numbered("f_dc", 3))
        .chain(numbered("f_rest", 3 * (sh_coefficients(sh_degree) - 1)))
        .chain(["opacity".to_string()])
        .chain(numbered("scale", 3))
        .chain(numbered("rot", 4))
        .collect()
}

/// Planes of SH coefficients above the first, in the file's order.
fn rest_planes(sh_degree: u32) -> impl Iterator<Item = usize> {
    let n = sh_coefficients(sh_degree);
    (0..3).flat_map(move |c| (1..n).map(move |k| Plane::SH + 3 * k + c))
}

/// The rows of the file, `[N][properties]`, checked.
fn to_rows(splats: &Gaussians, frame: &Frame, names: &[String]) -> Result<Vec<f32>> {
    let stretch = frame.scale.ln();
    let rest: Vec<usize> = rest_planes(splats.sh_degree()).collect();
    let mut rows = Vec::with_capacity(splats.len() * names.len());
    for i in 0..splats.len() {
        let start = rows.len();
        let position = DVec3::from_array(splats.gather(Plane::POSITION, i).map(f64::from));
        rows.extend(frame.to_dataset(position).as_vec3().to_array());
        rows.extend([0.0; 3]);
        rows.extend(splats.gather::<3>(Plane::SH, i));
        rows.extend(rest.iter().map(|&p| splats.gather::<1>(p, i)[0]));
        rows.extend(splats.gather::<1>(Plane::OPACITY, i));
        let scales: [f32; 3] = splats.gather(Plane::LOG_SCALE, i);
        rows.extend(scales.map(|s| (f64::from(s) + stretch) as f32));
        rows.extend(splats.gather::<4>(Plane::ROTATION, i));
        if let Some(k) = rows[start..].iter().position(|v| !v.is_finite()) {
            let what = format!("{} of Gaussian {i} is {}", names[k], rows[start + k]);
            return Err(Error::numerics("export", what));
        }
    }
    Ok(rows)
}

/// A scene as its file holds it, in the local frame.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneFile {
    /// The Gaussians.
    pub splats: Gaussians,
    /// True if they were trained with anti-aliasing and are to be rendered with the 2D filter; their scales and opacities
    /// then include the 3D filter.
    pub anti_aliased: bool,
    /// Number of opacities of exactly 0 or 1 (infinite logits), which are read as nearly that.
    pub saturated: usize,
}

/// Contents of a PLY file, in the local frame.
#[derive(Debug, Clone)]
pub enum Contents {
    /// Gaussians.
    Scene(SceneFile),
    /// A plain point cloud: no 3DGS properties.
    Points(Points),
}

/// Reads Gaussians, or a plain point cloud (`x y z`, and `red green blue` if there are any; grey otherwise).
///
/// # Errors
/// Those of [`read`]; a point cloud without `x y z`, or with a point too far away for single precision.
pub fn read_either(path: &Path, frame: &Frame) -> Result<Contents> {
    let table = plain(path)?;
    if holds_gaussians(&table) {
        from_table(path, &table, frame).map(Contents::Scene)
    } else {
        Points::local(path, frame, table.points()?).map(Contents::Points)
    }
}

/// The table of a plain PLY file.
fn plain(path: &Path) -> Result<Table> {
    const CONVERT: &str = "convert it to a plain PLY (SuperSplat and splat-transform do)";
    let ending = path.extension().and_then(|e| e.to_str()).unwrap_or("");
    let other = OTHER_FORMATS
        .iter()
        .find(|o| ending.eq_ignore_ascii_case(o));
    if let Some(other) = other.filter(|_| path.is_file()) {
        return Err(Error::input(
            path,
            format!("a .{other} file; PLY expected"),
            CONVERT,
        ));
    }
    let table = Table::read(path)?;
    if table.has("packed_position") {
        return Err(Error::input(
            path,
            "a compressed PLY; a plain one expected",
            CONVERT,
        ));
    }
    Ok(table)
}

fn holds_gaussians(table: &Table) -> bool {
    table.has("opacity") || table.has("f_dc_0")
}

/// Reads Gaussians, ascii or binary little endian, properties in any order and of any scalar type. The SH degree follows
/// from the number of `f_rest_*`.
///
/// # Errors
/// [`Error::Input`] for a file of another format, a truncated one, a missing property, a value that is not finite (named by
/// row and property), or a scene trained with other filters; [`Error::Io`].
pub fn read(path: &Path, frame: &Frame) -> Result<SceneFile> {
    let table = plain(path)?;
    if holds_gaussians(&table) {
        return from_table(path, &table, frame);
    }
    let [expected, fix] = SCENE;
    let what =
        format!("neither f_dc_0 nor opacity, as in a plain point cloud; {expected} expected");
    Err(Error::input(path, what, fix))
}

fn from_table(path: &Path, table: &Table, frame: &Frame) -> Result<SceneFile> {
    let mark = mark(&table.comments);
    if let Some(other) = mark.filter(|mark| *mark != ANTI_ALIASED) {
        return Err(Error::input(
            path,
            format!("trained with other filters than this version's (`{ANTI_ALIASED}`): `{other}`"),
            "train it again, or show it with the version that trained it",
        ));
    }
    let rest = table.names().filter(|n| n.starts_with("f_rest_")).count();
    let Some(sh_degree) = (0..=3).find(|&d| 3 * (sh_coefficients(d) - 1) == rest) else {
        return Err(Error::input(
            path,
            format!("{rest} properties f_rest_*; 0, 9, 24 or 45 expected (SH degree 0 to 3)"),
            "export the scene again",
        ));
    };
    let stretch = frame.scale.ln();
    let mut planes = vec![Vec::new(); Plane::count(sh_degree)];
    let (opacities, saturated) = table.limited_column("opacity", SCENE, SATURATED)?;
    planes[Plane::OPACITY] = opacities.into_iter().map(|v| v as f32).collect();
    let mut fill = |plane: usize, name: String, change: &dyn Fn(f64) -> f64| -> Result<()> {
        let values = table.column(&name, SCENE)?;
        planes[plane] = values.into_iter().map(|v| change(v) as f32).collect();
        match planes[plane].iter().position(|v| !v.is_finite()) {
            None => Ok(()),
            Some(row) => Err(Error::input(
                path,
                format!("{name} of vertex {row} is beyond single precision"),
                "remove the Gaussian",
            )),
        }
    };
    for (k, name) in ["x", "y", "z"].into_iter().enumerate() {
        let to_local = |v: f64| (v - frame.center[k]) / frame.scale;
        fill(Plane::POSITION + k, name.into(), &to_local)?;
        fill(Plane::LOG_SCALE + k, format!("scale_{k}"), &|v| v - stretch)?;
        fill(Plane::SH + k, format!("f_dc_{k}"), &|v| v)?;
    }
    for k in 0..4 {
        fill(Plane::ROTATION + k, format!("rot_{k}"), &|v| v)?;
    }
    for (i, plane) in rest_planes(sh_degree).enumerate() {
        fill(plane, format!("f_rest_{i}"), &|v| v)?;
    }
    Ok(SceneFile {
        splats: Gaussians::new(sh_degree, planes)?,
        anti_aliased: mark.is_some(),
        saturated,
    })
}
