//! Seeded scenes with known truth: exact cameras, points on the true surfaces, photos from a small ray tracer of our own
//! (64-bit floats, shading after Lambert, Blinn and Schlick; no code or asset of others).
//!
//! The same arguments give the same bytes. Geometry and shading use + − × ÷ and √ alone, which IEEE 754 defines to the last
//! bit, so this holds across machines too.

mod furniture;
mod hash;
mod object;
mod picture;
mod room;
mod scene;
mod shape;
mod texture;
mod trace;
mod tree;
mod write;

use std::fs;
use std::path::Path;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::base::error::{Error, Result};
use crate::capture::colmap::{write_bin, write_txt};
use crate::capture::transforms::write_transforms;
use crate::capture::{Camera, Frame, point_cloud};
use crate::lab::synth::scene::Scene;

/// Names of the scenes that [`generate`] knows.
pub const NAMES: [&str; 2] = ["room", "object"];

/// Middle and radius of the chrome sphere of `object`, scene units: the part whose colour depends on the view most.
pub const CHROME_SPHERE: ([f64; 3], f64) = ([-0.36, -0.42, 0.30], 0.30);

/// In which layout [`generate`] writes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum SynthLayout {
    /// images/ and sparse/0/*.bin (PINHOLE).
    Colmap,
    /// images/ and sparse/0/*.txt (PINHOLE).
    ColmapTxt,
    /// transforms_train.json, transforms_test.json with every eighth view, and points3d.ply.
    Transforms,
}

impl FromStr for SynthLayout {
    type Err = Error;

    /// Reads `colmap`, `colmap-txt` or `transforms`.
    ///
    /// # Errors
    /// [`Error::Config`] for any other text.
    fn from_str(s: &str) -> Result<Self> {
        match s {
            "colmap" => Ok(Self::Colmap),
            "colmap-txt" => Ok(Self::ColmapTxt),
            "transforms" => Ok(Self::Transforms),
            _ => Err(Error::config(
                "layout",
                format!("`{s}` is none of colmap, colmap-txt, transforms"),
            )),
        }
    }
}

/// What to write. [`SynthOptions::for_scene`] gives the usual values of a scene.
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
    /// Seed of textures, ornaments, sub-pixel places and points. Cameras and the larger things stay where they are.
    pub seed: u64,
    /// Rays per pixel, rounded up to a square number; 1 to 1024.
    pub samples: u32,
}

impl Default for SynthOptions {
    /// The usual values of `room`.
    fn default() -> Self {
        Self {
            layout: SynthLayout::Colmap,
            views: 64,
            width: 480,
            height: 360,
            points: 10_000,
            seed: 0,
            samples: 16,
        }
    }
}

impl SynthOptions {
    /// The usual values of a scene: `object` is square and in the transforms layout, all else as [`Default`] has it.
    #[must_use]
    pub fn for_scene(name: &str) -> Self {
        let room = Self::default();
        if name == "object" {
            return Self {
                layout: SynthLayout::Transforms,
                width: 400,
                height: 400,
                ..room
            };
        }
        room
    }

    /// Checks every value against its domain.
    ///
    /// # Errors
    /// [`Error::Config`] that names the option, what was found and what is allowed.
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

/// What [`generate`] wrote.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct SynthReport {
    /// Name of the scene.
    pub name: String,
    /// The options it was made with.
    #[serde(flatten)]
    pub options: SynthOptions,
    /// Photos to train on.
    pub train_views: u32,
    /// Photos held out: every eighth, as [`crate::capture`] splits COLMAP sets by default.
    pub test_views: u32,
    /// Sparse points written: fewer than asked for only if most pixels see nothing.
    pub points_written: u32,
}

/// Every how many photos one is held out.
const TEST_EVERY: usize = 8;

/// Writes the scene `name` (one of [`NAMES`]) into the folder `dir`.
///
/// Cameras look at +z in COLMAP's axes; scene units are metres for `room`, and the plate's radius for `object`.
///
/// # Errors
/// [`Error::Config`] for an unknown name or an option outside of its domain, [`Error::Input`] if `dir` exists and is not an empty
/// folder, [`Error::Io`] if the system refuses to write.
pub fn generate(name: &str, dir: &Path, options: &SynthOptions) -> Result<SynthReport> {
    options.validate()?;
    let (scene, cameras) = build(name, options)?;
    refuse_occupied(dir)?;
    let alpha = scene.studio;
    let views: Vec<(String, Camera)> = cameras
        .iter()
        .enumerate()
        .map(|(i, camera)| (photo_name(options.layout, i), *camera))
        .collect();
    let grid = (1..=32).find(|g| g * g >= options.samples).unwrap_or(32);
    for (i, (file, camera)) in views.iter().enumerate() {
        let pixels = trace::photo(&scene, camera, [options.seed, i as u64], grid, alpha);
        write::png(
            &dir.join(file),
            &pixels,
            options.width,
            options.height,
            alpha,
        )?;
    }
    let points = trace::points(&scene, &cameras, options.points, options.seed);
    match options.layout {
        SynthLayout::Transforms => {
            for (split, test) in [("train", false), ("test", true)] {
                let part: Vec<(String, Camera)> = views
                    .iter()
                    .enumerate()
                    .filter(|(i, _)| (i % TEST_EVERY == 0) == test)
                    .map(|(_, v)| v.clone())
                    .collect();
                let file = dir.join(format!("transforms_{split}.json"));
                write_transforms(&file, &part, Some("points3d.ply"))?;
            }
            point_cloud::write(
                &dir.join("points3d.ply"),
                &write::cloud(&points),
                &Frame::IDENTITY,
            )?;
        }
        layout => {
            let folder = dir.join("sparse/0");
            fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, e))?;
            let model = write::colmap_model(&bare(&views), &points);
            if layout == SynthLayout::ColmapTxt {
                write_txt(&folder, &model)?;
            } else {
                write_bin(&folder, &model)?;
            }
        }
    }
    let test_views = views.len().div_ceil(TEST_EVERY) as u32;
    Ok(SynthReport {
        name: name.to_owned(),
        options: options.clone(),
        train_views: options.views - test_views,
        test_views,
        points_written: points.len() as u32,
    })
}

/// The scene and its cameras.
fn build(name: &str, options: &SynthOptions) -> Result<(Scene, Vec<Camera>)> {
    type Place = fn(u32, u32) -> (glam::DVec3, glam::DVec3);
    // The last number is the tangent of half the horizontal field of view: 72° and 34°.
    let (scene, place, tan): (Scene, Place, f64) = match name {
        "room" => (room::scene(options.seed), room::camera, 0.72),
        "object" => (object::scene(options.seed), object::camera, 0.305),
        _ => {
            return Err(Error::config(
                "name",
                format!("no scene `{name}`; there are {}", NAMES.join(", ")),
            ));
        }
    };
    let cameras = (0..options.views)
        .map(|i| {
            let (at, target) = place(i, options.views);
            trace::look_at(at, target, options.width, options.height, tan)
        })
        .collect();
    Ok((scene, cameras))
}

/// Path of photo `i` below the dataset's folder.
fn photo_name(layout: SynthLayout, i: usize) -> String {
    match layout {
        SynthLayout::Transforms if i.is_multiple_of(TEST_EVERY) => format!("test/r_{i:04}.png"),
        SynthLayout::Transforms => format!("train/r_{i:04}.png"),
        _ => format!("images/view_{i:04}.png"),
    }
}

/// Views by the name COLMAP knows them: the path below `images/`.
fn bare(views: &[(String, Camera)]) -> Vec<(String, Camera)> {
    let strip = |name: &str| name.trim_start_matches("images/").to_owned();
    views
        .iter()
        .map(|(name, camera)| (strip(name), *camera))
        .collect()
}

/// Nothing is ever overwritten: the folder must be new or empty.
fn refuse_occupied(dir: &Path) -> Result<()> {
    let occupied = match fs::read_dir(dir) {
        Ok(mut entries) => entries.next().is_some(),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => false,
        Err(e) if e.kind() == std::io::ErrorKind::NotADirectory => true,
        Err(e) => return Err(Error::io(dir, e)),
    };
    if occupied {
        return Err(Error::input(
            dir,
            "exists and is not an empty folder; a scene needs one of its own",
            "name a new folder or remove this one",
        ));
    }
    Ok(())
}
