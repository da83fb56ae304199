//! Posed photos: files → [`Dataset`] of [`View`]s in a local frame.

mod archive;
mod assemble;
pub mod camera;
pub mod colmap;
mod dataset;
mod endings;
mod exports;
pub mod frame;
mod images;
pub mod lens;
mod memory;
pub mod panorama;
pub mod photo;
pub mod point_cloud;
mod rows;
pub mod source;
pub mod transforms;
mod up;

use crate::capture::archive::ONE_OF_THEM;
pub use crate::capture::archive::{Temporary, is_archive, remove_temporary};
pub use crate::capture::camera::Camera;
pub use crate::capture::dataset::{Dataset, Layout, LoadOptions, View};
pub use crate::capture::frame::Frame;
pub use crate::capture::lens::{Lens, Undistortion};
#[doc(hidden)]
pub use crate::capture::photo::shrink;
pub use crate::capture::photo::{Alpha, Photo};
pub use crate::capture::point_cloud::Points;
pub use crate::capture::source::{PhotoFile, PhotoSource};
pub use crate::capture::up::up_axis;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::base::error::{Error, Result};
use crate::capture::archive::Unpacked;

/// Reads a dataset folder, or a zip archive of one: a model of COLMAP's with its photos (`sparse/0/` and `images/`, or where else programs leave them; binary
/// preferred over text), `transforms_train.json` / `transforms.json`, or the cameras that RealityScan, Metashape, Bundler, OpenSfM or OpenMVG exported.
///
/// Names are sorted bytewise before the split. Everything is computed in f64 and moved to the local frame before it is
/// rounded to f32, so that far-off frames (UTM) lose nothing. An archive is unpacked into a temporary folder, which is there until no photo
/// is to be read from it any more.
///
/// # Errors
/// [`Error::Input`] for a folder of neither layout, anything unreadable, missing, non-finite or inconsistent in it, a lens of
/// an unknown model or one that cannot be inverted, and a split that leaves no training view; [`Error::Config`] for `max_size` 0 and for an `image_budget` that is
/// too small for one photo; [`Error::Io`].
pub fn load(path: &Path, options: &LoadOptions) -> Result<Dataset> {
    if options.max_size == 0 {
        return Err(Error::config("max-size", "0; at least 1 pixel expected"));
    }
    if !is_archive(path) {
        return load_folder(path, options);
    }
    let unpacked = Arc::new(Unpacked::new(path)?);
    let data = load_folder(&whole(&unpacked.place.folder), options);
    let mut data = data.map_err(|error| unpacked.explained(error))?;
    data.path = path.to_path_buf();
    for view in data.train.iter_mut().chain(&mut data.test) {
        if let PhotoSource::File(file) = &mut view.photo {
            file.keep(&unpacked);
        }
    }
    Ok(data)
}

/// The dataset in a folder: itself, or the one folder in it.
fn whole(folder: &Path) -> PathBuf {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let hidden = |entry: &std::fs::DirEntry| entry.file_name().to_string_lossy().starts_with('.');
    let inside = entries.filter(|entry| !hidden(entry));
    let inside: Vec<_> = inside.map(|entry| entry.path()).collect();
    match &inside[..] {
        [one] if one.is_dir() && !is_dataset(folder) => one.clone(),
        _ => folder.to_path_buf(),
    }
}

/// True for a folder that holds cameras in a layout that is read.
fn is_dataset(folder: &Path) -> bool {
    let known = colmap::find(folder, None).is_some() || transforms::find(folder).is_some();
    known || !exports::find(folder).is_empty()
}

fn load_folder(path: &Path, options: &LoadOptions) -> Result<Dataset> {
    let asked = options.images.as_deref();
    let folder = match path.is_dir() {
        true => images::asked_folder(path, asked)?,
        false => None,
    };
    let model = colmap::find(path, folder.as_deref());
    let scene = match (model, transforms::find(path)) {
        (Some((place, remarks)), file) if place.usual || file.is_none() => {
            colmap::load(path, &place, remarks, asked)?
        }
        (_, Some(file)) => transforms::load(path, &file, asked)?,
        _ => match &exports::find(path)[..] {
            [] => return Err(no_dataset(path)),
            found => exports::load(path, found, asked)?,
        },
    };
    assemble::assemble(path, scene, options)
}

/// Folders of a dataset that are taken for the whole of it by mistake.
const PARTS: [&str; 6] = ["images", "sparse", "colmap", "distorted", "input", "masks"];

/// Datasets that are named of those in a folder.
const NAMED: usize = 5;

/// The refusal of a folder that holds datasets and is none; `None` if there is none in it.
fn several(path: &Path) -> Option<Error> {
    let entries = std::fs::read_dir(path).into_iter().flatten().flatten();
    // A part with a model of its own is no dataset: its photos lie elsewhere.
    let part = |name: &std::ffi::OsStr| PARTS.iter().any(|part| name == *part);
    let whole = entries.filter(|entry| !part(&entry.file_name()));
    let folders = whole.map(|entry| entry.path()).filter(|p| p.is_dir());
    let mut inside: Vec<_> = folders.filter(|folder| is_dataset(folder)).collect();
    inside.sort();
    let first = inside.first()?;
    let names = inside.iter().filter_map(|p| p.file_name()).take(NAMED);
    let mut names: Vec<_> = names.map(|n| n.to_string_lossy().into_owned()).collect();
    if inside.len() > NAMED {
        names.push("...".into());
    }
    let what = match inside.len() {
        1 => format!("no dataset itself, but {} in it is one", names.join("")),
        n => format!(
            "no dataset itself; {n} folders in it are: {}",
            names.join(", ")
        ),
    };
    let fix = format!("{ONE_OF_THEM}, like {}", first.display());
    Some(Error::input(path, what, fix))
}

/// The refusal of a path that is no dataset, with the way on.
fn no_dataset(path: &Path) -> Error {
    let part = |above: &&Path| {
        let first = path.strip_prefix(above).ok();
        let first = first.and_then(|below| below.components().next());
        let first = first.and_then(|name| name.as_os_str().to_str());
        first.is_some_and(|name| PARTS.contains(&name)) && is_dataset(above)
    };
    let above = path.ancestors().skip(1).take(3).find(part);
    let ending = path.extension().and_then(|e| e.to_str()).unwrap_or("");
    if path.is_file() {
        return match ending.to_ascii_lowercase().as_str() {
            "tar" | "gz" | "tgz" | "bz2" | "xz" | "zst" | "7z" | "rar" => Error::input(
                path,
                "an archive of a kind that is not read",
                "unpack it and give the folder, or pack it as a zip archive",
            ),
            _ => Error::input(
                path,
                "a file; a folder or a zip archive expected",
                "give the folder that holds it",
            ),
        };
    }
    if !path.exists() {
        return Error::input(
            path,
            "no such folder or zip archive",
            "check that the path is right",
        );
    }
    if let Some(error) = several(path) {
        return error;
    }
    if let Some(above) = above {
        let above = match above.as_os_str().is_empty() {
            true => Path::new("."),
            false => above,
        };
        let fix = format!("give the whole dataset: {}", above.display());
        return Error::input(path, "a part of a dataset", fix);
    }
    let photos = [path.to_path_buf(), path.join("images")]
        .iter()
        .any(|folder| colmap::photos(folder) > 0);
    if photos {
        return Error::input(
            path,
            "photos, but no camera poses (sparse/0 of COLMAP, transforms.json, or an export of RealityScan, Metashape, Bundler, OpenSfM or OpenMVG)",
            "put the photos into a folder images and run COLMAP in the folder that holds it (README, \"Your own photos\")",
        );
    }
    Error::input(
        path,
        "neither sparse/0/cameras.bin or .txt (COLMAP), nor transforms_train.json or transforms.json, nor an export of RealityScan (CSV), Metashape (XML), Bundler (bundle.out), OpenSfM (reconstruction.json) or OpenMVG (sfm_data.json)",
        "give the folder that holds images/ and sparse/0/, or one of these files",
    )
}
