//! Start of a run: its folder, the first Gaussians and the record.

use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};

use crate::base::error::{Error, Result};
use crate::base::files::{FolderLock, LOCK_FILE};
use crate::capture::{Camera, Dataset};
use crate::config::{Init, Sampler, TrainConfig};
use crate::device::Device;
use crate::device::tuning::Tuning;
use crate::run::checkpoint;
use crate::run::record::{DatasetRecord, DeviceRecord, PlanRecord, RECORD_FILE, RunRecord};
use crate::run::table::{DENSITY_FILE, METRICS_FILE};
use crate::scene::formats::{self, Contents, SceneFile};
use crate::scene::without_filter;
use crate::scene::{Gaussians, init, sweep};
use crate::train::Plan;

/// Gaussians of an initialisation that the dataset has no points for.
const RANDOM_GAUSSIANS: usize = 20_000;

/// The same for strategies that fill a scene from few: mh and mcmc are sooner, adc is not (docs/results/samplers.md).
const FEW_RANDOM_GAUSSIANS: usize = 5_000;

/// A dataset with points found in its photos, if it has none and the configuration asks for some. As many as a random start would have, or fewer.
///
/// # Errors
/// A photo that cannot be read.
pub fn with_points(mut dataset: Dataset, config: &TrainConfig) -> Result<Dataset> {
    if config.init == Init::Points && dataset.swept.is_none() && dataset.point_count() == 0 {
        dataset.points = sweep::points(&dataset, most_unplaced(config), config.seed)?;
        dataset.swept = Some(dataset.points.positions.len());
    }
    Ok(dataset)
}

/// Number of first Gaussians where the dataset does not give them.
fn most_unplaced(config: &TrainConfig) -> usize {
    let count = match config.sampler {
        Sampler::Mh | Sampler::Mcmc => FEW_RANDOM_GAUSSIANS,
        Sampler::Adc | Sampler::None => RANDOM_GAUSSIANS,
    };
    count.min(config.max_gaussians.unwrap_or(usize::MAX))
}

/// The first Gaussians that a configuration asks for.
///
/// Without bands of spherical harmonics, but for those of a file with Gaussians: training adds them.
/// Never more than `max_gaussians`: of too many points a random part is taken, keyed by the seed.
///
/// # Errors
/// A file that cannot be read, holds nothing, or too many Gaussians.
pub fn initial_gaussians(dataset: &Dataset, plan: &Plan) -> Result<Gaussians> {
    first(dataset, plan, &mut Vec::new())
}

/// [`initial_gaussians`], with remarks on their file or on points that were found.
pub(super) fn first(
    dataset: &Dataset,
    plan: &Plan,
    remarks: &mut Vec<String>,
) -> Result<Gaussians> {
    let config = &plan.config;
    let found = dataset.swept.filter(|_| config.init == Init::Points);
    remarks.extend(found.map(|found| match found {
        0 => "no sparse points, and the photos agree in too few places: the first Gaussians are random".to_owned(),
        _ => format!("no sparse points: the first Gaussians are {found} places where the photos agree"),
    }));
    let most = config.max_gaussians.unwrap_or(usize::MAX);
    let splats = match &config.init {
        Init::File(path) => from_file(path, dataset, plan, most, remarks),
        start if *start == Init::Random || dataset.points.positions.is_empty() => {
            init::random(dataset, most_unplaced(config), 0, config.seed)
        }
        _ => {
            let points = init::subset(&dataset.points, most, config.seed);
            init::from_points(&points, 0)
        }
    }?;
    Ok(if config.work.morton_order {
        splats.in_morton_order(plan.up)
    } else {
        splats
    })
}

/// The Gaussians of a scene file, or one for each point of a plain cloud.
fn from_file(
    path: &Path,
    dataset: &Dataset,
    plan: &Plan,
    most: usize,
    remarks: &mut Vec<String>,
) -> Result<Gaussians> {
    let empty = || Error::input(path, "no vertex", "give a file that holds some");
    let file = match formats::read_either(path, &dataset.frame)? {
        Contents::Points(points) if points.positions.is_empty() => return Err(empty()),
        Contents::Points(points) => {
            return init::from_points(&init::subset(&points, most, plan.config.seed), 0);
        }
        Contents::Scene(file) if file.splats.is_empty() => return Err(empty()),
        Contents::Scene(file) => file,
    };
    let changes = file.changes().into_iter();
    remarks.extend(changes.map(|what| format!("{}: {what}", path.display())));
    let SceneFile {
        splats,
        anti_aliased,
        ..
    } = file;
    if splats.len() > most {
        return Err(Error::input(
            path,
            format!("{} Gaussians; at most {most} are wanted", splats.len()),
            "raise --max-gaussians",
        ));
    }
    let filtered = anti_aliased && plan.anti_aliasing.value;
    let splats = if filtered {
        without_filter(&splats, dataset)?
    } else {
        splats
    };
    let degree = splats.sh_degree().min(plan.sh_degree.value);
    splats.with_sh_degree(degree)
}

/// The configuration of the run in a folder: its checkpoint's, or its record's where it was killed before the first checkpoint.
///
/// # Errors
/// A folder without either, or a damaged one.
pub fn saved_config(dir: &Path) -> Result<TrainConfig> {
    if !has_checkpoint(dir)? && dir.join(RECORD_FILE).is_file() {
        return Ok(RunRecord::read(dir)?.config);
    }
    checkpoint::read_config(dir)
}

/// The sizes of the kernels that the run in a folder goes on with; `None` if it begins again, or if they are not on record.
///
/// # Errors
/// A folder that cannot be looked into, or a damaged record.
pub fn saved_tuning(dir: &Path) -> Result<Option<Tuning>> {
    match has_checkpoint(dir)? && dir.join(RECORD_FILE).is_file() {
        true => Ok(RunRecord::read(dir)?.device.tuning),
        false => Ok(None),
    }
}

/// True if a run folder holds a checkpoint.
///
/// # Errors
/// A folder that cannot be looked into: that is not the same as no checkpoint.
pub(super) fn has_checkpoint(dir: &Path) -> Result<bool> {
    let file = checkpoint::path(dir);
    file.try_exists().map_err(|e| Error::io(file, e))
}

/// Refuses to begin a run anew in its folder unless it was killed before its first checkpoint.
///
/// # Errors
/// A scene in the folder, or a record of another dataset.
pub(super) fn check_unfinished(dir: &Path, dataset: &Dataset) -> Result<()> {
    let record = RunRecord::read(dir)?;
    let fix = "start anew with -o NEW_FOLDER";
    if dir.join("scene.ply").exists() {
        let what = "holds a scene and no checkpoint to resume from; nothing is overwritten";
        return Err(Error::input(dir, what, fix));
    }
    if record.dataset.fingerprint.as_deref() != Some(&dataset.fingerprint()) {
        let fix = "give the dataset of that run";
        return Err(Error::input(&dataset.path, dataset.not_that_of(dir), fix));
    }
    Ok(())
}

/// The record of a run that has not begun.
pub(super) fn record(dataset: &Dataset, plan: &Plan, device: &Device) -> RunRecord {
    let info = device.info();
    let largest = |side: fn(&Camera) -> u32| {
        let sides = dataset.train.iter().map(|v| side(&v.camera));
        sides.max().unwrap_or(0)
    };
    let record = RunRecord::new(
        plan.config.clone(),
        DatasetRecord {
            path: absolute(&dataset.path),
            layout: dataset.layout.to_string(),
            train_views: dataset.train.len(),
            test_views: dataset.test.len(),
            missing: dataset.missing.clone(),
            outliers: dataset.outliers.clone(),
            masked_out: dataset.masked_out.clone(),
            width: largest(|c| c.width),
            height: largest(|c| c.height),
            fingerprint: Some(dataset.fingerprint()),
            capture: Some(dataset.capture_fingerprint()),
        },
        DeviceRecord {
            name: info.name.clone(),
            vendor: info.vendor.clone(),
            platform: info.platform.clone(),
            driver: info.driver.clone(),
            compute_units: Some(info.compute_units),
            cores: Some(info.cores),
            ranks: Some(device.helpers().ranks()).filter(|n| *n > 1),
            tuning: Some(device.tuning()),
        },
        PlanRecord::of(plan),
    );
    RunRecord {
        background: Some(plan.background.value),
        ..record
    }
}

/// A path that stays right in whatever folder a program is started that reads the record.
fn absolute(path: &Path) -> String {
    let whole = std::path::absolute(path);
    whole.as_deref().unwrap_or(path).display().to_string()
}

/// Makes sure that a run folder can be made later: nothing but an empty folder has its name, and files can be written beside it.
///
/// # Errors
/// A folder that holds anything, a file, or a place that cannot be written.
pub fn claim_folder(dir: &Path) -> Result<()> {
    check_free(dir)?;
    let probe = match dir.is_dir() {
        true => make_beginning(&dir.join("run")),
        false => make_beginning(dir),
    };
    probe
        .and_then(std::fs::remove_dir)
        .map_err(|error| cannot_be_made(dir, &error))
}

/// Makes the run folder and its record at once, or writes the record into an empty folder that is there, and locks it: a run that is
/// killed leaves no folder, an empty one as before, or one that can be gone on with. Of two runs that make one folder the second is
/// refused, and cannot take the lock of the first: a new folder is locked before it has its name.
///
/// # Errors
/// Those of [`claim_folder`].
pub(super) fn make_folder(dir: &Path, record: &RunRecord) -> Result<FolderLock> {
    if dir.is_dir() {
        // It may be a volume or a link, in whose place nothing can be put.
        let lock = FolderLock::take(dir)?;
        check_free(dir)?;
        record.write(dir)?;
        return Ok(lock);
    }
    check_free(dir)?;
    let begun = make_beginning(dir).map_err(|error| cannot_be_made(dir, &error))?;
    let made = FolderLock::take(&begun).and_then(|lock| {
        record.write(&begun)?;
        let renamed = std::fs::rename(&begun, dir);
        renamed.map_err(|error| check_free(dir).err().unwrap_or(cannot_be_made(dir, &error)))?;
        Ok(lock)
    });
    made.inspect_err(|_| {
        let _ = std::fs::remove_dir_all(&begun);
    })
}

/// A new folder beside a run folder that is to be, which has its place until the record is written. No one else has it: processes in two
/// containers may have one number, and a killed one may have left its own.
fn make_beginning(dir: &Path) -> std::io::Result<PathBuf> {
    if let Some(parent) = dir.parent() {
        std::fs::create_dir_all(parent)?;
    }
    let mut attempt = 0;
    loop {
        let mut name = OsString::from(".");
        name.push(dir.file_name().unwrap_or(OsStr::new("run")));
        name.push(format!(".{}.{attempt}.mhsplat-tmp", std::process::id()));
        let path = dir.with_file_name(name);
        match std::fs::create_dir(&path) {
            Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => attempt += 1,
            made => return made.map(|()| path),
        }
    }
}

fn check_free(dir: &Path) -> Result<()> {
    let free = match std::fs::read_dir(dir) {
        Ok(entries) => {
            let mut others = entries.flatten().map(|entry| entry.file_name());
            others.all(|name| name == LOCK_FILE)
        }
        Err(error) if dir.symlink_metadata().is_err() => {
            return match error.kind() == std::io::ErrorKind::NotFound {
                true => Ok(()),
                false => Err(cannot_be_made(dir, &error)),
            };
        }
        Err(_) => false,
    };
    if free {
        return Ok(());
    }
    Err(Error::input(
        dir,
        "exists already; a run never overwrites anything",
        "choose another folder with -o, or continue it with --resume",
    ))
}

fn cannot_be_made(dir: &Path, error: &std::io::Error) -> Error {
    Error::input(
        dir,
        format!("cannot be made: {error}"),
        "choose a folder that can be written with -o",
    )
}

/// Removes the folder of a run that could not begin: what such a run writes first, and nothing that anyone else may have put
/// there.
pub fn abandon_folder(dir: &Path) {
    let saved = dir.join("checkpoint");
    for folder in [dir, &saved] {
        crate::base::files::sweep(folder);
    }
    let _ = std::fs::remove_dir(saved);
    for name in [RECORD_FILE, METRICS_FILE, DENSITY_FILE, LOCK_FILE] {
        let _ = std::fs::remove_file(dir.join(name));
    }
    let _ = std::fs::remove_dir(dir);
}
