//! From what the readers found to a [`Dataset`]: split, local frame, photos.

use std::collections::HashSet;
use std::path::{Component, Path, PathBuf};

use glam::DVec3;
use rayon::prelude::*;

use super::decode::header;
use super::source::{PhotoFile, automatic_budget, read};
use super::{Camera, Dataset, Frame, Layout, LoadOptions, Points, View};
use crate::error::{Error, Result};

/// A posed image file; the camera in the dataset's own frame, intrinsics as the dataset gives them.
pub(super) struct RawView {
    /// Name of the image, unique within the dataset.
    pub name: String,
    /// The image file.
    pub file: PathBuf,
    /// Camera in the dataset's frame.
    pub camera: Camera,
}

/// A dataset as read, in its own frame.
pub(super) struct RawScene {
    /// Layout it was read from.
    pub layout: Layout,
    /// All views, or those to train on where `test` is given.
    pub train: Vec<RawView>,
    /// Held-out views, where the dataset names them itself.
    pub test: Option<Vec<RawView>>,
    /// Sparse points, dataset units.
    pub positions: Vec<DVec3>,
    /// RGB colours, one per position.
    pub colors: Vec<[u8; 3]>,
}

/// The path of `name` below `folder`.
///
/// # Errors
/// A name that is absolute, empty or climbs out of the folder: a dataset must not read the rest of the disk.
pub(super) fn inside(folder: &Path, name: &str) -> Result<PathBuf> {
    let relative = Path::new(name);
    let stays = relative
        .components()
        .all(|c| matches!(c, Component::Normal(_) | Component::CurDir));
    if stays && relative.file_name().is_some() {
        return Ok(folder.join(relative));
    }
    Err(Error::input(
        folder,
        format!("the dataset names the file '{name}', which is not below this folder"),
        "use relative paths without '..'",
    ))
}

/// Splits, normalises and reads the photos.
///
/// # Errors
/// Missing photos, a name given twice, an empty training set, an unreadable photo or one of another shape than its camera,
/// a photo larger than the budget, poses or points that leave the range of numbers.
pub(super) fn assemble(path: &Path, scene: RawScene, options: &LoadOptions) -> Result<Dataset> {
    let (train, test) = split(path, scene.train, scene.test, options.test_every)?;
    check_files(path, &train, &test)?;
    let centers: Vec<DVec3> = train
        .iter()
        .chain(&test)
        .map(|v| v.camera.center())
        .collect();
    let frame = local_frame(path, &centers, &scene.positions)?;
    let points = local_points(path, &frame, &scene.positions, scene.colors)?;
    let budget = options.image_budget.unwrap_or_else(automatic_budget);
    let first_held_out = train.len();
    let raw: Vec<RawView> = train.into_iter().chain(test).collect();
    let (cameras, files): (Vec<Camera>, Vec<PhotoFile>) = raw
        .par_iter()
        .map(|v| place(v, &frame, options.max_size))
        .collect::<Result<_>>()?;
    let photos = read(files, budget)?;
    let mut views = raw
        .into_iter()
        .zip(cameras)
        .zip(photos)
        .map(|((raw, camera), photo)| View {
            name: raw.name,
            camera,
            photo,
        });
    Ok(Dataset {
        path: path.to_path_buf(),
        layout: scene.layout,
        train: views.by_ref().take(first_held_out).collect(),
        test: views.collect(),
        points,
        frame,
        image_budget: budget,
    })
}

/// Sorts by name; without a held-out list, every `test_every`-th image is held out, beginning with the first.
fn split(
    path: &Path,
    mut train: Vec<RawView>,
    test: Option<Vec<RawView>>,
    test_every: u32,
) -> Result<(Vec<RawView>, Vec<RawView>)> {
    train.sort_by(|a, b| a.name.cmp(&b.name));
    let (train, test) = match test {
        Some(mut test) => {
            test.sort_by(|a, b| a.name.cmp(&b.name));
            (train, test)
        }
        None if test_every == 0 => (train, Vec::new()),
        None => {
            let mut index = 0;
            train.into_iter().partition(|_| {
                index += 1;
                (index - 1) % test_every != 0
            })
        }
    };
    let mut seen = HashSet::new();
    if let Some(twice) = train
        .iter()
        .chain(&test)
        .find(|v| !seen.insert(v.name.as_str()))
    {
        let what = format!("the image {} is given twice", twice.name);
        let fix = "remove one of the entries (a view cannot be both trained on and held out)";
        return Err(Error::input(path, what, fix));
    }
    if train.is_empty() {
        let what = format!(
            "{} views are held out and none is left to train on",
            test.len()
        );
        let fix = "use more images or lower the share held out (--test-every 0 holds out none)";
        return Err(Error::input(path, what, fix));
    }
    Ok((train, test))
}

fn check_files(path: &Path, train: &[RawView], test: &[RawView]) -> Result<()> {
    let all = || train.iter().chain(test);
    let missing: Vec<&RawView> = all().filter(|v| !v.file.is_file()).collect();
    match missing.first() {
        None => Ok(()),
        Some(first) => Err(Error::input(
            path,
            format!(
                "{} of {} image files are missing, the first is {}",
                missing.len(),
                all().count(),
                first.file.display()
            ),
            "copy the images to their places or remove their entries",
        )),
    }
}

/// [`Frame::fit`], refused where it is no frame.
fn local_frame(path: &Path, centers: &[DVec3], points: &[DVec3]) -> Result<Frame> {
    let frame = Frame::fit(centers, points);
    let Frame { center, scale } = frame;
    if center.is_finite() && scale.is_normal() {
        return Ok(frame);
    }
    Err(Error::input(
        path,
        format!(
            "the cameras' mean centre is {center} and their extent {scale}; finite, non-zero numbers expected"
        ),
        "check the poses",
    ))
}

fn local_points(
    path: &Path,
    frame: &Frame,
    positions: &[DVec3],
    colors: Vec<[u8; 3]>,
) -> Result<Points> {
    let positions: Vec<[f32; 3]> = positions
        .iter()
        .map(|&p| frame.to_local(p).as_vec3().to_array())
        .collect();
    let far = |p: &[f32; 3]| p.iter().any(|v| !v.is_finite());
    if let Some(i) = positions.iter().position(far) {
        let what = format!("point {i} lies too far from the cameras for single precision");
        return Err(Error::input(path, what, "remove the point"));
    }
    Ok(Points { positions, colors })
}

/// Moves the camera to the local frame and to the resolution that the photo will have.
fn place(view: &RawView, frame: &Frame, max_size: u32) -> Result<(Camera, PhotoFile)> {
    let header = header(&view.file)?;
    let original = (header.width, header.height);
    let camera = &view.camera;
    let expected = (f64::from(camera.width), f64::from(camera.height));
    let aspect = f64::from(original.0) * expected.1 / (f64::from(original.1) * expected.0);
    // Resampled copies round their sides to whole pixels; half a pixel on each side is no other shape either.
    let slack = 0.5 / f64::from(original.0) + 0.5 / f64::from(original.1);
    if (aspect - 1.0).abs() > slack.max(0.01) {
        return Err(Error::input(
            &view.file,
            format!(
                "{}×{} pixels, but its camera says {}×{}, another shape",
                original.0, original.1, camera.width, camera.height
            ),
            "use the photos that the camera parameters were computed for",
        ));
    }
    let file = PhotoFile::new(view.file.clone(), header, max_size);
    let (width, height) = file.size();
    let mut camera = camera.scaled_to(width, height);
    camera.translation = -(camera.rotation * frame.to_local(view.camera.center()));
    Ok((camera, file))
}
