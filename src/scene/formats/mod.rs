//! Scene files of several formats: told apart by their content when they are read, by their names when they are written.
//!
//! | format | ending | what it keeps |
//! |---|---|---|
//! | `ply.rs` | `.ply` | everything |
//! | `compressed_ply.rs` | `.compressed.ply` | everything, rounded |
//! | `spz.rs` | `.spz` | everything but the direction up and the cameras' sphere, rounded |
//! | `splat.rs` | `.splat` | no view-dependent colour, no mark of anti-aliasing, no direction up, no sphere; rounded |
//! | `glb.rs` | `.glb` | everything but the cameras' sphere |
//! | `sog.rs` | `.sog`, read alone | everything but the direction up and the cameras' sphere, rounded |
//!
//! How far they round is in `docs/guide/viewing.md`.

mod compressed_ply;
mod glb;
pub mod ply;
mod scene_file;
mod shell;
mod sog;
mod splat;
mod spz;

use std::fs::File;
use std::io::Read;
use std::path::Path;

use crate::base::error::{Error, Result};
use crate::base::files;
use crate::base::ply::Content;
use crate::capture::Frame;
use crate::config::SceneFormat;

pub use crate::scene::formats::scene_file::{Contents, SceneFile, Sphere};
use crate::scene::formats::shell::Reach;
use crate::scene::formats::spz::Packing;
use crate::scene::morton;

/// Share of the scene's extent, a radius of the cameras: half a pixel of a photo of 2000 that shows it.
const COARSE: f64 = 2.5e-4;

/// Endings of formats, those within others first.
const ENDINGS: [(&str, SceneFormat); 6] = [
    (".compressed.ply", SceneFormat::CompressedPly),
    (".ply", SceneFormat::Ply),
    (".v4.spz", SceneFormat::SpzV4),
    (".spz", SceneFormat::Spz),
    (".splat", SceneFormat::Splat),
    (".glb", SceneFormat::Glb),
];

/// Ending of a format's files.
#[must_use]
pub fn ending(format: SceneFormat) -> &'static str {
    let found = ENDINGS.iter().find(|(_, f)| *f == format);
    found.map_or("", |(ending, _)| ending)
}

/// Format of a file to be written, by its name.
///
/// # Errors
/// [`Error::Input`] for another ending.
pub fn of_name(path: &Path) -> Result<SceneFormat> {
    let name = path.file_name().unwrap_or_default();
    let name = name.to_string_lossy().to_lowercase();
    let found = ENDINGS.iter().find(|(ending, _)| name.ends_with(ending));
    found.map(|(_, format)| *format).ok_or_else(|| {
        let endings: Vec<&str> = ENDINGS.iter().map(|(ending, _)| *ending).collect();
        let fix = format!("end the name in {}", endings.join(", "));
        Error::input(
            path,
            "not the name of a scene file that can be written",
            fix,
        )
    })
}

/// Reads Gaussians of any format, into the local frame.
///
/// # Errors
/// [`Error::Input`] for a file of another format, a truncated or damaged one, numbers that are none, a point cloud, or a scene trained
/// with other filters; [`Error::Io`].
pub fn read(path: &Path, frame: &Frame) -> Result<SceneFile> {
    ply::scene_of(path, read_either(path, frame)?)
}

/// Reads Gaussians of any format, or the plain point cloud of a PLY file.
///
/// # Errors
/// Those of [`read`], but for the point cloud.
pub fn read_either(path: &Path, frame: &Frame) -> Result<Contents> {
    let bytes = files::read(path)?;
    if bytes.starts_with(&spz::GZIP) || bytes.starts_with(&spz::MAGIC) {
        return spz::read(path, &bytes, frame).map(Contents::Scene);
    }
    if bytes.starts_with(b"ply") {
        let content = Content::new(path, bytes)?;
        return match compressed_ply::is_compressed(&content) {
            true => compressed_ply::read(path, &content, frame).map(Contents::Scene),
            false => ply::contents(path, &content, frame),
        };
    }
    if bytes.starts_with(&glb::MAGIC) {
        return glb::read(path, &bytes, frame).map(Contents::Scene);
    }
    if bytes.starts_with(&sog::MAGIC) {
        return sog::read(path, &bytes, frame).map(Contents::Scene);
    }
    let extension = path.extension().unwrap_or_default().to_string_lossy();
    match extension.to_lowercase().as_str() {
        // Nothing in its content tells it from any other data.
        "splat" => splat::read(path, &bytes, frame).map(Contents::Scene),
        "sog" => {
            let what = "no zip archive, as a .sog file is";
            Err(Error::input(path, what, "export the SOG file again"))
        }
        other @ ("ksplat" | "gltf") => {
            let what = format!("a .{other} file, which is not read here");
            let fix = "convert it to .ply, .spz or .glb (SuperSplat and splat-transform do)";
            Err(Error::input(path, what, fix))
        }
        _ => {
            let what = "the first line is not 'ply', and it is no SPZ file either";
            Err(Error::input(
                path,
                what,
                "give a scene of PLY, compressed PLY, SPZ, SOG, .splat or .glb",
            ))
        }
    }
}

/// Bytes of a file's beginning that tell whether its scene is anti-aliased.
const BEGINNING: u64 = 1 << 16;

/// True if a scene file is marked as anti-aliased, so that it is to be rendered with the 2D filter. False for a file that cannot be
/// read. [`read`] returns the same with the Gaussians.
#[must_use]
pub fn is_anti_aliased(path: &Path) -> bool {
    let mut start = Vec::new();
    let open = files::check_regular(path).is_ok().then(|| File::open(path));
    let read = open.and_then(|file| file.ok()?.take(BEGINNING).read_to_end(&mut start).ok());
    let in_archive = || {
        let whole = start.starts_with(&sog::MAGIC).then(|| files::read(path));
        whole.is_some_and(|w| w.is_ok_and(|bytes| sog::is_anti_aliased(path, &bytes)))
    };
    let marked =
        || spz::is_anti_aliased(&start) || glb::is_anti_aliased(path, &start) || in_archive();
    read.is_some() && (ply::is_anti_aliased(path) || marked())
}

/// Writes a scene into the dataset's frame, into which `frame` takes the local one, atomically. Returns what the format could not keep
/// in this scene, in sentences.
///
/// # Errors
/// [`Error::Numerics`] for a parameter that is not finite, [`Error::Input`] for a scene too large for the format (nothing is written
/// then), [`Error::Io`].
pub fn write(
    path: &Path,
    format: SceneFormat,
    scene: &SceneFile,
    frame: &Frame,
) -> Result<Vec<String>> {
    if format == SceneFormat::Ply {
        return ply::write_scene(path, scene, frame).map(|()| Vec::new());
    }
    let moved = scene_file::in_dataset(&scene.splats, frame)?;
    let scene = SceneFile {
        splats: match format {
            SceneFormat::CompressedPly => moved.in_morton_order(morton::NO_UP),
            _ => moved,
        },
        cameras: scene.cameras.map(|sphere| sphere.in_dataset(frame)),
        remarks: scene.remarks.clone(),
        ..*scene
    };
    let reach = match format {
        SceneFormat::Spz | SceneFormat::SpzV4 => spz::reach(path, &scene.splats)?,
        _ => Reach::SINGLE,
    };
    let room = scene.background.is_none() || scene.enclosing(reach).is_some();
    let scene = scene.enclosed(reach)?;
    let (bytes, mut remarks) = match format {
        SceneFormat::Spz => spz::encode(path, &scene, Packing::Gzip)?,
        SceneFormat::SpzV4 => spz::encode(path, &scene, Packing::Zstandard)?,
        SceneFormat::Splat => splat::encode(&scene),
        SceneFormat::Glb => glb::encode(path, &scene)?,
        SceneFormat::Ply | SceneFormat::CompressedPly => compressed_ply::encode(&scene),
    };
    if !room {
        let name = path.file_name().unwrap_or(path.as_os_str());
        remarks.push(format!(
            "{}: the background is left out, because this format has no room for a shell about the Gaussians",
            name.display()
        ));
    }
    files::write_bytes(path, &bytes)?;
    Ok(remarks)
}

/// A remark where the dataset's coordinates are so large that positions in f32 lose more than [`COARSE`] of the scene's extent.
pub(crate) fn rounded(frame: &Frame) -> Option<String> {
    let largest = frame.center.abs().max_element();
    let step = largest.log2().floor().exp2() * f64::from(f32::EPSILON);
    (step > COARSE * frame.scale).then(|| {
        format!(
            "warning: positions are rounded to {step:.2e} units, {:.1e} of the scene's extent, because the dataset lies {largest:.1e} units from its origin: \
             what is written looks worse than what was trained; shift the dataset's cameras and points towards the origin",
            step / frame.scale
        )
    })
}

#[cfg(test)]
mod tests {
    use super::rounded;
    use crate::capture::Frame;

    #[test]
    fn coordinates_far_from_the_origin_are_told() {
        let at = |x: f64| {
            let mut frame = Frame::IDENTITY;
            (frame.center.x, frame.scale) = (x, 5.0);
            rounded(&frame)
        };
        assert_eq!((at(0.0), at(-1000.0)), (None, None));
        // UTM.
        let said = at(-5_428_000.0).unwrap();
        assert!(
            said.contains("5.00e-1 units, 1.0e-1 of the scene's extent"),
            "{said}"
        );
    }
}
