//! `density-trace.csv`: every birth, relocation and death of a run with what became of it, and the funnel made of them.

use std::path::Path;

use csv::WriterBuilder;
use serde::{Deserialize, Serialize};

use crate::base::error::{Error, Result};
use crate::density::DensityStats;
use crate::train::trace::{DensityTrace, IN_USE, Move, MoveKind};

/// Name of the table in the run folder.
pub const TRACE_FILE: &str = "density-trace.csv";

/// Counts of the Gaussians that one kind of move made.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FunnelRow {
    /// Kind of move.
    pub kind: MoveKind,
    /// Number of proposals; `None` for moves without a ratio.
    pub proposed: Option<u64>,
    /// Number of moves made.
    pub made: u64,
    /// Number of those whose Gaussian was above the opacity of the dead at the next density step.
    pub alive: u64,
    /// Number of those whose Gaussian is in use at the end.
    pub in_use: u64,
    /// Share of the blending weight of the final Gaussians that these have.
    pub share: f64,
}

/// Counts by kind, of the kinds that occur.
#[must_use]
pub fn funnel(trace: &DensityTrace, stats: &DensityStats, dead_opacity: f64) -> Vec<FunnelRow> {
    let moves = trace.moves();
    let total = trace.contribution().max(f64::MIN_POSITIVE);
    let row = |kind: MoveKind| {
        let of = || moves.iter().filter(move |m| m.kind == kind);
        let count =
            |good: fn(&Move, f64) -> bool| of().filter(|m| good(m, dead_opacity)).count() as u64;
        let weight: f64 = of().filter_map(|m| m.contribution).map(f64::from).sum();
        FunnelRow {
            kind,
            proposed: match kind {
                MoveKind::PixelBirth => Some(stats.pixel[0]),
                MoveKind::CoarseBirth => Some(stats.coarse[0]),
                MoveKind::FineBirth => Some(stats.fine[0]),
                _ => None,
            },
            made: of().count() as u64,
            alive: count(|m, dead| m.opacity_next.is_some_and(|o| f64::from(o) > dead)),
            in_use: count(|m, _| m.opacity_end.is_some_and(|o| o > IN_USE)),
            share: weight / total,
        }
    };
    let rows = MoveKind::MAKING.into_iter().map(row);
    rows.filter(|r| r.made > 0 || r.proposed.is_some_and(|n| n > 0))
        .collect()
}

/// Writes the moves as a table, an absent value as an empty cell.
///
/// # Errors
/// [`Error::Io`] if the file cannot be written.
pub fn write_trace(path: &Path, trace: &DensityTrace) -> Result<()> {
    let failed = |e: &dyn std::fmt::Display| Error::numerics(path.display().to_string(), e);
    let mut writer = WriterBuilder::new().from_writer(Vec::new());
    for one in trace.moves() {
        writer.serialize(one).map_err(|e| failed(&e))?;
    }
    let bytes = writer.into_inner().map_err(|e| failed(&e))?;
    crate::base::files::write_bytes(path, &bytes)
}
