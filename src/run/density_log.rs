//! `density.csv`: one row per density step, so that the report can be made again after a resume.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::base::error::Result;
use crate::density::DensityStats;
use crate::run::table::{Row, TableWriter, read_table};

/// Name of the table in the run folder.
pub const DENSITY_FILE: &str = "density.csv";

/// Appends to `density.csv`.
pub type DensityWriter = TableWriter<DensityRow>;

/// One density step.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(from = "Cells", into = "Cells")]
pub struct DensityRow {
    /// Iteration of the step.
    pub iteration: u32,
    /// Seconds of training so far.
    pub train_seconds: f64,
    /// Number of Gaussians after the step.
    pub gaussians: u64,
    /// Counts of this step (not sums over the run); zero for those that the sampler does not have.
    pub stats: DensityStats,
}

impl Row for DensityRow {
    const COLUMNS: &'static [&'static str] = &[
        "iteration",
        "train_seconds",
        "gaussians",
        "proposed",
        "accepted",
        "relocated",
        "pruned",
        "coarse_proposed",
        "coarse_accepted",
        "fine_proposed",
        "fine_accepted",
        "occupied_voxels",
        "mean_prior",
        "cloned",
        "split",
        "opacity_resets",
        "pixel_proposed",
        "pixel_accepted",
    ];

    fn iteration(&self) -> u32 {
        self.iteration
    }
}

/// The cells of a [`DensityRow`] in the order of its columns; arrays hold neighbouring counts.
type Cells = (
    u32,
    f64,
    u64,
    [u64; 4],
    [u64; 2],
    [u64; 2],
    u64,
    f64,
    [u64; 3],
    [u64; 2],
);

impl From<DensityRow> for Cells {
    fn from(row: DensityRow) -> Self {
        let s = row.stats;
        (
            row.iteration,
            row.train_seconds,
            row.gaussians,
            [s.proposed, s.accepted, s.relocated, s.pruned],
            s.coarse,
            s.fine,
            s.occupied_voxels,
            s.mean_prior,
            [s.cloned, s.split, s.opacity_resets],
            s.pixel,
        )
    }
}

impl From<Cells> for DensityRow {
    fn from(cells: Cells) -> Self {
        let [proposed, accepted, relocated, pruned] = cells.3;
        let [cloned, split, opacity_resets] = cells.8;
        Self {
            iteration: cells.0,
            train_seconds: cells.1,
            gaussians: cells.2,
            stats: DensityStats {
                proposed,
                accepted,
                relocated,
                pruned,
                coarse: cells.4,
                fine: cells.5,
                occupied_voxels: cells.6,
                mean_prior: cells.7,
                cloned,
                split,
                opacity_resets,
                pixel: cells.9,
            },
        }
    }
}

/// All complete rows of the `density.csv` at `path`.
///
/// # Errors
/// Those of [`read_table`].
pub fn read_density(path: impl AsRef<Path>) -> Result<Vec<DensityRow>> {
    read_table(path)
}
