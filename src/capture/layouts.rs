//! Readers of dataset folders by the layout that is found, and the refusal of folders of none.

use std::path::Path;

use crate::base::error::{Error, Result};
use crate::capture::archive::ONE_OF_THEM;
use crate::capture::assemble::RawScene;
use crate::capture::{colmap, exports, images, transforms};

/// True for a folder that holds cameras in a layout that is read.
pub(super) fn is_dataset(folder: &Path) -> bool {
    let known = colmap::find(folder, None).is_some() || transforms::find(folder).is_some();
    known || !exports::find(folder).is_empty()
}

/// Reads the views and points of a folder, whose photos lie where `asked` says, else where the folder does.
///
/// # Errors
/// A folder of no layout that is known, and those of the layout's reader.
pub(super) fn read(path: &Path, asked: Option<&Path>) -> Result<RawScene> {
    let folder = match path.is_dir() {
        true => images::asked_folder(path, asked)?,
        false => None,
    };
    let model = colmap::find(path, folder.as_deref());
    match (model, transforms::find(path)) {
        (Some((place, remarks)), file) if place.usual || file.is_none() => {
            colmap::load(path, &place, remarks, asked)
        }
        (_, Some(file)) => transforms::load(path, &file, asked),
        _ => match &exports::find(path)[..] {
            [] => Err(no_dataset(path)),
            found => exports::load(path, found, asked),
        },
    }
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
