//! A synthetic dataset on disk.

use std::fs;
use std::path::Path;

use serde::Serialize;

use crate::base::error::{Error, Result};
use crate::capture::Camera;
use crate::lab::synth::options::SynthOptions;
use crate::lab::synth::scenes::{NAMES, named};
use crate::lab::synth::{render, write};

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
    let place = named(name, options.seed).ok_or_else(|| {
        let known = NAMES.join(", ");
        Error::config("name", format!("no scene `{name}`; there are {known}"))
    })?;
    refuse_occupied(dir)?;
    let cameras: Vec<Camera> = (0..options.views)
        .map(|i| {
            let (at, target) = (place.camera)(i, options.views);
            render::look_at(at, target, options.width, options.height, place.tan)
        })
        .collect();
    let grid = (1..=32).find(|g| g * g >= options.samples).unwrap_or(32);
    let mut views = Vec::with_capacity(cameras.len());
    for (i, camera) in cameras.iter().enumerate() {
        let file = write::photo_name(options.layout, i);
        let pixels = render::photo(&place.scene, camera, i as u64, grid, place.transparent);
        write::png(&dir.join(&file), &pixels, camera, place.transparent)?;
        views.push((file, *camera));
    }
    let points = render::points(&place.scene, &cameras, options.points);
    write::model(dir, options.layout, &views, &points)?;
    let test_views = views.len().div_ceil(write::TEST_EVERY) as u32;
    Ok(SynthReport {
        name: name.to_owned(),
        options: options.clone(),
        train_views: options.views - test_views,
        test_views,
        points_written: points.len() as u32,
    })
}

/// Refuses a folder that is neither new nor empty: nothing is ever overwritten.
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
