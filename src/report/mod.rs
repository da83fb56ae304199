//! Run records, metrics and the report page: everything a run leaves behind beside the scene itself.
//!
//! | file | written by | when |
//! |---|---|---|
//! | `run.json` | [`RunRecord::write`] | at the start and at every evaluation |
//! | `metrics.csv` | [`MetricsWriter`] | one row per evaluation, flushed at once |
//! | `density.csv` | [`DensityWriter`] | one row per density step, flushed at once |
//! | `report.html` | [`write_report`] | at the end, or at any time from the three files above |
//!
//! Nothing here writes a number that is not finite: JSON has no spelling for it and a table column that sometimes holds
//! `NaN` breaks the scripts that read it. Such a value is an error that names where it was found.
//! Tests: report.

mod bars;
pub mod clock;
pub mod density_log;
pub mod figures;
pub mod folder;
pub mod gallery;
pub mod html;
pub mod loglog;
pub mod metrics;
mod panels;
pub mod record;
pub(crate) mod settings;
pub mod spread;
pub mod svg;
pub mod table;
mod ticks;

pub use clock::{Clock, Reading};
pub use density_log::{DensityRow, DensityWriter, read_density};
pub use gallery::{GalleryItem, error_map};
pub use html::write_report;
pub use metrics::{MetricsRow, MetricsWriter, read_rows};
pub use record::{
    DatasetRecord, DeviceRecord, FinalRecord, RECORD_FILE, RunRecord, StageRecord, ViewScore,
};
