//! Error against run time of several runs, and which of two groups is sooner.
//!
//! Runs that differ in nothing but the seed are samples of one group. Times are interpolated between evaluations; a PSNR that
//! a run never has is "not reached", never a number. Two groups are compared run by run, the runs of equal seeds: the ratio of
//! their times to equal PSNR is the only notion of "sooner". Runs over other views or at another resolution are refused.
//!
//! | file | content |
//! |---|---|
//! | `load.rs` | run folders, clocks, refusal of runs that are not comparable |
//! | `curve.rs` | first crossings, bands |
//! | `group.rs` | runs that are samples of one setting, and their figures |
//! | `thresholds.rs` | PSNR values that runs are timed to |
//! | `paired.rs` | one group against another, run by run |
//! | `comparison.rs` | the whole of it, with caveats and differences |
//! | `report.rs` | tables and charts |
//!
//! Tests: compare.

mod comparison;
pub mod curve;
mod group;
mod load;
mod paired;
mod report;
pub mod thresholds;

pub use crate::lab::compare::comparison::{Comparison, Difference, Options, compare};
pub use crate::lab::compare::group::{Group, Reach, Target};
pub use crate::lab::compare::load::{Clock, Loaded, Source, finished};
pub use crate::lab::compare::paired::{Counts, Paired, PairedTime};
pub use crate::lab::compare::report::{against, brief, ratios, report, reports};
