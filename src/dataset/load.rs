//! Folder → [`Dataset`]: detects the layout, decodes the photos, splits, and moves everything into the local frame.

use std::path::{Path, PathBuf};

use glam::DVec3;
use rayon::prelude::*;

use super::transforms::{self, Transforms};
use super::{Camera, Dataset, Frame, Layout, Photo, Points, View, colmap};
use crate::error::{Error, Result};
use crate::export::ply;

/// How a dataset is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LoadOptions {
    /// Longest image side, pixels.
    pub max_size: u32,
    /// Every n-th image by name is held out, unless the dataset has a test split of its own; 0: none.
    pub test_every: u32,
}

impl Default for LoadOptions {
    fn default() -> Self {
        Self {
            max_size: 1600,
            test_every: 8,
        }
    }
}

/// Aspect ratios that differ by more than this are not the same picture.
const ASPECT_TOLERANCE: f64 = 0.01;

/// A view before its photo is decoded. The camera is in world units, at the size its model states.
struct Listed {
    name: String,
    file: PathBuf,
    /// Camera as a function of the image file's size.
    camera: Box<dyn Fn([u32; 2]) -> Result<Camera> + Send + Sync>,
    test: Option<bool>,
}

struct Listing {
    layout: Layout,
    views: Vec<Listed>,
    points: Vec<(DVec3, [u8; 3])>,
}

/// Reads a dataset.
///
/// # Errors
/// A folder of no known layout, or any file in it that is missing, damaged or not supported.
pub fn load(path: &Path, options: &LoadOptions) -> Result<Dataset> {
    let sparse = path.join("sparse").join("0");
    let train = path.join("transforms_train.json");
    let single = path.join("transforms.json");
    let mut listing = if let Some((_, layout)) = colmap::find(&sparse) {
        list_colmap(path, &sparse, layout)?
    } else if train.is_file() {
        list_transforms(path, &train, Some(&path.join("transforms_test.json")))?
    } else if single.is_file() {
        list_transforms(path, &single, None)?
    } else {
        let what = if path.is_dir() {
            "is not a dataset"
        } else {
            "is not a folder"
        };
        return Err(Error::input(
            path,
            what,
            "give a folder with images/ and sparse/0/ (COLMAP), or with transforms_train.json or transforms.json",
        ));
    };
    listing.views.sort_by(|a, b| a.name.cmp(&b.name));
    check_files(&listing.views)?;
    let mut views = decode(&listing.views, options.max_size)?;
    let frame = local_frame(&views, &listing.points);
    for v in &mut views {
        let c = &mut v.camera;
        c.translation = (c.translation + c.rotation * frame.center) / frame.scale;
    }
    let (mut train, mut test) = (Vec::new(), Vec::new());
    for (k, (view, listed)) in views.into_iter().zip(&listing.views).enumerate() {
        let by_rule = options.test_every > 0 && (k as u32).is_multiple_of(options.test_every);
        if listed.test.unwrap_or(by_rule) {
            test.push(view)
        } else {
            train.push(view)
        }
    }
    if train.is_empty() {
        return Err(Error::input(
            path,
            format!("no view to train on ({} held out)", test.len()),
            "add images, or hold fewer out with --test-every",
        ));
    }
    let points = Points {
        positions: listing
            .points
            .iter()
            .map(|(p, _)| frame.to_local(*p).as_vec3().to_array())
            .collect(),
        colors: listing.points.iter().map(|(_, c)| *c).collect(),
    };
    Ok(Dataset {
        path: path.to_path_buf(),
        layout: listing.layout,
        train,
        test,
        points,
        frame,
    })
}

fn list_colmap(path: &Path, sparse: &Path, layout: Layout) -> Result<Listing> {
    let model = colmap::read(sparse, layout)?;
    let views = model
        .images
        .iter()
        .map(|image| {
            let camera = model.camera_of(image, sparse)?;
            transforms::inside(path, &image.name)?;
            Ok(Listed {
                name: image.name.clone(),
                file: path.join("images").join(&image.name),
                camera: Box::new(move |_| Ok(camera)),
                test: None,
            })
        })
        .collect::<Result<_>>()?;
    let points = model
        .points
        .iter()
        .map(|p| (DVec3::from_array(p.position), p.color))
        .collect();
    Ok(Listing {
        layout,
        views,
        points,
    })
}

fn list_transforms(path: &Path, train: &Path, test: Option<&Path>) -> Result<Listing> {
    let mut views = Vec::new();
    let mut points = Vec::new();
    let with_test = test.is_some_and(Path::is_file);
    for (file, held_out) in [(Some(train), false), (test.filter(|_| with_test), true)] {
        let Some(file) = file else { continue };
        let all = transforms::read(file)?;
        if let Some(ply_path) = all.ply_file_path.as_ref().filter(|_| !held_out) {
            transforms::inside(path, ply_path)?;
            let read = ply::read_points(&path.join(ply_path), &Frame::IDENTITY)?;
            points = read
                .positions
                .iter()
                .zip(&read.colors)
                .map(|(p, c)| (DVec3::from_array(p.map(f64::from)), *c))
                .collect();
        }
        list_frames(path, file, &all, with_test.then_some(held_out), &mut views)?;
    }
    Ok(Listing {
        layout: Layout::Transforms,
        views,
        points,
    })
}

fn list_frames(
    folder: &Path,
    file: &Path,
    all: &Transforms,
    test: Option<bool>,
    views: &mut Vec<Listed>,
) -> Result<()> {
    // The frames are cut off the copy that each camera closure keeps: it needs the shared intrinsics alone.
    let shared = Transforms {
        frames: Vec::new(),
        ..all.clone()
    };
    for frame in &all.frames {
        let (shared, own, json) = (shared.clone(), frame.clone(), file.to_path_buf());
        views.push(Listed {
            name: frame.file_path.trim_start_matches("./").to_owned(),
            file: all.image_file(frame, folder)?,
            camera: Box::new(move |size| shared.camera_of(&own, size, &json)),
            test,
        });
    }
    Ok(())
}

fn check_files(views: &[Listed]) -> Result<()> {
    let missing: Vec<&Listed> = views.iter().filter(|v| !v.file.is_file()).collect();
    match missing.first() {
        None => Ok(()),
        Some(first) => Err(Error::input(
            &first.file,
            format!(
                "is missing ({} of {} images are)",
                missing.len(),
                views.len()
            ),
            "copy the images beside the model, or remove them from it",
        )),
    }
}

fn decode(listed: &[Listed], max_size: u32) -> Result<Vec<View>> {
    let mut views = listed
        .par_iter()
        .map(|v| {
            let (photo, size) = Photo::open(&v.file, max_size)?;
            let camera = (v.camera)(size)?;
            let aspect = |w: u32, h: u32| f64::from(w) / f64::from(h);
            let ratio = aspect(camera.width, camera.height) / aspect(size[0], size[1]);
            // A pixel of rounding is allowed beside the tolerance: small images cannot keep the ratio better.
            let slack = ASPECT_TOLERANCE + 1.0 / f64::from(size[0].min(size[1]));
            if (ratio - 1.0).abs() > slack {
                return Err(Error::input(
                    &v.file,
                    format!(
                        "has {}x{} pixels, but its camera is for {}x{}",
                        size[0], size[1], camera.width, camera.height
                    ),
                    "use the images that the cameras were computed from, or a scaled copy of them",
                ));
            }
            let camera = camera.scaled_to(photo.width, photo.height);
            Ok(View {
                name: v.name.clone(),
                camera,
                photo,
            })
        })
        .collect::<Result<Vec<View>>>()?;
    if views.iter().any(|v| v.photo.channels == 4) {
        for v in &mut views {
            let photo = std::mem::replace(
                &mut v.photo,
                Photo {
                    width: 0,
                    height: 0,
                    channels: 3,
                    data: Vec::new(),
                },
            );
            v.photo = photo.with_alpha();
        }
    }
    Ok(views)
}

/// Origin at the mean camera centre, unit length 1.1 × the largest distance of a camera centre from it (the scene
/// extent of 3DGS); where the cameras coincide, the points' median distance, else 1.
fn local_frame(views: &[View], points: &[(DVec3, [u8; 3])]) -> Frame {
    let n = views.len().max(1) as f64;
    // The mean of differences to the first centre: exact for coordinates far from the origin.
    let origin = views.first().map_or(DVec3::ZERO, |v| v.camera.center());
    let center = origin
        + views
            .iter()
            .map(|v| v.camera.center() - origin)
            .sum::<DVec3>()
            / n;
    let radius = views
        .iter()
        .map(|v| v.camera.center().distance(center))
        .fold(0.0, f64::max);
    if radius > 1e-9 * (center.length() + 1e-3) {
        return Frame {
            center,
            scale: 1.1 * radius,
        };
    }
    let mut distances: Vec<f64> = points.iter().map(|(p, _)| p.distance(center)).collect();
    distances.sort_by(f64::total_cmp);
    let median = distances
        .get(distances.len() / 2)
        .copied()
        .filter(|d| *d > 0.0);
    Frame {
        center,
        scale: median.unwrap_or(1.0),
    }
}
