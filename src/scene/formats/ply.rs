//! 3DGS PLY files, with the properties and their order as in Inria's implementation (Kerbl et al. 2023, `save_ply`).
//!
//! Everything is stored raw: log-scales, opacity logits, quaternions w, x, y, z, SH coefficients. `f_rest_*` goes channel
//! by channel: all coefficients but the first of red, then of green, then of blue.

use std::collections::HashMap;
use std::io::Write;
use std::path::Path;

use glam::DVec3;

use crate::base::error::{Error, Result};
use crate::base::ply::{self as table, Content, Kind, Table};
use crate::capture::{Frame, Points};
use crate::scene::formats::scene_file::{Contents, SATURATED, SceneFile, Sphere};
use crate::scene::formats::shell::{Reach, Shell};
use crate::scene::gaussians::{Gaussians, Plane, sh_coefficients};

/// The kind of file that this module writes.
const SCENE: Kind = [
    "a scene PLY of 3DGS (x y z, f_dc_0 to 2, opacity, scale_0 to 2, rot_0 to 3)",
    "export the Gaussians as plain 3DGS PLY, with all these properties",
];

/// Beginning of the comment on the filters of a scene.
const MARK: &str = "mhsplat anti-aliasing:";
/// The comment in the header of a scene that was trained with anti-aliasing; the 2D filter's variance in pixels²
/// ([`crate::base::constants::blur`]).
pub const ANTI_ALIASED: &str =
    "mhsplat anti-aliasing: mip-splatting, 2D filter of 0.1, 3D filter applied";

/// Mark of the renderer that a scene is made for, as Brush writes it, and its value for the 2D filter.
const RENDER_MODE: &str = "SplatRenderMode:";
/// Mark of the direction away from the ground, as Brush writes it.
const UP: &str = "Vertical axis:";
/// Mark of the sphere around the cameras that a scene was trained with: centre and radius.
const CAMERAS: &str = "mhsplat cameras within:";
/// Mark of the colour behind a scene, and of the Gaussians that show it.
const BACKGROUND: &str = "mhsplat background:";

/// Standard deviation of a Gaussian's 3D filter, world units, in the files of Mip-Splatting, which leave it unmerged.
const FILTER: &str = "filter_3D";
/// Colour transforms of photos, in the files of 3DGS.
const EXPOSURES: &str = "exposure.json";

/// Writes the Gaussians in the dataset's frame, into which `frame` takes the local one, binary little endian, atomically.
///
/// # Errors
/// Those of [`write_scene`].
pub fn write(path: &Path, splats: &Gaussians, frame: &Frame) -> Result<()> {
    write_filtered(path, splats, &[], frame)
}

/// Writes a scene trained with anti-aliasing: [`SceneFile::trained`]. An empty `filter`: as [`write()`].
///
/// # Errors
/// Those of [`write_scene`] and of [`SceneFile::trained`].
pub fn write_filtered(
    path: &Path,
    splats: &Gaussians,
    filter: &[f32],
    frame: &Frame,
) -> Result<()> {
    write_scene(path, &SceneFile::trained(splats, filter)?, frame)
}

/// Writes a scene with its marks in the header's comments: ours and those of other programs.
///
/// Positions are moved in f64 and then rounded to f32, the format's precision: at UTM offsets (10⁶ m) that leaves 0.5 m.
///
/// # Errors
/// [`Error::Numerics`] for a parameter that is not finite (nothing is written then), [`Error::Io`].
pub fn write_scene(path: &Path, scene: &SceneFile, frame: &Frame) -> Result<()> {
    let scene = scene.enclosed(Reach::SINGLE)?;
    let splats = &scene.splats;
    let names = property_names(splats.sh_degree());
    let properties = names.iter().map(|name| ("float", name.as_str()));
    let rows = to_rows(splats, frame, &names)?;
    let cameras = scene.cameras.map(|sphere| sphere.in_dataset(frame));
    let comments = comments(&scene, cameras);
    table::write(path, &comments, splats.len(), properties, |out| {
        rows.iter()
            .try_for_each(|v| out.write_all(&v.to_le_bytes()))
    })
}

/// The comment lines on a scene with its cameras within this sphere of the dataset's frame.
pub(super) fn comments(scene: &SceneFile, cameras: Option<Sphere>) -> String {
    let mut lines = String::new();
    if let Some([x, y, z]) = scene.up {
        lines += &format!("comment {UP} {x:.5} {y:.5} {z:.5}\n");
    }
    if let Some(Sphere { center, radius }) = cameras {
        let [x, y, z] = center.to_array();
        lines += &format!("comment {CAMERAS} {x} {y} {z} {radius}\n");
    }
    if let Some(color) = scene.background {
        lines += &format!("comment {BACKGROUND} {}\n", Shell::text(color));
    }
    if scene.anti_aliased {
        lines += &format!("comment {ANTI_ALIASED}\ncomment {RENDER_MODE} mip\n");
    }
    lines
}

/// True if the header of a PLY file, plain or compressed, marks its scene as anti-aliased, so that it is to be rendered with the 2D
/// filter. False for a file that cannot be read.
pub(super) fn is_anti_aliased(path: &Path) -> bool {
    table::read_comments(path).is_ok_and(|all| marks(path, &all).is_ok_and(|m| m.anti_aliased))
}

/// Marks of a scene in the comments of its header.
pub(super) struct Marks {
    pub(super) anti_aliased: bool,
    pub(super) up: Option<[f64; 3]>,
    /// In the dataset's frame.
    pub(super) cameras: Option<Sphere>,
    pub(super) shell: Option<Shell>,
}

/// The marks among the comments of a header: our own counts before the others'.
///
/// # Errors
/// [`Error::Input`] for a scene trained with other filters than ours.
pub(super) fn marks(path: &Path, comments: &[String]) -> Result<Marks> {
    let mut texts = comments.iter().map(String::as_str);
    let own = texts.find(|comment| comment.starts_with(MARK));
    if let Some(other) = own.filter(|mark| *mark != ANTI_ALIASED) {
        return Err(Error::input(
            path,
            format!("trained with other filters than this version's (`{ANTI_ALIASED}`): `{other}`"),
            "train it again, or show it with the version that trained it",
        ));
    }
    let value = |key: &str| {
        let long = |c: &&String| {
            c.get(..key.len())
                .is_some_and(|k| k.eq_ignore_ascii_case(key))
        };
        comments
            .iter()
            .rev()
            .find(long)
            .map(|c| c[key.len()..].trim())
    };
    let mip = value(RENDER_MODE).is_some_and(|mode| mode.eq_ignore_ascii_case("mip"));
    // Postshot's.
    let flag = value("antialiased ") == Some("1");
    let numbers = |key: &str| -> Option<Vec<f64>> {
        let parts = value(key)?.split_whitespace();
        parts.map(|v| v.parse().ok()).collect()
    };
    let up = numbers(UP).and_then(|up| {
        let up: [f64; 3] = up.try_into().ok()?;
        let direction = DVec3::from(up).try_normalize();
        direction.map(|up| up.to_array())
    });
    let cameras = numbers(CAMERAS).and_then(|sphere| {
        let [x, y, z, radius]: [f64; 4] = sphere.try_into().ok()?;
        let center = DVec3::new(x, y, z);
        let real = center.is_finite() && radius.is_finite() && radius > 0.0;
        real.then_some(Sphere { center, radius })
    });
    Ok(Marks {
        anti_aliased: own.is_some() || mip || flag,
        up,
        cameras,
        shell: value(BACKGROUND).and_then(Shell::parse),
    })
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
pub(super) fn rest_planes(sh_degree: u32) -> impl Iterator<Item = usize> {
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

/// Reads Gaussians, or a plain point cloud (`x y z`, and `red green blue` if there are any; grey otherwise), from the content of a
/// file.
///
/// # Errors
/// Those of [`from_table`]; a point cloud without `x y z`, or with a point too far away for single precision.
pub(super) fn contents(path: &Path, content: &Content, frame: &Frame) -> Result<Contents> {
    let table = content.table("vertex")?;
    if holds_gaussians(&table) {
        from_table(path, &table, frame).map(Contents::Scene)
    } else {
        Points::local(path, frame, table.points()?).map(Contents::Points)
    }
}

/// The Gaussians among the contents of a file.
///
/// # Errors
/// [`Error::Input`] for a point cloud.
pub(super) fn scene_of(path: &Path, contents: Contents) -> Result<SceneFile> {
    match contents {
        Contents::Scene(scene) => Ok(scene),
        Contents::Points(_) => {
            let [expected, fix] = SCENE;
            let what = format!(
                "neither f_dc_0 nor opacity, as in a plain point cloud; {expected} expected"
            );
            Err(Error::input(path, what, fix))
        }
    }
}

fn holds_gaussians(table: &Table) -> bool {
    table.has("opacity") || table.has("f_dc_0")
}

/// Gaussians, ascii or binary little endian, properties in any order and of any scalar type. The SH degree follows from the number of
/// `f_rest_*`.
///
/// # Errors
/// [`Error::Input`] for a missing property, a value that is not finite (named by row and property), or a scene trained with other
/// filters.
fn from_table(path: &Path, table: &Table, frame: &Frame) -> Result<SceneFile> {
    let marks = marks(path, &table.comments)?;
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
    let splats = Gaussians::new(sh_degree, planes)?;
    let mut remarks: Vec<String> = exposures(path).into_iter().collect();
    let (splats, filtered) = match table.has(FILTER) {
        true => {
            let filter = table.column(FILTER, SCENE)?;
            let local: Vec<f32> = filter.iter().map(|v| (v / frame.scale) as f32).collect();
            remarks.push(format!(
                "{FILTER}, each Gaussian's 3D filter, is merged into scales and opacities"
            ));
            (splats.filtered(&local)?, true)
        }
        false => (splats, false),
    };
    Ok(SceneFile {
        anti_aliased: marks.anti_aliased || filtered,
        up: marks.up,
        cameras: marks.cameras.map(|sphere| sphere.in_local(frame)),
        saturated,
        remarks,
        ..SceneFile::new(splats)
    }
    .without_shell(marks.shell))
}

/// A sentence on the colour transforms of photos, [R|t] by name, that 3DGS leaves beside its scene, three folders up or nearer;
/// none if they change nothing, as those of a scene that was trained without them.
fn exposures(path: &Path) -> Option<String> {
    let folders = path.ancestors().skip(1).take(4);
    let mut files = folders.map(|folder| folder.join(EXPOSURES));
    let file = files.find(|file| file.is_file())?;
    let all: HashMap<String, [[f64; 4]; 3]> =
        serde_json::from_slice(&std::fs::read(&file).ok()?).ok()?;
    let identity = |r: usize, c: usize| if r == c { 1.0 } else { 0.0 };
    let entry = |m: &[[f64; 4]; 3], at: usize| m[at / 4][at % 4] - identity(at / 4, at % 4);
    let changes = |m: &[[f64; 4]; 3]| (0..12).any(|at| entry(m, at).abs() > 1e-3);
    if !all.values().any(changes) {
        return None;
    }
    Some(format!(
        "{}: the scene was trained with a colour transform for each photo; they are not applied, and photos score lower than with them",
        file.display()
    ))
}
