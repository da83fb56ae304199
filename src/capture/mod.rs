//! Posed photos: files → [`Dataset`] of [`View`]s in a local frame.

mod archive;
mod assemble;
pub mod camera;
pub mod cells;
pub mod colmap;
mod dataset;
mod digests;
mod endings;
mod exports;
pub mod frame;
mod images;
mod layouts;
pub mod lens;
mod memory;
pub mod panorama;
pub mod photo;
pub mod point_cloud;
mod rows;
pub mod source;
pub mod split;
pub mod transforms;
mod up;

pub use crate::capture::archive::{Temporary, is_archive, remove_temporary};
pub use crate::capture::camera::Camera;
pub(crate) use crate::capture::dataset::FINGERPRINTED;
pub use crate::capture::dataset::{Dataset, Layout, LoadOptions, Needed, View};
pub use crate::capture::digests::Digests;
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
use crate::capture::layouts::is_dataset;

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

fn load_folder(path: &Path, options: &LoadOptions) -> Result<Dataset> {
    let scene = layouts::read(path, options.images.as_deref())?;
    assemble::assemble(path, scene, options)
}
