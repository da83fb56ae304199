//! A matrix of runs (scenes × seeds × settings) within a time budget, and the comparison of each scene.
//!
//! Every run is an ordinary run folder, `OUTPUT/SCENE/SETTING/seed-N`, trained by a process of its own: time and memory are
//! those of the same command by itself. Finished runs are kept, unfinished ones go on from their
//! checkpoint. Runs come seed by seed and, of a seed, scene by scene, all settings one after the other, so that a budget that
//! ends early leaves every scene compared with fewer seeds and a slow hour of the machine meets all settings alike.
//!
//! | file | content |
//! |---|---|
//! | `file.rs` | the TOML file |
//! | `plan.rs` | runs in their order, and the state of each |
//! | `shard.rs` | the part of the runs that one of several jobs trains |
//! | `drive.rs` | runs them within the budget |
//! | `summary.rs` | the runs of each scene and all scenes side by side |
//!
//! Tests: experiment.

mod drive;
mod file;
mod plan;
mod shard;
mod summary;

pub use crate::lab::experiment::drive::{Job, Launch, Outcome, is_complete, last_error, run};
pub use crate::lab::experiment::file::{Experiment, Scene, Setting};
pub use crate::lab::experiment::plan::{Planned, State, blocks, expected, look, mine, state};
pub use crate::lab::experiment::shard::Shard;
pub use crate::lab::experiment::summary::{Against, SceneSummary, Summary, write};
