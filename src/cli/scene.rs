//! A scene file or run folder with its dataset, on a device.

use std::path::{Path, PathBuf};

use crate::cli::common::DeviceOption;
use crate::cli::{output, progress};
use glam::DVec3;

use mhsplat::base::error::{Error, Result};
use mhsplat::capture;
use mhsplat::capture::{Camera, Dataset, Frame, LoadOptions, Needed, View};
use mhsplat::config::{Background, SceneFormat, TrainConfig};
use mhsplat::device::{Defines, Device};
use mhsplat::pipeline::buffers::GaussianBuffers;
use mhsplat::pipeline::forward::Renderer;
use mhsplat::run::{RECORD_FILE, RunRecord};
use mhsplat::scene::formats::{self, SceneFile};

/// A scene ready to be rendered.
pub struct Loaded {
    pub device: Device,
    pub scene: GaussianBuffers,
    pub renderer: Renderer,
    /// Direction away from the ground, if the file tells.
    pub up: Option<DVec3>,
    /// Colour behind the scene, RGB in [0, 1]: black if the file does not tell.
    pub background: [f32; 3],
}

/// Returns the scene file at `path` (a file or a run folder), and the run's record.
pub fn locate(path: &Path) -> Result<(PathBuf, Option<RunRecord>)> {
    if !path.exists() {
        let fix = "give a scene file or the folder of a run";
        return Err(Error::input(path, "is not there", fix));
    }
    if !path.is_dir() {
        return Ok((path.to_path_buf(), None));
    }
    let ply = path.join("scene.ply");
    if !ply.exists() {
        let fix = match path.join(RECORD_FILE).exists() {
            true => {
                "the run has none yet: wait for its first evaluation or its end, or stop it with Ctrl-C"
            }
            false => "give a scene file or the folder of a run",
        };
        return Err(Error::input(path, "holds no scene.ply", fix));
    }
    let recorded = path.join(RECORD_FILE).exists();
    let record = recorded.then(|| RunRecord::read(path)).transpose()?;
    Ok((ply, record))
}

/// Returns the format of a scene file to be written, by its name.
///
/// # Errors
/// Another ending, and a file that is there: nothing is overwritten.
pub fn new_file(out: &Path) -> Result<SceneFormat> {
    let format = formats::of_name(out)?;
    if out.symlink_metadata().is_ok() {
        let what = "exists already; nothing is overwritten";
        return Err(Error::input(out, what, "name another file"));
    }
    Ok(format)
}

/// Scene file that was written.
pub struct Written {
    /// Its size.
    pub bytes: u64,
    /// Sentences on what the format could not keep.
    pub lost: Vec<String>,
}

/// Writes a scene in the dataset's own frame, and notes what the format could not keep.
pub fn write(out: &Path, format: SceneFormat, scene: &SceneFile) -> Result<Written> {
    let lost = formats::write(out, format, scene, &Frame::IDENTITY)?;
    for what in &lost {
        output::note(&format!("{}: {what}", out.display()));
    }
    let bytes = out.metadata().map_err(|e| Error::io(out, e))?.len();
    Ok(Written { bytes, lost })
}

/// Options that say which photos a scene is looked at with.
#[derive(Default, clap::Args)]
pub struct PhotoOptions {
    /// Longest image side, pixels (the run's, else 1600).
    #[arg(long)]
    max_size: Option<u32>,
    /// Every n-th image is held out (the run's, else 8).
    #[arg(long)]
    test_every: Option<u32>,
    /// Folder of the photos, in the dataset or elsewhere (default: as in the run).
    #[arg(long, value_name = "DIR")]
    images: Option<PathBuf>,
    /// Take the photos' alpha for a mask of the pixels that count, not for transparency (default: as in the run).
    #[arg(long)]
    alpha_is_mask: bool,
    /// Masks are black where a photo counts (default: as in the run).
    #[arg(long)]
    invert_masks: bool,
    /// Accept a dataset that is not the one that the run was trained on.
    #[arg(long)]
    allow_different: bool,
}

impl PhotoOptions {
    /// Returns the run's, for a command that compares the dataset with the run itself.
    pub fn of_run() -> Self {
        Self {
            allow_different: true,
            ..Self::default()
        }
    }
}

/// Returns the dataset that is asked for, else that of the run.
///
/// # Errors
/// None is asked for, and there is no run: with `how` to ask for one. A run whose dataset is not there any more.
pub fn dataset_path(
    asked: Option<&Path>,
    record: Option<&RunRecord>,
    how: &str,
) -> Result<PathBuf> {
    if let Some(path) = asked {
        return Ok(path.to_path_buf());
    }
    let Some(record) = record else {
        return Err(Error::config(
            "DATASET",
            format!("a scene file does not say which views; {how}"),
        ));
    };
    let path = PathBuf::from(&record.dataset.path);
    if !path.exists() {
        let what = "the dataset that the run was trained on is not there any more";
        return Err(Error::input(path, what, "give where it is now"));
    }
    Ok(path)
}

/// Reads a dataset at the resolution and split of a run, or at those given. Photos that are not `needed` may be left in their files ([`Needed`]).
///
/// # Errors
/// Those of [`capture::load`]; another dataset than the run's, unless that is allowed.
pub fn dataset(
    path: &Path,
    record: Option<&RunRecord>,
    options: &PhotoOptions,
    needed: Needed,
) -> Result<Dataset> {
    let mut config = record.map(|r| r.config.clone()).unwrap_or_default();
    let of_run = config.clone();
    config.max_size = options.max_size.unwrap_or(config.max_size);
    config.test_every = options.test_every.unwrap_or(config.test_every);
    config.image_budget = None;
    // A dataset in another place may have no such folder: then its own photos are meant. What an archive has is seen later.
    let there = |images: &PathBuf| !path.is_dir() || path.join(images).is_dir() || images.is_dir();
    let of_record = config.images.take();
    if let Some(images) = of_record.as_ref().filter(|images| !there(images)) {
        let what = format!(
            "the run had the photos of {}, which is not there",
            images.display()
        );
        output::note(&format!("{what}: those of the dataset are taken"));
    }
    config.images = options.images.clone().or(of_record.filter(there));
    config.alpha_is_mask |= options.alpha_is_mask;
    config.invert_masks |= options.invert_masks;
    let load = LoadOptions {
        photos: needed,
        ..load_options(&config)
    };
    let mut data = capture::load(path, &load)?;
    if let Some(record) = record.filter(|_| needed == Needed::None) {
        // Unread, they are not known to be masked out.
        let shown = |view: &View| !record.dataset.masked_out.contains(&view.name);
        data.train.retain(shown);
        data.test.retain(shown);
    }
    note_left_out(&data);
    let asked = |c: &TrainConfig| {
        let masks = (c.alpha_is_mask, c.invert_masks);
        (c.max_size, c.test_every, masks, c.images.clone())
    };
    if let Some(record) = record.filter(|_| !options.allow_different) {
        // With another size or split the whole fingerprint is another one.
        let (known, found) = match needed != Needed::None && asked(&config) == asked(&of_run) {
            true => (&record.dataset.fingerprint, data.fingerprint()),
            false => (&record.dataset.capture, data.capture_fingerprint()),
        };
        let same = known.as_ref().is_none_or(|known| *known == found);
        if !same {
            let trained_on = Path::new(&record.dataset.path);
            let same = |path: &Path| path.canonicalize().ok();
            let (what, fix) = match same(path).is_some() && same(path) == same(trained_on) {
                true => (
                    "not as it was when the run was trained on it (a photo or a pose has come, gone or changed)".to_owned(),
                    "restore it, or give --allow-different if the scene is the same",
                ),
                false => (
                    format!("not the dataset that the run was trained on ({})", trained_on.display()),
                    "give that one, or --allow-different if the scene is the same",
                ),
            };
            return Err(Error::input(path, what, fix));
        }
    }
    Ok(data)
}

/// Reads the frame of a dataset and the cameras of its views in the order of their names, which that of capture is as a rule; no photos.
///
/// # Errors
/// Those of [`dataset`].
pub fn cameras(
    path: &Path,
    record: Option<&RunRecord>,
    options: &PhotoOptions,
) -> Result<(Frame, Vec<Camera>)> {
    let mut data = dataset(path, record, options, Needed::None)?;
    data.train.append(&mut data.test);
    data.train.sort_by(|a, b| a.name.cmp(&b.name));
    let cameras = data.train.iter().map(|view| view.camera).collect();
    Ok((data.frame, cameras))
}

/// Returns what a configuration says about reading a dataset.
pub fn load_options(config: &TrainConfig) -> LoadOptions {
    LoadOptions {
        max_size: config.max_size,
        test_every: config.test_every,
        image_budget: config.image_budget,
        keepers: 1,
        images: config.images.clone(),
        alpha_is_mask: config.alpha_is_mask,
        invert_masks: config.invert_masks,
        photos: Needed::All,
        digests: false,
        progress: Some(progress::reading),
    }
}

/// Notes what was remarkable in a dataset, and the images that are left out, with the reasons.
pub fn note_left_out(data: &Dataset) {
    data.remarks
        .iter()
        .for_each(|remark| match remark.starts_with("warning") {
            true => output::note(remark),
            false => output::info(remark),
        });
    let are = ["image is", "images are"];
    let have = ["image has a camera", "images have cameras"];
    for (names, subject, what) in [
        (&data.missing, are, "named by the dataset but missing"),
        (&data.masked_out, are, "masked out completely"),
        (&data.outliers, have, "far from all others (a wrong pose?)"),
    ] {
        if names.is_empty() {
            continue;
        }
        let subject = subject[usize::from(names.len() > 1)];
        let some = names[..names.len().min(5)].join(", ");
        let dots = if names.len() > 5 { ", ..." } else { "" };
        let count = names.len();
        output::note(&format!("left out: {count} {subject} {what}: {some}{dots}"));
    }
}

/// Reads a scene into a local frame, and notes what could not be read as it is.
pub fn read(path: &Path, frame: &Frame) -> Result<SceneFile> {
    let file = formats::read(path, frame)?;
    for what in file.changes() {
        output::note(&format!("{}: {what}", path.display()));
    }
    Ok(file)
}

/// Uploads a scene in a local frame, with the 2D filter if its file asks for it.
pub fn open(path: &Path, frame: &Frame, device: &DeviceOption) -> Result<Loaded> {
    let file = read(path, frame)?;
    let device = device.open_tested()?;
    let defines = Defines {
        anti_alias: file.anti_aliased,
        ..Defines::new(device.tuning())
    };
    let renderer = Renderer::new(&device, defines, file.splats.sh_degree(), false)?;
    let mut scene = GaussianBuffers::upload(&device, &file.splats, 0)?;
    if defines.anti_alias {
        scene = scene.with_filter(&device)?;
    }
    Ok(Loaded {
        device,
        scene,
        renderer,
        up: file.up.and_then(|up| DVec3::from(up).try_normalize()),
        background: file.background.unwrap_or_default(),
    })
}

/// Returns the given background, or the one that a run used for evaluation; `None` if neither says one.
pub fn background(asked: Option<&str>, record: Option<&RunRecord>) -> Result<Option<[f32; 3]>> {
    let Some(text) = asked else {
        return Ok(record.map(RunRecord::background));
    };
    let one = text.parse().ok().filter(|b: &Background| !b.changes(true));
    let one = one.ok_or_else(|| {
        let what = format!("{text:?}; black, white or R,G,B in 0 to 1 expected");
        Error::config("--background", what)
    })?;
    Ok(Some(one.named()))
}
