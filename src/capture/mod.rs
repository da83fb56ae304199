//! Posed photos: files → [`Dataset`] of [`View`]s in a local frame.

mod assemble;
pub mod camera;
pub mod colmap;
mod dataset;
pub mod frame;
pub mod lens;
pub mod photo;
pub mod point_cloud;
pub mod source;
pub mod transforms;

pub use crate::capture::camera::Camera;
pub use crate::capture::dataset::{Dataset, Layout, LoadOptions, View};
pub use crate::capture::frame::Frame;
pub use crate::capture::lens::{Lens, Undistortion};
#[doc(hidden)]
pub use crate::capture::photo::shrink;
pub use crate::capture::photo::{Alpha, Photo};
pub use crate::capture::point_cloud::Points;
pub use crate::capture::source::{PhotoFile, PhotoSource};

use std::path::Path;

use crate::base::error::{Error, Result};

/// Reads a dataset folder: COLMAP (`images/` and `sparse/0/`, binary preferred over text) or `transforms_train.json` /
/// `transforms.json`.
///
/// Names are sorted bytewise before the split. Everything is computed in f64 and moved to the local frame before it is
/// rounded to f32, so that far-off frames (UTM) lose nothing.
///
/// # Errors
/// [`Error::Input`] for a folder of neither layout, anything unreadable, missing, non-finite or inconsistent in it, a lens of
/// an unknown model or one that cannot be inverted, and a split that leaves no training view; [`Error::Config`] for `max_size` 0 and for an `image_budget` that is
/// too small for one photo; [`Error::Io`].
pub fn load(path: &Path, options: &LoadOptions) -> Result<Dataset> {
    if options.max_size == 0 {
        return Err(Error::config("max-size", "0; at least 1 pixel expected"));
    }
    let scene = if let Some((dir, layout)) = colmap::find(path) {
        colmap::load(path, &dir, layout)?
    } else if let Some(file) = transforms::find(path) {
        transforms::load(path, &file)?
    } else {
        let found = if path.is_dir() {
            "neither sparse/0/cameras.bin or .txt (COLMAP) nor transforms_train.json or transforms.json"
        } else {
            "no such folder"
        };
        return Err(Error::input(
            path,
            found,
            "give the folder that holds images/ and sparse/0/, or a transforms file",
        ));
    };
    assemble::assemble(path, scene, options)
}
