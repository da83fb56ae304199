//! A synthetic dataset on disk.

use std::fs;
use std::path::Path;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use serde::{Deserialize, Serialize};

use crate::base::error::{Error, Result};
use crate::capture::colmap::{ColmapModel, ColmapPoint};
use crate::capture::transforms::write_transforms;
use crate::capture::{Camera, Frame, Points, point_cloud};
use crate::lab::folder::check_folder;
use crate::lab::synth::render;
use crate::lab::synth::scenes::{NAMES, named};

/// Number of photos from one held-out photo to the next.
const TEST_EVERY: usize = 8;

/// Layout of the files of a dataset.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum SynthLayout {
    /// images/ and sparse/0/*.bin
    Colmap,
    /// images/ and sparse/0/*.txt
    ColmapTxt,
    /// transforms_train.json, transforms_test.json with every eighth view, and points3d.ply
    Transforms,
}

/// Options of [`generate`]. [`SynthOptions::for_scene`] gives the defaults of a scene.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SynthOptions {
    /// Layout of the files.
    pub layout: SynthLayout,
    /// Number of photos, held-out ones included; 2 to 9999.
    pub views: u32,
    /// Width of the photos, pixels; 8 to 8192.
    pub width: u32,
    /// Height of the photos, pixels; 8 to 8192.
    pub height: u32,
    /// Number of sparse points; at most 10 million.
    pub points: u32,
    /// Seed of textures, sub-pixel positions and points. Cameras and solids do not depend on it.
    pub seed: u64,
    /// Rays per pixel, rounded up to a square number; 1 to 1024.
    pub samples: u32,
}

impl SynthOptions {
    /// The defaults of a scene: `object` is square and in the transforms layout.
    #[must_use]
    pub fn for_scene(name: &str) -> Self {
        let (layout, width, height) = match name {
            "object" => (SynthLayout::Transforms, 400, 400),
            _ => (SynthLayout::Colmap, 480, 360),
        };
        Self {
            layout,
            views: 64,
            width,
            height,
            points: 10_000,
            seed: 0,
            samples: 16,
        }
    }

    /// Checks every value against its domain.
    ///
    /// # Errors
    /// [`Error::Config`] that names the option, the value and the domain.
    pub fn validate(&self) -> Result<()> {
        let domains = [
            ("views", self.views, 2, 9999),
            ("width", self.width, 8, 8192),
            ("height", self.height, 8, 8192),
            ("points", self.points, 0, 10_000_000),
            ("samples", self.samples, 1, 1024),
        ];
        for (option, value, low, high) in domains {
            if value < low || value > high {
                return Err(Error::config(
                    option,
                    format!("{value} is not within {low} to {high}"),
                ));
            }
        }
        Ok(())
    }
}

/// Summary of a dataset that [`generate`] wrote.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct SynthReport {
    /// Name of the scene.
    pub name: String,
    /// Options that it was made with.
    #[serde(flatten)]
    pub options: SynthOptions,
    /// Number of photos to train on.
    pub train_views: u32,
    /// Number of held-out photos: every eighth, the default split of [`crate::capture`] for COLMAP sets.
    pub test_views: u32,
    /// Number of sparse points written: fewer than asked for only if most pixels see nothing.
    pub points_written: u32,
}

/// Writes the scene `name` (one of [`NAMES`]) into the folder `dir`.
///
/// Cameras look at +z in COLMAP's axes; scene units are metres for `room`, and half of the plate's side for `object`.
///
/// # Errors
/// [`Error::Config`] for an unknown name or an option outside of its domain, [`Error::Input`] if `dir` exists and is not an empty
/// folder, [`Error::Io`] if the system refuses to write.
pub fn generate(name: &str, dir: &Path, options: &SynthOptions) -> Result<SynthReport> {
    options.validate()?;
    let scene = named(name, options.seed).ok_or_else(|| {
        let known = NAMES.join(", ");
        Error::config("name", format!("no scene `{name}`; there are {known}"))
    })?;
    check_folder(dir)?;
    let size = [options.width, options.height];
    let grid = (1..=32).find(|g| g * g >= options.samples).unwrap_or(32);
    // COLMAP knows photos by their paths below images/.
    let (photos, transforms) = match options.layout {
        SynthLayout::Transforms => (dir.to_path_buf(), true),
        _ => (dir.join("images"), false),
    };
    let mut views = Vec::with_capacity(options.views as usize);
    for i in 0..options.views as usize {
        let (at, target) = (scene.camera)(i as u32, options.views);
        let camera = render::look_at(at, target, size, scene.tan);
        let file = match (transforms, i.is_multiple_of(TEST_EVERY)) {
            (true, true) => format!("test/r_{i:04}.png"),
            (true, false) => format!("train/r_{i:04}.png"),
            (false, _) => format!("view_{i:04}.png"),
        };
        let pixels = render::photo(&scene, &camera, i as u64, grid);
        png(&photos.join(&file), &pixels, size, scene.transparent)?;
        views.push((file, camera));
    }
    let points = render::points(&scene, &views, options.points);
    let points_written = points.len() as u32;
    match transforms {
        true => write_blender(dir, &views, &points)?,
        false => write_colmap(dir, options.layout, &views, points)?,
    }
    let test_views = views.len().div_ceil(TEST_EVERY) as u32;
    Ok(SynthReport {
        name: name.to_owned(),
        options: options.clone(),
        train_views: options.views - test_views,
        test_views,
        points_written,
    })
}

/// Writes rows of RGB (or RGBA) bytes as a PNG, folders included, with fixed settings so that the same pixels give the same
/// file.
fn png(path: &Path, pixels: &[u8], [width, height]: [u32; 2], alpha: bool) -> Result<()> {
    let color = match alpha {
        true => ExtendedColorType::Rgba8,
        false => ExtendedColorType::Rgb8,
    };
    let mut bytes = Vec::new();
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Best, FilterType::Adaptive)
        .write_image(pixels, width, height, color)
        .map_err(|e| Error::io(path, std::io::Error::other(e)))?;
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(|e| Error::io(folder, e))?;
    }
    fs::write(path, bytes).map_err(|e| Error::io(path, e))
}

/// Writes `sparse/0`, as text or binary.
fn write_colmap(
    dir: &Path,
    layout: SynthLayout,
    views: &[(String, Camera)],
    points: Vec<ColmapPoint>,
) -> Result<()> {
    let folder = dir.join("sparse/0");
    fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, e))?;
    let model = ColmapModel::from_views(views, points);
    model.write(&folder, layout != SynthLayout::ColmapTxt)
}

/// Writes `transforms_train.json`, `transforms_test.json` and `points3d.ply`.
fn write_blender(dir: &Path, views: &[(String, Camera)], points: &[ColmapPoint]) -> Result<()> {
    let (test, train): (Vec<_>, Vec<_>) = views
        .iter()
        .cloned()
        .partition(|(name, _)| name.starts_with("test/"));
    for (split, part) in [("train", train), ("test", test)] {
        let file = dir.join(format!("transforms_{split}.json"));
        write_transforms(&file, &part, Some("points3d.ply"))?;
    }
    let cloud = Points {
        positions: points
            .iter()
            .map(|p| p.position.map(|v| v as f32))
            .collect(),
        colors: points.iter().map(|p| p.color).collect(),
    };
    point_cloud::write(&dir.join("points3d.ply"), &cloud, &Frame::IDENTITY)
}
