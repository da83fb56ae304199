//! Checkpoints: everything a run needs to continue bit for bit, as one safetensors file.
//!
//! `checkpoint/state.safetensors` holds the f32 tensors `params`, `moment1` and `moment2` \[planes, N\] (planes in the
//! order of [`crate::model::Plane`]) and, as metadata, format version, iteration, configuration, clocks and the state of
//! density control. It is written beside the old one and renamed over it.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};

use crate::config::TrainConfig;
use crate::density::DensityStats;
use crate::error::{Error, Result};
use crate::model::{Plane, Splats};
use crate::report::Reading;
use crate::train::TrainerState;

const VERSION: u32 = 1;

#[derive(Serialize, Deserialize)]
struct Header {
    version: u32,
    iteration: u32,
    sh_degree: u32,
    config: TrainConfig,
    clock: [f64; 3],
    density: serde_json::Value,
    stats: DensityStats,
    non_finite: u64,
}

/// A checkpoint read back.
#[derive(Debug, Clone)]
pub struct Checkpoint {
    /// State of the trainer.
    pub state: TrainerState,
    /// Configuration of the run.
    pub config: TrainConfig,
    /// Clocks at the time of writing.
    pub clock: Reading,
}

/// The file within a run folder.
#[must_use]
pub fn path(run_dir: &Path) -> PathBuf {
    run_dir.join("checkpoint").join("state.safetensors")
}

/// Writes a checkpoint into a run folder.
///
/// # Errors
/// [`Error::Io`] when writing fails; the previous checkpoint is then still there.
pub fn write(
    run_dir: &Path,
    state: &TrainerState,
    config: &TrainConfig,
    clock: &Reading,
) -> Result<()> {
    let file = path(run_dir);
    let folder = run_dir.join("checkpoint");
    std::fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, e))?;
    let header = Header {
        version: VERSION,
        iteration: state.iteration,
        sh_degree: state.splats.sh_degree(),
        config: config.clone(),
        clock: [clock.train_seconds, clock.wall_seconds, clock.cpu_seconds],
        density: state.density.clone(),
        stats: state.stats,
        non_finite: state.non_finite,
    };
    let encoded = |what: String| Error::Numerics {
        stage: "checkpoint".into(),
        what,
    };
    let header = serde_json::to_string(&header).map_err(|e| encoded(e.to_string()))?;
    let bytes = |planes: &[Vec<f32>]| -> Vec<u8> {
        planes
            .iter()
            .flatten()
            .flat_map(|v| v.to_le_bytes())
            .collect()
    };
    let tensors = [
        ("params", bytes(state.splats.planes())),
        ("moment1", bytes(&state.moment1)),
        ("moment2", bytes(&state.moment2)),
    ];
    let shape = vec![state.splats.planes().len(), state.splats.len()];
    let views = tensors
        .iter()
        .map(|(name, data)| {
            TensorView::new(Dtype::F32, shape.clone(), data)
                .map(|t| (*name, t))
                .map_err(|e| encoded(e.to_string()))
        })
        .collect::<Result<Vec<_>>>()?;
    let metadata = HashMap::from([("mhsplat".to_owned(), header)]);
    let data = safetensors::serialize(views, Some(metadata)).map_err(|e| encoded(e.to_string()))?;
    crate::atomic::write_bytes(&file, &data)
}

/// Reads the checkpoint of a run folder.
///
/// # Errors
/// No checkpoint, or one that is damaged or of another version.
pub fn read(run_dir: &Path) -> Result<Checkpoint> {
    let file = path(run_dir);
    let data = std::fs::read(&file).map_err(|_| {
        Error::input(
            &file,
            "no checkpoint to be read there",
            "give the folder of a run that was stopped, or start anew with -o",
        )
    })?;
    let damaged = |what: String| {
        Error::input(
            &file,
            format!("damaged checkpoint: {what}"),
            "start anew with -o NEW_FOLDER",
        )
    };
    let (_, metadata) = SafeTensors::read_metadata(&data).map_err(|e| damaged(e.to_string()))?;
    let text = metadata
        .metadata()
        .as_ref()
        .and_then(|m| m.get("mhsplat"))
        .ok_or_else(|| damaged("it was not written by mhsplat".into()))?;
    let header: Header = serde_json::from_str(text).map_err(|e| damaged(e.to_string()))?;
    if header.version != VERSION {
        return Err(damaged(format!(
            "version {}; {VERSION} expected",
            header.version
        )));
    }
    let tensors = SafeTensors::deserialize(&data).map_err(|e| damaged(e.to_string()))?;
    let planes = |name: &str| -> Result<Vec<Vec<f32>>> {
        let t = tensors.tensor(name).map_err(|e| damaged(e.to_string()))?;
        let expected = Plane::count(header.sh_degree.min(3));
        let &[rows, n] = t.shape() else {
            return Err(damaged(format!(
                "{name} has {} dimensions; 2 expected",
                t.shape().len()
            )));
        };
        if rows != expected || t.dtype() != Dtype::F32 || n == 0 {
            return Err(damaged(format!(
                "{name} is {rows} x {n}; {expected} planes of f32 expected"
            )));
        }
        Ok(t.data()
            .chunks_exact(4 * n)
            .map(|row| {
                row.chunks_exact(4)
                    .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
                    .collect()
            })
            .collect())
    };
    let splats = Splats::new(header.sh_degree, planes("params")?)?;
    let (moment1, moment2) = (planes("moment1")?, planes("moment2")?);
    if [&moment1, &moment2]
        .iter()
        .any(|m| m.iter().any(|p| p.len() != splats.len()))
    {
        return Err(damaged("moments and parameters differ in length".into()));
    }
    let [train_seconds, wall_seconds, cpu_seconds] = header.clock;
    Ok(Checkpoint {
        state: TrainerState {
            iteration: header.iteration,
            splats,
            moment1,
            moment2,
            density: header.density,
            stats: header.stats,
            non_finite: header.non_finite,
        },
        config: header.config,
        clock: Reading {
            train_seconds,
            wall_seconds,
            cpu_seconds,
        },
    })
}
