//! [`Dataset`]: posed photos in a local frame.

use std::path::{Path, PathBuf};

use glam::DVec3;

use crate::base::hash::Fnv;
use crate::capture::camera::Camera;
use crate::capture::digests::Digests;
use crate::capture::frame::Frame;
use crate::capture::lens::Lens;
use crate::capture::photo::Alpha;
use crate::capture::point_cloud::Points;
use crate::capture::source::PhotoSource;
use crate::capture::up::up_axis;

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
    /// CSV with a row for each camera (RealityScan, RealityCapture).
    RealityScan,
    /// XML with sensors and cameras (Metashape).
    Metashape,
    /// `bundle.out` and a list of photos (Bundler).
    Bundler,
    /// `reconstruction.json` (OpenSfM, OpenDroneMap).
    #[serde(rename = "opensfm")]
    OpenSfm,
    /// `sfm_data.json` (OpenMVG).
    #[serde(rename = "openmvg")]
    OpenMvg,
}

impl std::fmt::Display for Layout {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::ColmapBin => "colmap-bin",
            Self::ColmapTxt => "colmap-txt",
            Self::Transforms => "transforms",
            Self::RealityScan => "reality-scan",
            Self::Metashape => "metashape",
            Self::Bundler => "bundler",
            Self::OpenSfm => "opensfm",
            Self::OpenMvg => "openmvg",
        })
    }
}

/// One photo with its camera.
#[derive(Debug, Clone)]
pub struct View {
    /// Name of the image as the dataset gives it (relative path), unique within the dataset; for a side of a panorama with `_front`, `_right`
    /// and so on before the ending.
    pub name: String,
    /// Camera in the dataset's local frame, intrinsics at the photo's (downscaled) resolution.
    pub camera: Camera,
    /// Lens of the photo in its file; its distortion is removed when it is read.
    pub lens: Lens,
    /// The photo, of the camera's width and height.
    pub photo: PhotoSource,
}

/// A set of posed photos in a local frame in which the scene extent is 1.
#[derive(Debug, Clone)]
pub struct Dataset {
    /// The folder it was read from.
    pub path: PathBuf,
    /// The layout found there.
    pub layout: Layout,
    /// Places of its model and its photos, in words.
    pub place: String,
    /// Findings that the user should know about: photos that the model does not have, other models in the folder.
    pub remarks: Vec<String>,
    /// Views to train on, sorted by name.
    pub train: Vec<View>,
    /// Held-out views, sorted by name.
    pub test: Vec<View>,
    /// Sparse points (may be empty).
    pub points: Points,
    /// Number of the points that were found in the photos because there were none; `None` if they have not been looked for. Of a run that goes on
    /// they are not among `points` again.
    pub swept: Option<usize>,
    /// Pose of the local frame in the dataset's own frame.
    pub frame: Frame,
    /// Number of views with lens distortion, whose photos are undistorted when they are read.
    pub undistorted: usize,
    /// Names of views that were left out because their images are missing, sorted.
    pub missing: Vec<String>,
    /// Names of views that were left out as outliers: their cameras are at least 20 times as far from the median as 9 of 10 are.
    pub outliers: Vec<String>,
    /// Names of views that were left out because their masks are 0 everywhere: training views, then held-out ones. Their
    /// cameras count for the frame.
    pub masked_out: Vec<String>,
    /// Bytes that photos decoded on demand may take on the device at one time; no limit to those in memory.
    pub image_budget: u64,
    /// Digests of the files that it was read from; `None` unless they were asked for.
    pub digests: Option<Digests>,
}

/// Parts of a dataset that its [`Dataset::fingerprint`] is of, in words.
pub(crate) const FINGERPRINTED: &str = "names, sizes, cameras, lenses, masks or split";

/// Length of the mean of the cameras' unit vectors upwards from which on there is such a thing as up.
const SHARED_UP: f64 = 0.3;

impl Dataset {
    /// Training views, then held-out ones.
    pub fn views(&self) -> impl Iterator<Item = &View> {
        self.train.iter().chain(&self.test)
    }

    /// Number of points that training begins or began with: sparse ones, or those that were found.
    #[must_use]
    pub fn point_count(&self) -> usize {
        self.swept.unwrap_or(self.points.positions.len())
    }

    /// The dataset as a run had it that has begun: points that were found are known by their number, and none that it did not have.
    #[must_use]
    pub fn as_begun(mut self, swept: Option<usize>) -> Self {
        if self.swept.is_some() {
            self.points = Points::default();
        }
        self.swept = swept;
        self
    }

    /// True if points were found, and only their number is known.
    #[must_use]
    pub fn forgot_points(&self) -> bool {
        self.swept.is_some_and(|found| found > 0) && self.points.positions.is_empty()
    }

    /// Direction that is up ([`up_axis`]); `None` if the cameras' upper edges agree on none.
    #[must_use]
    pub fn up(&self) -> Option<DVec3> {
        let cameras = || self.views().map(|view| &view.camera);
        let edges = cameras().map(|camera| -camera.rotation.row(1));
        let mean = edges.sum::<DVec3>() / cameras().count().max(1) as f64;
        (mean.length() > SHARED_UP).then(|| up_axis(cameras()))
    }

    /// Fingerprint of 16 hexadecimal digits that tells datasets, splits and resolutions apart: from layout, names, sizes, cameras
    /// and lenses of the views, their masks and their split, not from the photos' colours.
    #[must_use]
    pub fn fingerprint(&self) -> String {
        let mut hash = Fnv::default();
        let mut take = |bytes: &[u8]| hash.bytes(bytes);
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
        format!("{:016x}", hash.0)
    }

    /// Fingerprint of 16 hexadecimal digits that tells captures apart, whatever the photos' size and the split: from names and
    /// directions of the views.
    #[must_use]
    pub fn capture_fingerprint(&self) -> String {
        let mut views: Vec<&View> = self.views().collect();
        views.sort_by(|a, b| a.name.cmp(&b.name));
        let mut hash = Fnv::default();
        for view in views {
            hash.bytes(view.name.as_bytes());
            // No positions: the frame that they are in is a mean over the views, whose last digit depends on their order.
            for v in view.camera.rotation.to_cols_array() {
                hash.bytes(&v.to_le_bytes());
            }
        }
        format!("{:016x}", hash.0)
    }

    /// The message if the [`Dataset::fingerprint`] in a run's folder is another one.
    pub(crate) fn not_that_of(&self, run: &Path) -> String {
        let run = run.display();
        format!(
            "its views are not those of {run}: {FINGERPRINTED} differ (or an earlier version began it)"
        )
    }

    /// Meaning of the photos' alpha planes, the same for all of them.
    #[must_use]
    pub fn alpha(&self) -> Alpha {
        Alpha::common(self.views().map(|v| v.photo.alpha()))
    }

    /// Bytes of all photos, decoded.
    #[must_use]
    pub fn photo_bytes(&self) -> u64 {
        self.views().map(|view| view.photo.bytes()).sum()
    }

    /// True if photos are decoded on demand, because not all fit into the budget at one time, or were not needed.
    #[must_use]
    pub fn photos_on_demand(&self) -> bool {
        let on_demand = |view: &View| matches!(view.photo, PhotoSource::File(_));
        self.views().any(on_demand)
    }
}

/// Photos that are needed of a dataset. Others are not decoded before they are asked for, so that broken ones are not told; but where any are needed, those
/// that may have an alpha plane are decoded, too: it decides what the photos are to have, and which are masked out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Needed {
    /// All of them.
    All,
    /// Held-out ones, and those to train on where none is held out.
    HeldOut,
    /// Those to train on.
    Training,
    /// None, whatever their alpha: photos that are masked out are not known to be.
    None,
}

/// Options of [`crate::capture::load`].
#[derive(Debug, Clone)]
pub struct LoadOptions {
    /// Folder of the photos, in the dataset or elsewhere; `None`: where the dataset says, else found by their file names.
    pub images: Option<PathBuf>,
    /// Photos are shrunk to this length of their longest side, pixels, ≥ 1; never enlarged.
    pub max_size: u32,
    /// Every n-th image by name is held out, the first one included (0: none). A `transforms_test.json` takes precedence.
    pub test_every: u32,
    /// Bytes that all photos together may take; if they take more, they are decoded on demand. `None`: half of the available
    /// memory, over `keepers`.
    pub image_budget: Option<u64>,
    /// Number of processes, or devices of this process, that keep the photos in the memory of this host, ≥ 1.
    pub keepers: usize,
    /// True if the photos' alpha is a mask and not transparency. With mask files it always is.
    pub alpha_is_mask: bool,
    /// True if masks are 0 where a photo counts: of files, and of alpha that is a mask.
    pub invert_masks: bool,
    /// Photos that are needed.
    pub photos: Needed,
    /// True if the files of photos and masks are to be read as a whole for [`Dataset::digests`].
    pub digests: bool,
    /// Called whenever a photo has been read, from any thread, with how many have been and how many there are.
    pub progress: Option<fn(usize, usize)>,
}

impl Default for LoadOptions {
    fn default() -> Self {
        Self {
            images: None,
            max_size: 1600,
            test_every: 8,
            image_budget: None,
            keepers: 1,
            alpha_is_mask: false,
            invert_masks: false,
            photos: Needed::All,
            digests: false,
            progress: None,
        }
    }
}
