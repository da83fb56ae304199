//! `run.json`: configuration, dataset, device and results of a run.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::base::error::{Error, Result};
use crate::config::{Background, TrainConfig, from_json};
use crate::density::DensityStats;
use crate::device::tuning::Tuning;
use crate::evaluate::{Scores, ViewScore};
use crate::pipeline::photos::PhotoStats;
use crate::run::density_trace::FunnelRow;
use crate::train::Plan;
use crate::train::reasons::Part;

/// Name of the record in the run folder.
pub const RECORD_FILE: &str = "run.json";

/// The dataset of a run.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct DatasetRecord {
    /// Folder, as given.
    pub path: String,
    /// Layout found there (`colmap-bin`, `colmap-txt`, `transforms`).
    pub layout: String,
    /// Views trained on.
    pub train_views: usize,
    /// Views held out.
    pub test_views: usize,
    /// Images that the dataset names and that are not there.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub missing: Vec<String>,
    /// Images that were left out because their cameras are far from all others.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[serde(rename = "astray")]
    pub outliers: Vec<String>,
    /// Images that were left out because their masks leave no pixel of them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub masked_out: Vec<String>,
    /// Largest width of a photo as trained on, in pixels.
    pub width: u32,
    /// Largest height of a photo as trained on, in pixels.
    pub height: u32,
    /// `Dataset::fingerprint`: views, cameras, lenses, sizes, masks and split; not in records of earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fingerprint: Option<String>,
    /// `Dataset::capture_fingerprint`: names and directions of the views; not in records of earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub capture: Option<String>,
}

/// The OpenCL device of a run.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct DeviceRecord {
    /// Device name.
    pub name: String,
    /// Vendor of the device.
    pub vendor: String,
    /// OpenCL platform.
    pub platform: String,
    /// Driver version.
    pub driver: String,
    /// Compute units of the device; not in records of earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub compute_units: Option<u32>,
    /// Compute units that the run took; not in records of earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cores: Option<u32>,
    /// Devices that trained together, this one included; absent for one alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ranks: Option<usize>,
    /// Tuning of the kernels for it; not in records of earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tuning: Option<Tuning>,
}

/// A part of the work with the reason why it is kept or left out.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Item {
    /// Name of the part.
    pub what: String,
    /// Reason.
    pub why: String,
}

/// A plan in words.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct PlanRecord {
    /// Parts that are computed.
    pub kept: Vec<Item>,
    /// Parts that are not, and cost nothing.
    pub left_out: Vec<Item>,
}

impl PlanRecord {
    /// The words for a plan.
    #[must_use]
    pub fn of(plan: &Plan) -> Self {
        let mut record = Self::default();
        for (part, kept, why) in plan.parts() {
            let list = match kept {
                true => &mut record.kept,
                false => &mut record.left_out,
            };
            list.push(Item {
                what: part.to_string(),
                why: why.to_string(),
            });
        }
        record
    }

    /// Lines for the terminal: the names of the parts; with `reasons` a line for each part with its own.
    #[must_use]
    pub fn summary(&self, reasons: bool) -> Vec<String> {
        let lists = [("kept", &self.kept), ("left out", &self.left_out)];
        let line = |(label, items): (&str, &Vec<Item>)| -> Vec<String> {
            if reasons {
                let because = |i: &Item| format!("{label}: {}, because {}", i.what, i.why);
                return items.iter().map(because).collect();
            }
            let names: Vec<&str> = items.iter().map(|i| i.what.as_str()).collect();
            match names.is_empty() {
                true => Vec::new(),
                false => vec![format!("{label}: {}", names.join(", "))],
            }
        };
        lists.into_iter().flat_map(line).collect()
    }
}

/// Time spent in one stage over the run.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct StageRecord {
    /// Name of the stage (the stem of its kernel file, or a host step's name).
    pub name: String,
    /// Seconds, summed over the calls; of iterations a sample stands for all.
    pub seconds: f64,
    /// Number of calls, likewise.
    pub calls: u64,
}

/// Scores of the last evaluation.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct FinalRecord {
    /// Means over the views.
    #[serde(flatten)]
    pub mean: Scores,
    /// Scores by view, sorted by name.
    pub per_view: Vec<ViewScore>,
}

impl FinalRecord {
    /// The scores of the views with their means, each of which needs the score of every view; `None` without views.
    #[must_use]
    pub fn of(per_view: Vec<ViewScore>) -> Option<Self> {
        let mean = |score: fn(&Scores) -> Option<f64>| {
            let scores: Option<Vec<f64>> = per_view.iter().map(|v| score(&v.scores)).collect();
            let scores = scores.filter(|s| !s.is_empty())?;
            Some(scores.iter().sum::<f64>() / scores.len() as f64)
        };
        let mean = Scores {
            psnr: mean(|s| Some(s.psnr))?,
            ssim: mean(|s| Some(s.ssim))?,
            flip: mean(|s| s.flip),
            cc_psnr: mean(|s| s.cc_psnr),
            cc_ssim: mean(|s| s.cc_ssim),
        };
        Some(Self { mean, per_view })
    }
}

/// Mean scores of some training views at the end of a run.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct TrainingScores {
    /// Number of views.
    pub views: usize,
    /// PSNR in dB.
    pub psnr: f64,
    /// SSIM.
    pub ssim: f64,
}

// serde hands over a reference.
#[allow(clippy::trivially_copy_pass_by_ref)]
fn is_zero(n: &u64) -> bool {
    *n == 0
}

/// The whole of `run.json`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct RunRecord {
    /// Version of this package.
    pub version: String,
    /// Source revision it was built from, `unknown` if the build did not set it.
    pub commit: String,
    /// Every option, resolved.
    pub config: TrainConfig,
    /// Seed of every random number.
    pub seed: u64,
    /// The dataset.
    pub dataset: DatasetRecord,
    /// The device.
    pub device: DeviceRecord,
    /// Evaluations without a lower training loss that ended the run; absent if it ended otherwise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stalled: Option<u32>,
    /// True if the time budget ended the run before its planned end.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub out_of_time: bool,
    /// Kept and left-out work, with reasons.
    pub plan: PlanRecord,
    /// Iterations done.
    pub iterations: u32,
    /// First iteration from which photos have the largest size of the run; absent where all have it.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub full_size_from: u64,
    /// Background colour of the scores, RGB in \[0, 1\]; absent in records of earlier versions, whose runs had the one that the configuration names.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub background: Option<[f32; 3]>,
    /// Number of Gaussians.
    pub gaussians: u64,
    /// Gaussians that were removed at the end, because no training view sees them; not among `gaussians`.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub removed: u64,
    /// Seconds of training, evaluation and export left out.
    pub train_seconds: f64,
    /// Seconds since the start.
    pub wall_seconds: f64,
    /// CPU seconds over the span of `train_seconds`; 0 if the system does not report it.
    pub cpu_seconds: f64,
    /// Largest resident set in bytes; 0 if the system does not report it.
    pub peak_rss_bytes: u64,
    /// Waiting for photos, and the use of their budget.
    #[serde(default)]
    pub photos: PhotoStats,
    /// Time by stage, in the order of the pipeline.
    pub stages: Vec<StageRecord>,
    /// Density control, summed over the run.
    pub density: DensityStats,
    /// What `scene.html` leaves out, in sentences; none if that is nothing.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub remarks: Vec<String>,
    /// Counts and fates of the Gaussians that each kind of move made; empty unless the run was traced.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub funnel: Vec<FunnelRow>,
    /// Scores of the last evaluation; absent before it and without held-out views.
    #[serde(rename = "final")]
    pub final_scores: Option<FinalRecord>,
    /// Scores of some training views at the end of a session; absent where exposure is compensated, which gives each of them a colour of its own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub training: Option<TrainingScores>,
}

impl RunRecord {
    /// True if the run came to an end that was planned: its iterations, its time or its patience.
    #[must_use]
    pub fn ended(&self) -> bool {
        let whole = self.iterations >= self.config.last_iterations();
        whole || self.out_of_time || self.stalled.is_some()
    }

    /// Background colour of the scores, RGB in \[0, 1\].
    #[must_use]
    pub fn background(&self) -> [f32; 3] {
        self.background.unwrap_or(self.config.background.named())
    }

    /// The record of a run that has not begun.
    ///
    /// The revision is that of the variable `MHSPLAT_COMMIT` at build time, else that of the package or the Git checkout (`build.rs`).
    #[must_use]
    pub fn new(
        config: TrainConfig,
        dataset: DatasetRecord,
        device: DeviceRecord,
        plan: PlanRecord,
    ) -> Self {
        Self {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            commit: option_env!("MHSPLAT_COMMIT")
                .unwrap_or("unknown")
                .to_owned(),
            seed: config.seed,
            config,
            dataset,
            device,
            plan,
            ..Self::default()
        }
    }

    /// The record as indented JSON.
    ///
    /// # Errors
    /// [`Error::Numerics`] when a number is not finite.
    pub fn to_json(&self) -> Result<String> {
        let numerics = |what: String| Error::numerics(RECORD_FILE, what);
        let scores = self.final_scores.iter();
        let scores = scores.flat_map(|f| f.per_view.iter().map(|v| &v.scores).chain([&f.mean]));
        let training = self.training.map_or([0.0; 2], |t| [t.psnr, t.ssim]);
        let mut numbers = scores.flat_map(Scores::named).chain([
            ("training.psnr", Some(training[0])),
            ("training.ssim", Some(training[1])),
            ("time-budget", self.config.time_budget),
            ("budget-cpu", self.config.budget_cpu),
        ]);
        let bad = numbers.find_map(|(name, v)| Some((name, v.filter(|v| !v.is_finite())?)));
        if let Some((name, value)) = bad {
            return Err(numerics(format!("{name} is {value}")));
        }
        let text = serde_json::to_string_pretty(self).map_err(|e| numerics(e.to_string()))?;
        // serde_json spells NaN and infinity `null`, and no number reads back from that: what cannot be read back as it
        // was written is refused, with the line that shows the field. (An optional number would, and scores have no line: hence the check above.)
        if let Err(error) = serde_json::from_str::<Self>(&text) {
            let line = text.lines().nth(error.line().saturating_sub(1));
            return Err(numerics(format!(
                "a number is not finite: `{}`",
                line.unwrap_or_default().trim()
            )));
        }
        Ok(text)
    }

    /// Writes `run.json` into `run_dir`, replacing it as a whole.
    ///
    /// # Errors
    /// [`Error::Numerics`] when a number is not finite (the file stays as it was), [`Error::Io`] when writing fails.
    pub fn write(&self, run_dir: impl AsRef<Path>) -> Result<()> {
        let mut text = self.to_json()?;
        text.push('\n');
        crate::base::files::write_bytes(&run_dir.as_ref().join(RECORD_FILE), text.as_bytes())
    }

    /// Reads `run.json` of `run_dir`.
    ///
    /// # Errors
    /// [`Error::Io`] when it cannot be read, [`Error::Input`] when it is not such a record.
    pub fn read(run_dir: impl AsRef<Path>) -> Result<Self> {
        let path = run_dir.as_ref().join(RECORD_FILE);
        let text = std::fs::read_to_string(&path).map_err(|e| Error::io(&path, e))?;
        let read = from_json(&text).or_else(|e| without_retired(&text).ok_or(e));
        let read = read.map(|record: Self| record.without_later_options(&text));
        read.map_err(|e| {
            let fix = "give a folder that `mhsplat train` wrote with this version";
            Error::input(&path, format!("not a run record: {e}"), fix)
        })
    }
}

impl RunRecord {
    /// The record with options off that its text does not name, because the run was made by an earlier version.
    fn without_later_options(mut self, text: &str) -> Self {
        if let Ok(value) = serde_json::from_str(text) {
            without_later_options(&value, &mut self.config);
        }
        self
    }
}

/// Switches the options of a run off that its record does not name, because an earlier version made it: such runs kept no space about the cameras
/// free, and those of opaque photos without masks were over black, as a run is that began as one of these. What is no record of a run has none that are later.
pub fn without_later_options(record: &serde_json::Value, config: &mut TrainConfig) {
    let Some(named) = record.get("config").and_then(serde_json::Value::as_object) else {
        return;
    };
    if record.get("version").is_none() {
        return;
    }
    if !named.contains_key("clearance") {
        config.clearance = 0.0;
    }
    let left_out = record["plan"]["left_out"].as_array();
    let lacks = |part: Part| {
        let is = |item: &serde_json::Value| item["what"] == part.to_string();
        left_out.is_some_and(|items| items.iter().any(is))
    };
    let opaque = lacks(Part::Transparency) && lacks(Part::Masks);
    let black = |color: &serde_json::Value| *color == serde_json::json!([0.0, 0.0, 0.0]);
    let over_black = record.get("background").is_none_or(black);
    if over_black && opaque && config.background == Background::Auto {
        config.background = Background::Black;
    }
}

/// Settings that records of earlier versions name and this one does not know any more. They say how a run was made, and nothing of what
/// became of it.
const RETIRED: [[&str; 3]; 2] = [
    ["config", "work", "resolution-interval"],
    ["device", "tuning", "update-block"],
];

/// The record in a text that names [`RETIRED`] settings; `None` if it names none, or there is more that is unknown in it.
fn without_retired(text: &str) -> Option<RunRecord> {
    let mut record: serde_json::Value = serde_json::from_str(text).ok()?;
    let mut found = false;
    for [part, group, name] in RETIRED {
        let group = record.get_mut(part).and_then(|part| part.get_mut(group));
        let group = group.and_then(|group| group.as_object_mut());
        found |= group.is_some_and(|group| group.remove(name).is_some());
    }
    if !found {
        return None;
    }
    serde_json::from_value(record).ok()
}
