//! A process that trains with others and does not lead: it has no run folder, and gets everything from the leader.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::base::error::{Error, Result};
use crate::capture::{Dataset, Digests, FINGERPRINTED};
use crate::config::TrainConfig;
use crate::device::tuning::Tuning;
use crate::device::{Device, DeviceKind, sources_hash};
use crate::pipeline::buffers::ViewSet;
use crate::pipeline::photos::Photos;
use crate::ranks::{Exchange, LEADER, Part, text_of, words_of};
use crate::train::{Begun, Plan, Trainer};

/// The leader's first message to the other processes, before they train.
#[derive(Debug, Serialize, Deserialize)]
struct Beginning {
    /// Version, revision and hash of the kernels' sources.
    program: String,
    /// The dataset, and what it holds.
    dataset: PathBuf,
    copy: DatasetCopy,
    config: TrainConfig,
    /// Kind and tuning of the leader's device.
    kind: DeviceKind,
    tuning: Tuning,
    /// Decisions that belong to the whole run.
    anti_aliasing: bool,
    detail: Vec<f32>,
    clearance: Vec<f32>,
    background: [f32; 3],
    swept: Option<usize>,
    /// Highest SH degree of the first Gaussians.
    sh_degree: u32,
}

/// Identity of a copy of a dataset.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct DatasetCopy {
    fingerprint: String,
    digests: Option<Vec<u64>>,
}

impl DatasetCopy {
    /// The identity of this dataset.
    pub fn of(dataset: &Dataset) -> Self {
        let digests = dataset.digests.as_ref();
        Self {
            fingerprint: dataset.fingerprint(),
            digests: digests.map(Digests::numbers),
        }
    }

    /// The part in which the dataset here is another, in words; `None` if it is the same.
    fn difference(&self, dataset: &Dataset) -> Option<String> {
        if dataset.fingerprint() != self.fingerprint {
            return Some(FINGERPRINTED.to_owned());
        }
        match (&dataset.digests, &self.digests) {
            (Some(own), Some(other)) => own.difference(other),
            _ => None,
        }
    }
}

fn version() -> String {
    let sources = sources_hash();
    let commit = option_env!("MHSPLAT_COMMIT").unwrap_or("unknown");
    let version = env!("CARGO_PKG_VERSION");
    format!("{version} ({commit}, kernels {sources:016x})")
}

/// The message with which the leader has other processes begin.
///
/// # Errors
/// A configuration that cannot be written.
pub(super) fn beginning(
    (dataset, copy): (&Path, DatasetCopy),
    trainer: &Trainer,
    sh_degree: u32,
) -> Result<Vec<u32>> {
    let plan = trainer.plan();
    let text = serde_json::to_string(&Beginning {
        program: version(),
        dataset: std::path::absolute(dataset).unwrap_or_else(|_| dataset.to_path_buf()),
        copy,
        config: plan.config.clone(),
        kind: trainer.device_kind(),
        tuning: trainer.tuning(),
        anti_aliasing: plan.anti_aliasing.value,
        detail: plan.detail.value.clone(),
        clearance: plan.clearance.value.clone(),
        background: plan.background.value,
        swept: plan.swept,
        sh_degree,
    });
    text.map(|text| words_of(&text))
        .map_err(|e| Error::numerics("ranks", format!("the configuration cannot be sent: {e}")))
}

/// Trains with the leader of an exchange, until it ends. `load` reads a dataset, `test` refuses a device that computes wrong results.
///
/// # Errors
/// Such a device, another program or dataset than the leader's, another rank's failure, no room, or the driver's.
pub fn serve(
    exchange: &Arc<dyn Exchange>,
    device: &Device,
    load: impl FnOnce(&Path, &TrainConfig) -> Result<Dataset>,
    test: impl FnOnce(&Device) -> Result<()>,
) -> Result<()> {
    let mut got = exchange.trade(Part::Orders, vec![Vec::new(); exchange.ranks()])?;
    let wrong = |what: String| Error::numerics("program", what);
    let text = text_of(&got.swap_remove(LEADER));
    let text = text.ok_or_else(|| wrong("the leader does not say how to begin".to_owned()))?;
    let said: Beginning = serde_json::from_str(&text).map_err(|e| {
        wrong(format!(
            "it is another program than the leader, whose configuration it cannot read: {e}"
        ))
    })?;
    if said.program != version() {
        let (own, leader) = (version(), said.program);
        let what =
            format!("it is mhsplat {own}, the leader {leader}; start one program on all nodes");
        return Err(wrong(what));
    }
    let dataset = load(&said.dataset, &said.config)?;
    if let Some(other) = said.copy.difference(&dataset) {
        let what = format!("is not the same here as on the leader's node: {other}");
        let fix = "give all nodes one file system, or copies of one dataset (rsync -c)";
        return Err(Error::input(&said.dataset, what, fix));
    }
    if let Some(fault) = said.tuning.fault(device.info()) {
        let what = format!(
            "the leader's kernels cannot be built for {}: {fault}",
            device.info().name
        );
        return Err(Error::device(
            "tuning",
            what,
            "select alike devices on all nodes",
        ));
    }
    let device = device.clone().with_tuning(said.tuning);
    test(&device)?;
    let begun = Begun {
        anti_aliasing: Some(said.anti_aliasing),
        detail: Some(said.detail),
        clearance: Some(said.clearance),
        background: Some(said.background),
    };
    let dataset = dataset.as_begun(said.swept);
    let plan = Plan::begun(&dataset, &said.config, &begun)?;
    let plan = plan.led_by(said.kind).on_device(&device);
    let photos = Photos::new(&device, dataset.image_budget);
    let set = ViewSet::new(&photos, dataset.train)?;
    let strategy = plan.strategy();
    Trainer::follow(exchange, set, &plan, said.sh_degree, strategy)
}
