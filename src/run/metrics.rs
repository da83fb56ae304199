//! `metrics.csv`: one row per evaluation.

use std::path::Path;

use crate::base::error::Result;
use crate::run::table::{Cell, Cells, Row, TableWriter, read_table};

/// Name of the table in the run folder.
pub const METRICS_FILE: &str = "metrics.csv";

/// Appends to `metrics.csv`.
pub type MetricsWriter = TableWriter<MetricsRow>;

/// State of a run at one evaluation. Counts are sums since the start of the run.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
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

    fn cells(&self) -> Vec<Cell> {
        vec![
            Cell::Count(self.iteration.into()),
            Cell::Real(self.train_seconds),
            Cell::Real(self.wall_seconds),
            Cell::Real(self.cpu_seconds),
            Cell::Maybe(self.loss),
            Cell::Maybe(self.psnr),
            Cell::Maybe(self.ssim),
            Cell::Count(self.gaussians),
            Cell::Count(self.proposed),
            Cell::Count(self.accepted),
            Cell::Count(self.relocated),
            Cell::Count(self.pruned),
            Cell::Count(self.non_finite),
        ]
    }

    fn parse(cells: &mut Cells<'_>) -> Option<Self> {
        Some(Self {
            iteration: cells.count()?,
            train_seconds: cells.real()?,
            wall_seconds: cells.real()?,
            cpu_seconds: cells.real()?,
            loss: cells.maybe()?,
            psnr: cells.maybe()?,
            ssim: cells.maybe()?,
            gaussians: cells.count()?,
            proposed: cells.count()?,
            accepted: cells.count()?,
            relocated: cells.count()?,
            pruned: cells.count()?,
            non_finite: cells.count()?,
        })
    }
}

/// All complete rows of the `metrics.csv` at `path`.
///
/// # Errors
/// As [`read_table`].
pub fn read_rows(path: impl AsRef<Path>) -> Result<Vec<MetricsRow>> {
    read_table(path)
}
