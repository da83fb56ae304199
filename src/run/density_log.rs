//! `density.csv`: one row per density step, so that the report can be made again after a resume.

use std::path::Path;

use crate::base::error::Result;
use crate::density::DensityStats;
use crate::run::table::{Cell, Cells, Row, TableWriter, read_table};

/// Name of the table in the run folder.
pub const DENSITY_FILE: &str = "density.csv";

/// Appends to `density.csv`.
pub type DensityWriter = TableWriter<DensityRow>;

/// One density step.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct DensityRow {
    /// Iteration of the step.
    pub iteration: u32,
    /// Seconds of training so far.
    pub train_seconds: f64,
    /// Number of Gaussians after the step.
    pub gaussians: u64,
    /// What happened in this step (not the sum over the run); what the sampler does not know is zero.
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

    fn cells(&self) -> Vec<Cell> {
        let s = &self.stats;
        vec![
            Cell::Count(self.iteration.into()),
            Cell::Real(self.train_seconds),
            Cell::Count(self.gaussians),
            Cell::Count(s.proposed),
            Cell::Count(s.accepted),
            Cell::Count(s.relocated),
            Cell::Count(s.pruned),
            Cell::Count(s.coarse[0]),
            Cell::Count(s.coarse[1]),
            Cell::Count(s.fine[0]),
            Cell::Count(s.fine[1]),
            Cell::Count(s.occupied_voxels),
            Cell::Real(s.mean_prior),
            Cell::Count(s.cloned),
            Cell::Count(s.split),
            Cell::Count(s.opacity_resets),
            Cell::Count(s.pixel[0]),
            Cell::Count(s.pixel[1]),
        ]
    }

    fn parse(cells: &mut Cells<'_>) -> Option<Self> {
        Some(Self {
            iteration: cells.count()?,
            train_seconds: cells.real()?,
            gaussians: cells.count()?,
            stats: DensityStats {
                proposed: cells.count()?,
                accepted: cells.count()?,
                relocated: cells.count()?,
                pruned: cells.count()?,
                coarse: [cells.count()?, cells.count()?],
                fine: [cells.count()?, cells.count()?],
                occupied_voxels: cells.count()?,
                mean_prior: cells.real()?,
                cloned: cells.count()?,
                split: cells.count()?,
                opacity_resets: cells.count()?,
                pixel: [cells.count()?, cells.count()?],
            },
        })
    }
}

/// All complete rows of the `density.csv` at `path`.
///
/// # Errors
/// As [`read_table`].
pub fn read_density(path: impl AsRef<Path>) -> Result<Vec<DensityRow>> {
    read_table(path)
}
