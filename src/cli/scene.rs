//! A scene file or run folder with its dataset, on a device.

use std::path::{Path, PathBuf};

use crate::cli::{common, output, progress};
use mhsplat::base::error::{Error, Result};
use mhsplat::capture;
use mhsplat::capture::{Dataset, Frame, LoadOptions};
use mhsplat::config::{Background, TrainConfig};
use mhsplat::device::{Defines, Device};
use mhsplat::pipeline::buffers::GaussianBuffers;
use mhsplat::pipeline::forward::Renderer;
use mhsplat::run::{RECORD_FILE, RunRecord};
use mhsplat::scene::ply;

/// A scene ready to be rendered.
pub struct Loaded {
    pub device: Device,
    pub scene: GaussianBuffers,
    pub renderer: Renderer,
}

/// Returns the PLY file at `path` (a file or a run folder), and the run's record.
pub fn locate(path: &Path) -> Result<(PathBuf, Option<RunRecord>)> {
    if !path.is_dir() {
        return Ok((path.to_path_buf(), None));
    }
    let ply = path.join("scene.ply");
    if !ply.exists() {
        return Err(Error::input(
            path,
            "holds no scene.ply",
            "give a PLY file or the folder of a finished run",
        ));
    }
    let recorded = path.join(RECORD_FILE).exists();
    let record = recorded.then(|| RunRecord::read(path)).transpose()?;
    Ok((ply, record))
}

/// Reads a dataset at the resolution and split of a run, or at those given; alpha is a mask if it was one in the run, or if
/// `alpha_is_mask` is set.
pub fn dataset(
    path: &Path,
    record: Option<&RunRecord>,
    max_size: Option<u32>,
    test_every: Option<u32>,
    alpha_is_mask: bool,
) -> Result<Dataset> {
    let mut config = record.map(|r| r.config.clone()).unwrap_or_default();
    config.max_size = max_size.unwrap_or(config.max_size);
    config.test_every = test_every.unwrap_or(config.test_every);
    config.image_budget = None;
    config.alpha_is_mask |= alpha_is_mask;
    let data = capture::load(path, &load_options(&config))?;
    note_left_out(&data);
    Ok(data)
}

/// Returns what a configuration says about reading a dataset.
pub fn load_options(config: &TrainConfig) -> LoadOptions {
    LoadOptions {
        max_size: config.max_size,
        test_every: config.test_every,
        image_budget: config.image_budget,
        alpha_is_mask: config.alpha_is_mask,
        progress: Some(progress::reading),
    }
}

/// Notes the images of a dataset that are left out, and why.
pub fn note_left_out(data: &Dataset) {
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

/// Uploads a scene in a local frame, with the 2D filter if its file asks for it.
pub fn open(ply: &Path, frame: &Frame, device: Option<&str>) -> Result<Loaded> {
    let file = ply::read(ply, frame)?;
    let device = common::open_tested(device)?;
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
    })
}

/// Returns the background that a run used for evaluation, or the given one.
pub fn background(asked: Option<&str>, record: Option<&RunRecord>) -> Result<[f32; 3]> {
    let mut config = record.map(|r| r.config.clone()).unwrap_or_default();
    if let Some(text) = asked {
        let one = text.parse().ok().filter(|b: &Background| !b.changes(true));
        config.background = one.ok_or_else(|| {
            let what = format!("{text:?}; black, white or R,G,B in 0 to 1 expected");
            Error::config("--background", what)
        })?;
    }
    Ok(mhsplat::train::schedule::Schedule::new(&config).fixed_background())
}
