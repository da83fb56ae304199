//! Raw views and points of the readers → [`Dataset`]: split, local frame, photos.

use std::collections::HashMap;
use std::path::{Component, Path, PathBuf};

use glam::DVec3;
use rayon::prelude::*;

use crate::base::error::{Error, Result};
use crate::base::math::{order_statistic, sorted};
use crate::capture::camera::Camera;
use crate::capture::dataset::{Dataset, Layout, LoadOptions, Needed, View};
use crate::capture::digests::Digests;
use crate::capture::endings::{EXTENSIONS, is_converted, is_image};
use crate::capture::frame::Frame;
use crate::capture::lens::{Lens, Undistortion};
use crate::capture::memory::automatic_budget;
use crate::capture::panorama::{self, Side};
use crate::capture::photo::Alpha;
use crate::capture::point_cloud::Points;
use crate::capture::rows::READ;
use crate::capture::source::{MaskFile, PhotoFile, PhotoSource, Resampling, header, read};

/// A posed image file; the camera in the dataset's own frame, intrinsics as the dataset gives them.
#[derive(Clone)]
pub(crate) struct RawView {
    /// Name of the image, unique within the dataset.
    pub name: String,
    /// The image file.
    pub file: PathBuf,
    /// Camera in the dataset's frame.
    pub camera: Camera,
    /// Its lens distortion.
    pub lens: Lens,
    /// The file of its mask.
    pub mask: Option<PathBuf>,
    /// The side of a panorama that the view shows; none before [`cut`].
    pub side: Option<Side>,
}

/// A dataset as read, in its own frame.
pub(crate) struct RawScene {
    /// Layout it was read from.
    pub layout: Layout,
    /// Places of its model and its photos, in words.
    pub place: String,
    /// Findings that the user should know about.
    pub remarks: Vec<String>,
    /// All views, or the training views if `test` is given.
    pub train: Vec<RawView>,
    /// Held-out views, if the dataset names them itself.
    pub test: Option<Vec<RawView>>,
    /// True for a part of a dataset: which cameras are outliers was judged in the whole.
    pub part: bool,
    /// Names of views whose images are missing; they are in neither list.
    pub missing: Vec<String>,
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

/// Cameras farther than this many times the 90th-percentile distance from the median are outliers (failed poses).
const ASTRAY: f64 = 20.0;

/// A path with another extension added to it.
fn with_added(path: &Path, extension: &str) -> PathBuf {
    let mut longer = path.to_path_buf().into_os_string();
    longer.push(".");
    longer.push(extension);
    longer.into()
}

/// A path with another extension in the place of its own; `None` for an ending that is no image extension, but part of the name.
fn with_swapped(path: &Path, extension: &str) -> Option<PathBuf> {
    is_image(path).then(|| path.with_extension(extension))
}

/// The image file that a dataset names: as it is, with an extension added, or with another one; `None` if there is none. One of a
/// format that is not read comes last: it may have been converted.
///
/// # Errors
/// A name that leads out of the folder.
pub(super) fn locate(folder: &Path, name: &str) -> Result<Option<PathBuf>> {
    let exact = inside(folder, name)?;
    let longer = EXTENSIONS.iter().map(|e| with_added(&exact, e));
    let other = EXTENSIONS.iter().filter_map(|e| with_swapped(&exact, e));
    let all = std::iter::once(exact.clone()).chain(longer).chain(other);
    let mut there = all.filter(|candidate| candidate.is_file());
    let first = there.next();
    let converted = |file: &PathBuf| is_converted(file);
    Ok(match first.as_ref().is_some_and(converted) {
        true => there.next().or(first),
        false => first,
    })
}

/// The mask of an image: in the folder `masks`, under the image's name or file name, with `.png` added (COLMAP) or replacing
/// the extension.
pub(super) fn find_mask(root: &Path, name: &str) -> Option<PathBuf> {
    let folder = root.join("masks");
    let whole = inside(&folder, name).ok()?;
    let short = folder.join(whole.file_name()?);
    let named = |path: PathBuf| {
        let swapped = with_swapped(&path, "png");
        [Some(with_added(&path, "png")), swapped, Some(path)]
    };
    let mut names = [whole, short].into_iter().flat_map(named).flatten();
    names.find(|p| p.is_file())
}

/// Splits, normalises and reads the photos.
///
/// # Errors
/// No photo there, a name given twice, an empty training set, an unreadable photo or one of another shape than its camera,
/// a photo larger than the budget, poses or points that leave the range of numbers.
pub(super) fn assemble(path: &Path, mut scene: RawScene, options: &LoadOptions) -> Result<Dataset> {
    let (train, test, outliers) = sides(path, &mut scene, options.test_every)?;
    let (mut remarks, missing) = (scene.remarks, scene.missing);
    remarks.extend(remark(train.iter().chain(&test)));
    // After the split: the sides of a panorama are all trained on or all held out.
    let [train, test] = [train, test].map(cut);
    distinct(path, train.iter().chain(&test))?;
    let first_held_out = train.len();
    let raw: Vec<RawView> = train.into_iter().chain(test).collect();
    let centers: Vec<DVec3> = raw.iter().map(|v| v.camera.center()).collect();
    let frame = Frame::fit(&centers, &scene.positions);
    if !frame.center.is_finite() || !frame.scale.is_normal() {
        let what = format!(
            "the cameras' mean centre is {} and their extent {}; finite, non-zero numbers expected",
            frame.center, frame.scale
        );
        return Err(Error::input(path, what, "check the poses"));
    }
    let sparse = (&scene.positions[..], &scene.colors[..]);
    let each = || automatic_budget() / options.keepers.max(1) as u64;
    let budget = options.image_budget.unwrap_or_else(each);
    let masked = raw.iter().any(|v| v.mask.is_some());
    if options.invert_masks && !options.alpha_is_mask && !masked {
        let what = "given, but no photo has a mask (a file in the folder masks, mask_path, or alpha with --alpha-is-mask)";
        return Err(Error::config("--invert-masks", what));
    }
    let meaning = if options.alpha_is_mask || masked {
        Alpha::Mask
    } else {
        Alpha::Transparency
    };
    let (cameras, files): (Vec<Camera>, Vec<PhotoFile>) = raw
        .par_iter()
        .map(|v| place(v, &frame, options, meaning))
        .collect::<Result<_>>()?;
    let each_files = raw.iter().map(|v| (&v.file, v.mask.as_ref()));
    let digests = || Digests::new(each_files.collect(), sparse);
    let digests = options.digests.then(digests).transpose()?;
    let points = Points::local(path, &frame, (scene.positions, scene.colors))?;
    let all = 0..files.len();
    let needed = match options.photos {
        Needed::None => None,
        Needed::Training => Some(0..first_held_out),
        Needed::HeldOut if first_held_out < all.end => Some(first_held_out..all.end),
        Needed::All | Needed::HeldOut => Some(all),
    };
    let photos = match needed {
        None => files.into_iter().map(PhotoSource::File).collect(),
        Some(needed) => read(files, needed, budget, options.progress)?,
    };
    let mut views = raw
        .into_iter()
        .zip(cameras)
        .zip(photos)
        .map(|((raw, camera), photo)| View {
            name: raw.name,
            camera,
            lens: raw.lens,
            photo,
        });
    let shown = |views: &mut dyn Iterator<Item = View>| -> (Vec<View>, Vec<View>) {
        views.partition(|v| !v.photo.masked_out())
    };
    let (train, mut black) = shown(&mut views.by_ref().take(first_held_out));
    let (test, held_out) = shown(&mut views);
    black.extend(held_out);
    let of_lenses = train.iter().chain(&test);
    let undistorted = of_lenses
        .filter(|v| !matches!(v.lens, Lens::Pinhole | Lens::Equirectangular))
        .count();
    if train.is_empty() {
        return Err(Error::input(
            path,
            "the masks leave no pixel of any training photo",
            "masks are white where a photo counts: give --invert-masks if yours are black there, or remove them",
        ));
    }
    Ok(Dataset {
        path: path.to_path_buf(),
        layout: scene.layout,
        place: scene.place,
        remarks,
        train,
        test,
        points,
        swept: None,
        frame,
        undistorted,
        missing,
        outliers,
        masked_out: black.into_iter().map(|v| v.name).collect(),
        image_budget: budget,
        digests,
    })
}

/// Takes the views of a dataset: those to train on, held-out ones, and the names of outliers, which are in neither list. The
/// missing ones are sorted.
///
/// # Errors
/// Those of [`split`].
pub(super) fn sides(
    path: &Path,
    scene: &mut RawScene,
    test_every: u32,
) -> Result<(Vec<RawView>, Vec<RawView>, Vec<String>)> {
    scene.missing.sort();
    let (train, test) = (std::mem::take(&mut scene.train), scene.test.take());
    let (train, test) = split(path, train, test, &scene.missing, test_every)?;
    Ok(match scene.part {
        true => (train, test, Vec::new()),
        false => without_outliers(train, test),
    })
}

/// Sorts by name; without a held-out list, every `test_every`-th image is held out, beginning with the first. Missing ones
/// count, so that the others stay on their sides.
fn split(
    path: &Path,
    mut train: Vec<RawView>,
    test: Option<Vec<RawView>>,
    missing: &[String],
    test_every: u32,
) -> Result<(Vec<RawView>, Vec<RawView>)> {
    if let (Some(first), true) = (missing.first(), train.is_empty()) {
        let what = format!(
            "none of the image files to train on is there; {} are missing, the first is {first} (as it is, or with the ending of {READ})",
            missing.len()
        );
        return Err(Error::input(path, what, "copy the images to their places"));
    }
    train.sort_by(|a, b| a.name.cmp(&b.name));
    let (train, test) = match test {
        Some(mut test) => {
            test.sort_by(|a, b| a.name.cmp(&b.name));
            (train, test)
        }
        None if test_every == 0 => (train, Vec::new()),
        None => {
            let mut index = 0;
            train.into_iter().partition(|view| {
                let before = missing.partition_point(|m| *m < view.name);
                index += 1;
                (index - 1 + before) % test_every as usize != 0
            })
        }
    };
    distinct(path, train.iter().chain(&test))?;
    let mut files = HashMap::new();
    for view in train.iter().chain(&test) {
        if let Some(other) = files.insert(&view.file, &view.name) {
            let what = format!("the image of two views, {other} and {}", view.name);
            let fix = "remove one of the entries";
            return Err(Error::input(&view.file, what, fix));
        }
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

/// Refuses a name that two views have.
fn distinct<'a>(path: &Path, views: impl Iterator<Item = &'a RawView>) -> Result<()> {
    let mut names = HashMap::new();
    for view in views {
        let Some(side) = names.insert(view.name.as_str(), view.side) else {
            continue;
        };
        if side.or(view.side).is_some() {
            let what = format!(
                "the image {} is called as the side of a panorama is",
                view.name
            );
            return Err(Error::input(path, what, "rename one of the two photos"));
        }
        let what = format!("the image {} is given twice", view.name);
        let fix = "remove one of the entries (a view cannot be both trained on and held out)";
        return Err(Error::input(path, what, fix));
    }
    Ok(())
}

/// Name of the view of a panorama's side: `photo_front.jpg` for the front of `photo.jpg`.
fn view_name(panorama: &str, side: Side) -> String {
    let ending = Path::new(panorama)
        .extension()
        .and_then(|e| e.to_str())
        .filter(|_| is_image(Path::new(panorama)));
    match ending {
        Some(ending) => {
            let stem = &panorama[..panorama.len() - ending.len() - 1];
            format!("{stem}_{}.{ending}", side.name())
        }
        None => format!("{panorama}_{}", side.name()),
    }
}

/// The remark on photos that are panoramas, if any are.
fn remark<'a>(photos: impl Iterator<Item = &'a RawView>) -> Option<String> {
    let n = photos.filter(|p| p.lens == Lens::Equirectangular).count();
    let views = n * Side::ALL.len();
    (n > 0).then(|| {
        format!("panoramas cut into views (front, right, back, left, up, down): {n} into {views}")
    })
}

/// The views of photos, sorted by name: those of a panorama's sides instead of it, all others as they are.
fn cut(photos: Vec<RawView>) -> Vec<RawView> {
    let sides = |photo: &RawView| match photo.lens {
        Lens::Equirectangular => Side::ALL.map(Some).to_vec(),
        _ => vec![None],
    };
    let view = |photo: &RawView, side: Option<Side>| RawView {
        name: side.map_or_else(|| photo.name.clone(), |side| view_name(&photo.name, side)),
        side,
        ..photo.clone()
    };
    let mut views: Vec<RawView> = photos
        .iter()
        .flat_map(|photo| sides(photo).into_iter().map(|side| view(photo, side)))
        .collect();
    views.sort_by(|a, b| a.name.cmp(&b.name));
    views
}

/// Training and held-out views without outlier cameras, and the names of these: one wrong pose would shrink the scene to a
/// speck. If more than a twentieth of the views or all training views are outliers, none is removed.
fn without_outliers(
    train: Vec<RawView>,
    test: Vec<RawView>,
) -> (Vec<RawView>, Vec<RawView>, Vec<String>) {
    let centers: Vec<DVec3> = train
        .iter()
        .chain(&test)
        .map(|v| v.camera.center())
        .collect();
    let quantile = |values: &mut dyn Iterator<Item = f64>, q: f64| {
        order_statistic(&sorted(values), q).unwrap_or_default()
    };
    let axis = |k: usize| quantile(&mut centers.iter().map(|c| c[k]), 0.5);
    let middle = DVec3::new(axis(0), axis(1), axis(2));
    let usual = quantile(&mut centers.iter().map(|c| c.distance(middle)), 0.9);
    let far = |v: &RawView| usual > 0.0 && v.camera.center().distance(middle) > ASTRAY * usual;
    let outliers = train.iter().chain(&test).filter(|v| far(v));
    let outliers: Vec<String> = outliers.map(|v| v.name.clone()).collect();
    if 20 * outliers.len() > centers.len() || train.iter().all(far) {
        return (train, test, Vec::new());
    }
    let near = |views: Vec<RawView>| views.into_iter().filter(|v| !far(v)).collect();
    (near(train), near(test), outliers)
}

/// The photo file of a view, and its camera: in the local frame, a pinhole, at the resolution of the decoded photo.
fn place(
    view: &RawView,
    frame: &Frame,
    options: &LoadOptions,
    meaning: Alpha,
) -> Result<(Camera, PhotoFile)> {
    let (header, camera) = (header(&view.file)?, &view.camera);
    let [w, h] = [header.width, header.height].map(f64::from);
    let aspect = w * f64::from(camera.height) / (h * f64::from(camera.width));
    // Resampled copies round their sides to whole pixels; half a pixel on each side is no other shape either.
    let slack = 0.5 / w + 0.5 / h;
    if (aspect - 1.0).abs() > slack.max(0.01) {
        let what = format!(
            "{w}×{h} pixels, but its camera says {}×{}, another shape",
            camera.width, camera.height
        );
        let fix = "use the photos that the camera parameters were computed for";
        return Err(Error::input(&view.file, what, fix));
    }
    let size = [header.width, header.height];
    let own_size = camera.scaled_to(header.width, header.height);
    let (pinhole, resampling) = match (view.side, view.lens) {
        (Some(side), _) => {
            panorama::check_size(&view.file, size)?;
            let whole = panorama::side_of(size, u32::MAX);
            (side.camera(camera, whole), Resampling::Side(side))
        }
        (None, Lens::Pinhole) => (*camera, Resampling::Shrinking),
        (None, lens) => {
            let undistortion = Undistortion::new(lens, &own_size).ok_or_else(|| {
                let what = format!("its lens ({lens:?}) leaves no pinhole image of the photo");
                Error::input(&view.file, what, "check the camera's distortion parameters")
            })?;
            (
                undistortion.target,
                Resampling::Lens(Box::new(undistortion)),
            )
        }
    };
    let mask = MaskFile {
        path: view.mask.clone(),
        inverted: options.invert_masks,
        inverted_alpha: options.invert_masks && options.alpha_is_mask,
    };
    let (path, size) = (view.file.clone(), options.max_size);
    let file = PhotoFile::new(path, header, size, resampling, mask, meaning);
    let (width, height) = file.size();
    let mut camera = pinhole.scaled_to(width, height);
    camera.translation = -(camera.rotation * frame.to_local(view.camera.center()));
    Ok((camera, file))
}
