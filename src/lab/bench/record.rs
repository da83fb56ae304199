//! The document of `bench --json`, of which every table and chart is made.

use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};

use crate::base::error::Error;
use crate::device::DeviceInfo;
use crate::device::tuning::Tuning;
use crate::lab::stats::{Ratio, Spread};

/// One device, measured.
#[derive(Debug, Clone, Serialize)]
pub struct BenchRecord {
    /// Device name.
    pub device: String,
    /// Version of this package.
    pub version: String,
    /// Description by the driver.
    pub about: DeviceInfo,
    /// The device at its best.
    pub peak: Peak,
    /// One entry per scene and resolution.
    pub cases: Vec<Case>,
    /// Power laws of time and memory.
    pub growth: Vec<Growth>,
    /// Error against time of every precision, vector width, style and cut-off.
    pub precision: Vec<Precision>,
    /// Cases and parts that could not be measured.
    pub failed: Vec<Failure>,
}

/// Results of the micro-benchmarks of `kernels/peak.cl`.
#[derive(Debug, Clone, Serialize)]
pub struct Peak {
    /// Fused multiply-adds in registers, all compute units, f32: median of 10⁹ FLOP per second of device time.
    pub fma_gflops: f64,
    /// A copy far beyond any cache: median of 10⁹ bytes read and written per second of device time.
    pub copy_gbs: f64,
    /// Range and number of samples of `fma_gflops`.
    pub fma: Spread,
    /// Range and number of samples of `copy_gbs`.
    pub copy: Spread,
    /// 10⁹ FLOP per second of CPU time, that is of one core; null where the device is not the CPU.
    pub fma_core: Option<Spread>,
}

/// A scene at a resolution. Counts are means over the views.
#[derive(Debug, Clone, Serialize)]
pub struct Case {
    /// `synthetic`, or the file's name.
    pub scene: String,
    /// Gaussians.
    pub gaussians: usize,
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Sizes that its kernels were built with.
    pub tuning: Tuning,
    /// (tile, Gaussian) pairs of a view.
    pub pairs: u64,
    /// The stages, in the order of an iteration.
    pub stages: Vec<Stage>,
    /// The iteration as a whole.
    pub iteration: Iteration,
}

/// One stage of an iteration. Times are of all its launches in one iteration.
#[derive(Debug, Clone, Serialize)]
pub struct Stage {
    /// Stem of its kernel file.
    pub name: &'static str,
    /// Device time, milliseconds.
    #[serde(flatten, serialize_with = "ms")]
    pub ms: Spread,
    /// CPU time, milliseconds: device time × cores busy over the whole iteration (CPU time of the process over wall time). That is
    /// too much for a stage with launches of a single work-item and too little for one that keeps every core busy, by as much
    /// as the cores were not all busy. Null if the device is not the CPU.
    #[serde(flatten, serialize_with = "cpu_ms")]
    pub cpu_ms: Option<Spread>,
    /// Work per second, in `unit`.
    #[serde(flatten, serialize_with = "rate")]
    pub rate: Spread,
    /// `lanes/core-s` (pixel lanes evaluated per second of CPU time; of device time if the device is not the CPU) or
    /// `bytes/s` (bytes that must move, per second of device time).
    pub unit: &'static str,
    /// Share of the measured peak: FLOP of the lanes over the multiply-adds, bytes over the copy. Above 1 if data stay
    /// in a cache. Null with fewer than three samples.
    #[serde(flatten, serialize_with = "share")]
    pub share: Option<Ratio>,
}

/// A whole iteration, enqueued and settled.
#[derive(Debug, Clone, Serialize)]
pub struct Iteration {
    /// Wall time, milliseconds.
    #[serde(flatten, serialize_with = "ms")]
    pub ms: Spread,
    /// CPU time of the process (of the host alone if the device is not the CPU), milliseconds.
    #[serde(flatten, serialize_with = "some_cpu_ms")]
    pub cpu_ms: Spread,
    /// CPU time over wall time.
    #[serde(flatten, serialize_with = "cores")]
    pub cores_busy: Spread,
    /// Iterations of each sample, a multiple of the number of views.
    pub iterations: u32,
    /// Gaussians in the picture.
    pub visible: u64,
    /// Pairs looked at before every pixel of their tile was opaque.
    pub used_pairs: u64,
    /// Pixel lanes that splat evaluates, and splat_grad again.
    pub lanes: u64,
    /// Bytes of all arrays on the device, photos included.
    pub device_bytes: u64,
    /// Device bytes per Gaussian.
    pub bytes_per_gaussian: f64,
}

/// Median and range under the keys of the document, nulls of `None`.
fn keyed<S: Serializer>(
    figures: Option<[f64; 3]>,
    keys: [&'static str; 3],
    samples: Option<usize>,
    out: S,
) -> Result<S::Ok, S::Error> {
    let mut map = out.serialize_map(None)?;
    for (k, key) in keys.into_iter().enumerate() {
        map.serialize_entry(key, &figures.map(|f| f[k]))?;
    }
    if let Some(samples) = samples {
        map.serialize_entry("samples", &samples)?;
    }
    map.end()
}

fn ms<S: Serializer>(s: &Spread, out: S) -> Result<S::Ok, S::Error> {
    let keys = ["median_ms", "min_ms", "max_ms"];
    keyed(Some([s.median, s.min, s.max]), keys, Some(s.samples), out)
}

fn cpu_ms<S: Serializer>(s: &Option<Spread>, out: S) -> Result<S::Ok, S::Error> {
    let keys = ["cpu_ms", "cpu_min_ms", "cpu_max_ms"];
    keyed(s.map(|s| [s.median, s.min, s.max]), keys, None, out)
}

fn some_cpu_ms<S: Serializer>(s: &Spread, out: S) -> Result<S::Ok, S::Error> {
    cpu_ms(&Some(*s), out)
}

fn cores<S: Serializer>(s: &Spread, out: S) -> Result<S::Ok, S::Error> {
    let keys = ["cores_busy", "cores_busy_min", "cores_busy_max"];
    keyed(Some([s.median, s.min, s.max]), keys, None, out)
}

fn rate<S: Serializer>(s: &Spread, out: S) -> Result<S::Ok, S::Error> {
    let keys = ["rate", "rate_min", "rate_max"];
    keyed(Some([s.median, s.min, s.max]), keys, None, out)
}

fn share<S: Serializer>(r: &Option<Ratio>, out: S) -> Result<S::Ok, S::Error> {
    let keys = ["share_of_peak", "share_min", "share_max"];
    keyed(r.map(|r| [r.median, r.low, r.high]), keys, None, out)
}

/// A power law over some of the cases: y ∝ xᵖ.
#[derive(Debug, Clone, Serialize)]
pub struct Growth {
    /// The quantity, what it grows with, and what stays the same.
    pub what: String,
    /// Number of cases.
    pub points: usize,
    /// The exponent p and its range.
    pub exponent: Ratio,
    /// Smaller and larger x of `ratio`.
    pub between: [f64; 2],
    /// y of the larger over y of the smaller.
    pub ratio: Ratio,
}

/// Error of a stage in one variant against the f64 reference, relative to the largest wanted value, and its time.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Precision {
    /// Stem of its kernel file.
    pub stage: &'static str,
    /// Precision, vector width, style, cut-off.
    pub variant: String,
    /// Device time, milliseconds.
    #[serde(flatten, serialize_with = "ms")]
    pub ms: Spread,
    /// Largest error, with elements in which a decision at a discontinuity fell the other way.
    pub max_rel_error: f64,
    /// Median error.
    pub median_rel_error: f64,
}

/// Something that could not be measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Failure {
    /// The case or part.
    pub what: String,
    /// The reason.
    pub error: String,
}

impl Failure {
    /// The failure of `what`.
    pub(super) fn new(what: &str, error: &Error) -> Self {
        Self {
            what: what.to_owned(),
            error: error.to_string(),
        }
    }
}

/// The spread of a stage's samples; an error if there are none, or any that is no number.
pub(super) fn spread(stage: &str, samples: impl Iterator<Item = f64>) -> Result<Spread, Error> {
    let samples: Vec<f64> = samples.collect();
    let what = "no time was measured; the driver's profiling counters or the clock do not advance";
    Spread::of(&samples).ok_or_else(|| Error::numerics(stage, what))
}

/// Result of one device.
#[derive(Debug, Clone, Serialize)]
#[serde(untagged)]
pub enum Outcome {
    /// It was measured.
    Done(Box<BenchRecord>),
    /// It was not.
    Failed {
        /// Device name.
        device: String,
        /// The reason.
        error: String,
    },
}

impl Outcome {
    /// The record of a device that was measured.
    pub(super) fn record(&self) -> Option<&BenchRecord> {
        match self {
            Self::Done(record) => Some(record),
            Self::Failed { .. } => None,
        }
    }
}
