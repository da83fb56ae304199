//! Posed photos: files → [`Dataset`] of [`View`]s in a local frame.

pub mod camera;
pub mod colmap;
pub mod frame;
mod load;
pub mod photo;
pub mod synthetic;
pub mod transforms;

pub use camera::Camera;
pub use frame::Frame;
pub use load::{LoadOptions, load};
pub use photo::Photo;

use std::path::PathBuf;

/// Layout the dataset was read from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Layout {
    /// `images/` + `sparse/0/*.bin`.
    ColmapBin,
    /// `images/` + `sparse/0/*.txt`.
    ColmapTxt,
    /// `transforms*.json` (Blender, nerfstudio).
    Transforms,
}

impl std::fmt::Display for Layout {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::ColmapBin => "colmap-bin",
            Self::ColmapTxt => "colmap-txt",
            Self::Transforms => "transforms",
        })
    }
}

/// One photo with its camera.
#[derive(Debug, Clone)]
pub struct View {
    /// Name of the image as the dataset gives it (relative path), unique within the dataset.
    pub name: String,
    /// Camera in the dataset's local frame, intrinsics at the photo's (downscaled) resolution.
    pub camera: Camera,
    /// The photo.
    pub photo: Photo,
}

/// Sparse points in the local frame.
#[derive(Debug, Clone, Default)]
pub struct Points {
    /// Positions, local units.
    pub positions: Vec<[f32; 3]>,
    /// 8-bit RGB colours, one per position.
    pub colors: Vec<[u8; 3]>,
}

/// A set of posed photos in a local frame in which the scene extent is 1.
#[derive(Debug, Clone)]
pub struct Dataset {
    /// The folder it was read from.
    pub path: PathBuf,
    /// The layout found there.
    pub layout: Layout,
    /// Views to train on, sorted by name.
    pub train: Vec<View>,
    /// Held-out views, sorted by name.
    pub test: Vec<View>,
    /// Sparse points (may be empty).
    pub points: Points,
    /// Where the local frame lies in the dataset's own frame.
    pub frame: Frame,
}
