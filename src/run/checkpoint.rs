//! Checkpoints: everything a run needs to continue bit for bit, as one safetensors file.
//!
//! `checkpoint/state.safetensors` holds the f32 tensors `params`, `moment1` and `moment2` \[planes, N\] (planes in the
//! order of [`crate::scene::Plane`]), `cues` \[rows, N\] (where the sampler has any), `filter` \[N\] (with anti-aliasing),
//! `exposures` \[3, 12 · views\] (with per-image exposure), `gradients` \[planes, N\] (amidst a batch of views), `edits` \[13, edits\] and `removed` (of a density step under way) and `losses` \[2 · ring\] and, as metadata, format version,
//! fingerprint of the dataset, iteration, configuration, clocks, stage times and tuning, with a checksum of all that. It is
//! written beside the old one and renamed over it.

use std::collections::HashMap;
use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};

use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};

use crate::base::error::{Error, Result};
use crate::config::{TrainConfig, from_json};
use crate::density;
use crate::density::DensityStats;
use crate::device::tuning::Tuning;
use crate::run::clock::Reading;
use crate::run::record::StageRecord;
use crate::scene::{Edit, Gaussians, Plane};
use crate::train::GaussianRows;
use crate::train::{Learned, Next, PendingStep, TrainerState};

const VERSION: u32 = 11;

/// Tensors in the order of the checksum.
const NAMES: [&str; 10] = [
    "params",
    "moment1",
    "moment2",
    "losses",
    "cues",
    "filter",
    "exposures",
    "edits",
    "removed",
    "gradients",
];

/// Number of the first of them, which are there even without a value.
const ALWAYS: usize = 4;

/// Name of the entry of the file's metadata that holds the header.
const ENTRY: &str = "mhsplat";

const NOT_OURS: &str = "it was not written by mhsplat";

/// Beginning of a safetensors file after its length: all that is read without the tensors.
#[derive(Deserialize)]
struct Beginning {
    #[serde(rename = "__metadata__", default)]
    entries: HashMap<String, String>,
}

/// First entry of the header, in every version.
#[derive(Deserialize)]
struct Version {
    version: u32,
}

#[derive(Serialize, Deserialize)]
struct Header {
    version: u32,
    iteration: u32,
    next: Next,
    /// Absent unless one is under way.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    deciding: Option<PendingStep>,
    detail: Vec<f32>,
    /// Absent in earlier versions, whose runs had none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    clearance: Option<Vec<f32>>,
    /// Absent in earlier versions, whose runs had the one that the configuration names.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    background: Option<[f32; 3]>,
    /// [`TrainerState::swept`]; absent if none were looked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    swept: Option<usize>,
    sh_degree: u32,
    config: TrainConfig,
    clock: [f64; 3],
    /// Absent in earlier versions.
    #[serde(default)]
    all_cpu_seconds: f64,
    stats: DensityStats,
    non_finite: u64,
    learned: Learned,
    dataset: String,
    tuning: Tuning,
    stages: Vec<StageRecord>,
}

/// A checkpoint, to be written or read back.
#[derive(Debug, Clone)]
pub struct Checkpoint {
    /// State of the trainer.
    pub state: TrainerState,
    /// Configuration of the run.
    pub config: TrainConfig,
    /// Clocks at the time of writing.
    pub clock: Reading,
    /// [`crate::capture::Dataset::fingerprint`] of what it was trained on.
    pub dataset: String,
    /// Sizes that the kernels were built for: the last bits depend on them.
    pub tuning: Tuning,
    /// Seconds per stage so far.
    pub stages: Vec<StageRecord>,
}

/// The file within a run folder.
#[must_use]
pub fn path(run_dir: &Path) -> PathBuf {
    run_dir.join("checkpoint").join("state.safetensors")
}

fn encoding(what: impl std::fmt::Display) -> Error {
    Error::numerics("checkpoint", what)
}

/// Writes a checkpoint into a run folder.
///
/// # Errors
/// [`Error::Io`] when writing fails; the previous checkpoint is then still there.
pub fn write(run_dir: &Path, checkpoint: &Checkpoint) -> Result<()> {
    let file = path(run_dir);
    let folder = run_dir.join("checkpoint");
    std::fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, e))?;
    let (state, clock) = (&checkpoint.state, &checkpoint.clock);
    let header = Header {
        version: VERSION,
        iteration: state.iteration,
        next: state.next,
        deciding: state.deciding.clone(),
        detail: state.detail.clone(),
        clearance: Some(state.clearance.clone()),
        background: Some(state.background),
        swept: state.swept,
        sh_degree: state.splats.sh_degree(),
        config: checkpoint.config.clone(),
        clock: [clock.train_seconds, clock.wall_seconds, clock.cpu_seconds],
        all_cpu_seconds: clock.all_cpu_seconds,
        stats: state.stats,
        non_finite: state.non_finite,
        learned: state.learned,
        dataset: checkpoint.dataset.clone(),
        tuning: checkpoint.tuning,
        stages: checkpoint.stages.clone(),
    };
    let header = serde_json::to_string(&header).map_err(encoding)?;
    let one = std::slice::from_ref;
    let (splats, rows) = (state.splats.planes(), &state.rows);
    let (edits, removed) = state.deciding.as_ref().map_or_else(Default::default, bits);
    let values = [
        splats,
        &rows.moment1,
        &rows.moment2,
        one(&state.losses),
        &rows.statistics,
        one(&rows.filter),
        &state.exposures,
        &edits,
        one(&removed),
        &rows.gradients,
    ];
    let tensors = NAMES
        .iter()
        .zip(values)
        .enumerate()
        .filter_map(|(k, (name, rows))| {
            let count = rows.first().map_or(0, Vec::len);
            let shape = match *name {
                "losses" | "filter" | "removed" => vec![count],
                _ => vec![rows.len(), count],
            };
            let bytes = rows.iter().flatten().flat_map(|v| v.to_le_bytes());
            let there = count > 0 || k < ALWAYS;
            there.then(|| (name, shape, bytes.collect::<Vec<u8>>()))
        });
    let tensors: Vec<_> = tensors.collect();
    let parts = tensors.iter().map(|(_, _, data)| data.as_slice());
    let sum = checksum(&header, parts);
    let views = tensors
        .iter()
        .map(|(name, shape, data)| {
            let view = TensorView::new(Dtype::F32, shape.clone(), data);
            view.map(|t| (**name, t)).map_err(encoding)
        })
        .collect::<Result<Vec<_>>>()?;
    let metadata = HashMap::from([(ENTRY.to_owned(), header), ("crc32".to_owned(), sum)]);
    let data = safetensors::serialize(views, Some(metadata)).map_err(encoding)?;
    crate::base::files::write_bytes(&file, &data)
}

/// Numbers of an edit.
const EDIT: usize = 13;

/// Edits \[[`EDIT`], edits\] and removed rows of a step; integers are in the bits of the numbers.
fn bits(step: &PendingStep) -> (Vec<Vec<f32>>, Vec<f32>) {
    let rows: Vec<[f32; EDIT]> = step.edits.iter().map(Edit::to_bits).collect();
    let edits = (0..EDIT).map(|k| rows.iter().map(|row| row[k]).collect());
    let removed = step.removed.iter().map(|row| f32::from_bits(*row));
    (edits.collect(), removed.collect())
}

/// The step of a checkpoint with the edits and removed rows of its tensors.
fn pending(
    step: PendingStep,
    tensors: &SafeTensors<'_>,
    count: usize,
) -> std::result::Result<PendingStep, String> {
    let read = |name, rows| match tensors.tensor(name) {
        Ok(_) => planes(tensors, name, rows, None),
        Err(_) => Ok(vec![Vec::new(); rows]),
    };
    let (rows, removed) = (read("edits", EDIT)?, read("removed", 1)?);
    let edit = |i: usize| Edit::of_bits(&std::array::from_fn(|k| rows[k][i]));
    let step = PendingStep {
        edits: (0..rows[0].len()).map(edit).collect(),
        removed: removed[0].iter().map(|row| row.to_bits()).collect(),
        ..step
    };
    match step.fits(count) {
        true => Ok(step),
        false => Err("the density step under way is of another scene".into()),
    }
}

/// CRC-32 of the header and the tensors, eight hexadecimal digits.
fn checksum<'a>(header: &str, tensors: impl Iterator<Item = &'a [u8]>) -> String {
    let mut sum = crc32fast::Hasher::new();
    sum.update(header.as_bytes());
    tensors.for_each(|t| sum.update(t));
    format!("{:08x}", sum.finalize())
}

/// Reads the checkpoint of a run folder.
///
/// # Errors
/// No checkpoint, or one that is damaged or of another version.
pub fn read(run_dir: &Path) -> Result<Checkpoint> {
    let file = path(run_dir);
    let data = std::fs::read(&file).map_err(|_| none(&file))?;
    parse(&data).map_err(|what| damaged(&file, &what))
}

/// Reads the configuration from the checkpoint of a run folder, and of the file no more than it needs for that: damage elsewhere is found by [`read`].
///
/// # Errors
/// No checkpoint, or one with a damaged header or of another version.
pub fn read_config(run_dir: &Path) -> Result<TrainConfig> {
    let file = path(run_dir);
    let beginning = || -> std::io::Result<Vec<u8>> {
        let (mut opened, mut length, mut data) = (File::open(&file)?, [0; 8], Vec::new());
        opened.read_exact(&mut length)?;
        opened
            .take(u64::from_le_bytes(length))
            .read_to_end(&mut data)?;
        Ok(data)
    };
    let text = |e: &dyn std::fmt::Display| damaged(&file, &e.to_string());
    let data = beginning().map_err(|e| match e.kind() {
        ErrorKind::UnexpectedEof => text(&e),
        _ => none(&file),
    })?;
    let beginning: Beginning = serde_json::from_slice(&data).map_err(|e| text(&e))?;
    let written = beginning
        .entries
        .get(ENTRY)
        .ok_or_else(|| text(&NOT_OURS))?;
    check_version(written).map_err(|e| text(&e))?;
    let header = header(written).map_err(|e| text(&e))?;
    Ok(header.config)
}

/// The header from its text. What runs of earlier versions did not have is off in their configuration.
fn header(written: &str) -> std::result::Result<Header, String> {
    let mut header: Header = from_json(written)?;
    if header.clearance.is_none() {
        header.config.clearance = 0.0;
    }
    Ok(header)
}

/// Refuses the header of another version.
fn check_version(written: &str) -> std::result::Result<(), String> {
    let found: Version = serde_json::from_str(written).map_err(|e| e.to_string())?;
    match found.version {
        VERSION => Ok(()),
        other => Err(format!("version {other}; {VERSION} expected")),
    }
}

fn none(file: &Path) -> Error {
    let fix = "give the folder of a run that was stopped, or start anew with -o";
    Error::input(file, "no checkpoint to be read there", fix)
}

fn damaged(file: &Path, what: &str) -> Error {
    let fix = "start anew with -o NEW_FOLDER";
    Error::input(file, format!("damaged checkpoint: {what}"), fix)
}

/// A checkpoint from the bytes of its file, or what is wrong with them.
fn parse(data: &[u8]) -> std::result::Result<Checkpoint, String> {
    let text = |e: &dyn std::fmt::Display| e.to_string();
    let (_, metadata) = SafeTensors::read_metadata(data).map_err(|e| text(&e))?;
    let entry = |name: &str| metadata.metadata().as_ref().and_then(|m| m.get(name));
    let written = entry(ENTRY).ok_or(NOT_OURS)?;
    check_version(written)?;
    let tensors = SafeTensors::deserialize(data).map_err(|e| text(&e))?;
    let parts = NAMES.iter().filter_map(|n| tensors.tensor(n).ok());
    if entry("crc32") != Some(&checksum(written, parts.map(|t| t.data()))) {
        return Err("its checksum is wrong".into());
    }
    let header = header(written)?;
    let expected = Plane::count(header.sh_degree.min(3));
    let read = |name, rows, columns| planes(&tensors, name, rows, columns);
    let params = read("params", expected, None)?;
    let splats = Gaussians::new(header.sh_degree, params).map_err(|e| text(&e))?;
    let beside = |name, rows| read(name, rows, Some(splats.len()));
    let has = |name| tensors.tensor(name).is_ok();
    let (moment1, moment2) = (beside("moment1", expected)?, beside("moment2", expected)?);
    let statistics = match density::make(&header.config).wanted(1, 1.0).rows() {
        0 => Vec::new(),
        rows => beside("cues", rows)?,
    };
    let filter = match has("filter") {
        true => beside("filter", 1)?.concat(),
        false => Vec::new(),
    };
    let exposures = match has("exposures") {
        true => read("exposures", 3, None)?,
        false => Vec::new(),
    };
    let gradients = match has("gradients") {
        true => beside("gradients", expected)?,
        false => Vec::new(),
    };
    let losses = read("losses", 1, None)?.concat();
    let deciding = header
        .deciding
        .map(|step| pending(step, &tensors, splats.len()));
    let deciding = deciding.transpose()?;
    let [train_seconds, wall_seconds, cpu_seconds] = header.clock;
    let named = header.config.background.named();
    let background = header.background.unwrap_or(named);
    if !background.iter().all(|v| (0.0..=1.0).contains(v)) {
        return Err(format!("background {background:?}; 0 to 1 expected"));
    }
    Ok(Checkpoint {
        state: TrainerState {
            iteration: header.iteration,
            next: header.next,
            deciding,
            detail: header.detail,
            clearance: header.clearance.unwrap_or_default(),
            background,
            swept: header.swept,
            splats,
            rows: GaussianRows {
                moment1,
                moment2,
                statistics,
                filter,
                gradients,
            },
            stats: header.stats,
            non_finite: header.non_finite,
            learned: header.learned,
            losses,
            exposures,
        },
        config: header.config,
        clock: Reading {
            train_seconds,
            wall_seconds,
            cpu_seconds,
            all_cpu_seconds: header.all_cpu_seconds,
        },
        dataset: header.dataset,
        tuning: header.tuning,
        stages: header.stages,
    })
}

/// The rows of an f32 tensor, each with `columns` values if that is given; one of a single dimension is one row.
fn planes(
    tensors: &SafeTensors<'_>,
    name: &str,
    expected: usize,
    columns: Option<usize>,
) -> std::result::Result<Vec<Vec<f32>>, String> {
    let t = tensors.tensor(name).map_err(|e| e.to_string())?;
    let (rows, n) = match *t.shape() {
        [rows, n] => (rows, n),
        [n] => (1, n),
        _ => return Err(format!("{name} has {} dimensions", t.shape().len())),
    };
    if rows != expected || t.dtype() != Dtype::F32 || n == 0 {
        return Err(format!(
            "{name} is {rows} x {n}; {expected} planes of f32 expected"
        ));
    }
    if columns.is_some_and(|columns| columns != n) {
        return Err(format!("{name} and parameters differ in length"));
    }
    let row = |row: &[u8]| {
        row.chunks_exact(4)
            .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
            .collect()
    };
    Ok(t.data().chunks_exact(4 * n).map(row).collect())
}
