//! Error against run time of several runs, and which of two groups is sooner.
//!
//! Runs that differ in nothing but the seed are samples of one group. Times are interpolated between evaluations; a PSNR that
//! a run never has is "not reached", never a number. Two groups are compared run by run: by seed where they have seeds in
//! common, else in their order; there is no other notion of "sooner". Runs over other views or at another resolution are
//! refused.
//!
//! | file | content |
//! |---|---|
//! | `load.rs` | run folders, clocks |
//! | `check.rs` | refusal of runs that are not comparable |
//! | `group.rs` | runs that are samples of one setting |
//! | `curve.rs` | first crossings, bands |
//! | `thresholds.rs` | PSNR values that runs are timed to |
//! | `outcome.rs` | figures of a group |
//! | `paired.rs` | one group against another, run by run |
//! | `remarks.rs` | caveats and differences |
//! | `comparison.rs` | the whole of it |
//! | `tables.rs`, `report.rs` | tables, charts and their report |
//!
//! Tests: compare.

mod check;
mod comparison;
pub mod curve;
mod group;
mod load;
mod outcome;
mod paired;
mod remarks;
mod report;
mod tables;
pub mod thresholds;

pub use crate::lab::compare::check::ALLOW;
pub use crate::lab::compare::comparison::{Comparison, Options, compare};
pub use crate::lab::compare::group::{Group, group};
pub use crate::lab::compare::load::{Clock, Loaded, Source, finished};
pub use crate::lab::compare::outcome::{GroupOutcome, Reach, RunOutcome, Share, Target};
pub use crate::lab::compare::paired::{
    Counts, FINAL_BELOW, PairRatio, Paired, PairedTime, Verdict,
};
pub use crate::lab::compare::remarks::Difference;
pub use crate::lab::compare::report::report;
pub use crate::lab::compare::tables::{decibels, finals, relative, times};
