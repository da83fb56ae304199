//! `metrics.csv`: one row per evaluation.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::base::error::Result;
use crate::run::table::{Row, TableWriter, read_table};

/// Name of the table in the run folder.
pub const METRICS_FILE: &str = "metrics.csv";

/// Appends to `metrics.csv`.
pub type MetricsWriter = TableWriter<MetricsRow>;

/// State of a run at one evaluation. Counts are sums since the start of the run.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct MetricsRow {
    /// Iterations done.
    pub iteration: u32,
    /// Seconds of training, evaluation and export left out.
    pub train_seconds: f64,
    /// Seconds since the start.
    pub wall_seconds: f64,
    /// CPU seconds over the span of `train_seconds`.
    pub cpu_seconds: f64,
    /// Training loss; absent before the first iteration.
    pub loss: Option<f64>,
    /// Mean PSNR of the held-out views in dB; absent without such views.
    pub psnr: Option<f64>,
    /// Mean SSIM of the held-out views; absent without such views.
    pub ssim: Option<f64>,
    /// Number of Gaussians.
    pub gaussians: u64,
    /// Proposed births.
    pub proposed: u64,
    /// Accepted births.
    pub accepted: u64,
    /// Dead Gaussians moved.
    pub relocated: u64,
    /// Gaussians removed.
    pub pruned: u64,
    /// Non-finite values met (and stopped) in gradients or parameters.
    pub non_finite: u64,
}

impl Row for MetricsRow {
    const COLUMNS: &'static [&'static str] = &[
        "iteration",
        "train_seconds",
        "wall_seconds",
        "cpu_seconds",
        "loss",
        "psnr",
        "ssim",
        "gaussians",
        "proposed",
        "accepted",
        "relocated",
        "pruned",
        "non_finite",
    ];

    fn iteration(&self) -> u32 {
        self.iteration
    }
}

/// All complete rows of the `metrics.csv` at `path`.
///
/// # Errors
/// Those of [`read_table`].
pub fn read_rows(path: impl AsRef<Path>) -> Result<Vec<MetricsRow>> {
    read_table(path)
}
