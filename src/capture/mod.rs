//! Posed photos: files → [`Dataset`] of [`View`]s in a local frame.

mod assemble;
pub mod camera;
pub mod colmap;
mod decode;
pub mod frame;
pub mod lens;
pub mod photo;
pub mod point_cloud;
pub mod source;
pub mod transforms;

pub use crate::capture::camera::Camera;
#[doc(hidden)]
pub use crate::capture::decode::shrink;
pub use crate::capture::frame::Frame;
pub use crate::capture::lens::{Lens, Undistortion};
pub use crate::capture::photo::{Alpha, Photo};
pub use crate::capture::source::{PhotoFile, PhotoSource};

use std::path::{Path, PathBuf};

use crate::base::error::{Error, Result};

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
    /// What the lens did to the photo as it is in its file; undone when it is read.
    pub lens: Lens,
    /// The photo, of the camera's width and height.
    pub photo: PhotoSource,
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
    /// Views whose lens moved the photo's pixels, so that it is undistorted when it is read.
    pub undistorted: usize,
    /// Names of views that were left out because their images are missing, sorted.
    pub missing: Vec<String>,
    /// Names of views that were left out because their cameras are far from all others, at least 20 times as far as 9 of 10 are.
    pub astray: Vec<String>,
    /// Names of views that were left out because their masks leave no pixel of them: training views, then held-out ones.
    /// Their cameras count for the frame.
    pub masked_out: Vec<String>,
    /// Bytes that photos left in their files may take on the device at one time; those in memory are uploaded whatever it is.
    pub image_budget: u64,
}

impl Dataset {
    /// Tells datasets, splits and resolutions apart: 16 hexadecimal digits from layout, names, sizes, cameras and lenses of the
    /// views, their masks and their split, not from the photos' colours.
    #[must_use]
    pub fn fingerprint(&self) -> String {
        // FNV-1a, 64 bits.
        let mut hash = 0xcbf2_9ce4_8422_2325_u64;
        let mut take = |bytes: &[u8]| {
            for byte in bytes {
                hash = (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
            }
        };
        take(self.layout.to_string().as_bytes());
        for (part, views) in [(&b"train"[..], &self.train), (b"test", &self.test)] {
            take(part);
            for view in views {
                take(view.name.as_bytes());
                let c = &view.camera;
                take(&c.width.to_le_bytes());
                take(&c.height.to_le_bytes());
                if let Some(mask) = view.photo.mask_digest() {
                    take(b"mask");
                    take(&mask.to_le_bytes());
                }
                if view.lens != Lens::Pinhole {
                    take(format!("{:?}", view.lens).as_bytes());
                }
                let pose = c.rotation.to_cols_array().into_iter();
                let lens = [c.fx, c.fy, c.cx, c.cy];
                for v in pose.chain(c.translation.to_array()).chain(lens) {
                    take(&v.to_le_bytes());
                }
            }
        }
        format!("{hash:016x}")
    }

    /// What to say where this is not the dataset that a run has by its [`Dataset::fingerprint`].
    pub(crate) fn not_that_of(&self, run: &Path) -> String {
        let run = run.display();
        format!(
            "its views are not those of {run}: names, sizes, cameras, lenses, masks or split differ (or an earlier version began it)"
        )
    }

    /// What the photos' alpha says: the same for all of them.
    #[must_use]
    pub fn alpha(&self) -> Alpha {
        let mut views = self.train.iter().chain(&self.test);
        let found = views.find_map(|v| Some(v.photo.alpha()).filter(|a| *a != Alpha::None));
        found.unwrap_or_default()
    }

    /// Whether photos are transparent, so that what lies behind the scene matters.
    #[must_use]
    pub fn background_matters(&self) -> bool {
        self.alpha() == Alpha::Transparency
    }

    /// Bytes of all photos, decoded.
    #[must_use]
    pub fn photo_bytes(&self) -> u64 {
        let views = self.train.iter().chain(&self.test);
        views.map(|view| view.photo.bytes()).sum()
    }

    /// Whether photos stay in their files until they are needed, because not all fit into the budget at one time.
    #[must_use]
    pub fn photos_on_demand(&self) -> bool {
        let mut views = self.train.iter().chain(&self.test);
        views.any(|view| matches!(view.photo, PhotoSource::File(_)))
    }
}

/// How [`load`] reads a dataset.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LoadOptions {
    /// Photos are shrunk to this length of their longest side, pixels, ≥ 1; never enlarged.
    pub max_size: u32,
    /// Every n-th image by name is held out, the first one included (0: none). A `transforms_test.json` wins over this.
    pub test_every: u32,
    /// Bytes that all photos together may take: more than that stays in the files and is decoded on demand. None: half of
    /// the memory that is available.
    pub image_budget: Option<u64>,
    /// Whether the photos' alpha is a mask and not transparency. With mask files it is in any case.
    pub alpha_is_mask: bool,
}

impl Default for LoadOptions {
    fn default() -> Self {
        Self {
            max_size: 1600,
            test_every: 8,
            image_budget: None,
            alpha_is_mask: false,
        }
    }
}

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
