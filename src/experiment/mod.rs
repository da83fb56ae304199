//! A matrix of runs (scenes × seeds × settings) within a time budget, and the comparison of each scene.
//!
//! Every run is an ordinary run folder, `OUTPUT/SCENE/SETTING/seed-N`, trained by a process of its own: what it takes and how
//! much memory it needs is what the same command takes by itself. Finished runs are kept, unfinished ones go on from their
//! checkpoint. Runs come scene by scene and seed by seed, all settings of a seed one after the other, so that a budget that
//! ends early leaves whole comparisons and a slow hour of the machine meets all settings alike.
//!
//! | file | what |
//! |---|---|
//! | `file.rs` | the TOML file |
//! | `plan.rs` | runs in their order, and what is there of each |
//! | `drive.rs` | runs them within the budget |
//! | `summary.rs` | pages and tables |
//!
//! Tests: experiment.

mod drive;
mod file;
mod plan;
mod summary;

pub use drive::{Job, Launch, Outcome, run};
pub use file::{Experiment, Scene, Setting};
pub use plan::{Planned, State, blocks, state};
pub use summary::{Summary, write};
