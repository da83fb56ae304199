//! A training run and its folder.
//!
//! | file | written by | when |
//! |---|---|---|
//! | `run.json` | [`RunRecord::write`] | at the start and at every evaluation |
//! | `metrics.csv` | [`MetricsWriter`] | one row per evaluation, flushed at once |
//! | `density.csv` | [`DensityWriter`] | one row per density step, flushed at once |
//! | `density-trace.csv` | [`density_trace::write_trace`] | at the end, with `--trace-density` |
//! | `scene.html` | [`write_scene_page`] | whenever `scene.ply` is, just before it |
//! | `scene.ply` | [`crate::scene::ply`] | at the end, and as often as `--export-every` says |
//! | `scene.spz`, … | [`crate::scene::formats`] | at the end, as `--export` says |
//! | `checkpoint/` | [`checkpoint::write`] | as often as `--checkpoint-every` says, and at the end |
//! | `report.html` | [`write_report`] | at the end, from the files above |
//!
//! No file holds a number that is not finite: JSON has no spelling for it, and a table column that sometimes holds `NaN` breaks
//! the scripts that read it. Such a value is an error that names where it was found.

mod budget;
pub mod checkpoint;
pub mod clock;
mod cost;
mod cost_meter;
pub mod density_trace;
mod drive;
mod error_model;
mod export;
mod footprint;
mod forecast;
#[cfg(test)]
mod forecast_tests;
pub mod live;
mod open;
mod patience;
mod progress;
mod rank;
pub mod record;
pub mod report;
mod start;
pub mod table;
pub mod viewer;

pub use clock::{Clock, Reading};
pub use drive::Run;
pub use open::Extension;
pub use progress::Progress;
pub use rank::serve;
pub use record::{DatasetRecord, DeviceRecord, FinalRecord, Item, PlanRecord};
pub use record::{RECORD_FILE, RunRecord, StageRecord, TrainingScores};
pub use report::gallery::{GalleryItem, error_map};
pub use report::page::write_report;
pub use start::{
    abandon_folder, claim_folder, initial_gaussians, saved_config, saved_tuning, with_points,
};
pub use table::{DENSITY_FILE, DensityRow, DensityWriter, METRICS_FILE};
pub use table::{MetricsRow, MetricsWriter, read_rows};
pub use viewer::{SCENE_PAGE, ScenePage, write_scene_page};
