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

pub mod clock;
pub mod density_log;
pub mod gallery;
pub mod html;
pub mod metrics;
mod panels;
pub mod record;
mod settings;
pub mod svg;
pub mod table;

pub use clock::{Clock, Reading};
pub use density_log::{DensityRow, DensityWriter, read_density};
pub use gallery::{GalleryItem, error_map};
pub use html::write_report;
pub use metrics::{MetricsRow, MetricsWriter, read_rows};
pub use record::{DatasetRecord, DeviceRecord, FinalRecord, RunRecord, StageRecord, ViewScore};

use crate::error::{Error, Result};
use std::io::Write;
use std::path::Path;

/// Replaces the file at `path` as a whole: a reader sees the old bytes or the new ones, never half of them.
///
/// The bytes go to a sibling that is renamed over `path`; both lie in one folder, so the rename is atomic (POSIX
/// `rename`).
///
/// # Errors
/// [`Error::Io`] when the sibling cannot be written or renamed.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> Result<()> {
    let mut name = std::ffi::OsString::from(".");
    name.push(path.file_name().unwrap_or_default());
    name.push(".tmp");
    let sibling = path.with_file_name(name);
    let written = std::fs::File::create(&sibling).and_then(|mut file| {
        file.write_all(bytes)?;
        file.sync_all()
    });
    written.map_err(|e| Error::io(&sibling, e))?;
    std::fs::rename(&sibling, path).map_err(|e| Error::io(path, e))
}
