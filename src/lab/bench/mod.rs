//! Time, throughput and error of every stage on a device, beside the device's own peak.
//!
//! [`run()`] measures one device: its multiply-add and copy rates, then whole iterations of synthetic scenes of several sizes
//! (and of a trained one), then every precision and cut-off against the f64 reference. Every figure is the median of several
//! samples with their range; a ratio of fewer than [`crate::lab::stats::RATIO_SAMPLES`] samples is refused.
//!
//! CPU time is the clock to compare by on machines that others share: wall time and device time include the waiting.

mod case;
mod growth;
mod options;
mod peak;
mod precision;
pub mod record;
mod report;
mod run;
pub mod scaling;
pub mod scene;
pub mod work;

pub use crate::lab::bench::growth::growth;
pub use crate::lab::bench::options::Options;
pub use crate::lab::bench::record::{BenchRecord, Outcome};
pub use crate::lab::bench::report::{csv, json, report, write_folder};
pub use crate::lab::bench::run::{run, run_all};
pub use crate::lab::bench::work::STAGES;
