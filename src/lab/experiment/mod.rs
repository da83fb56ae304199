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
//! | `drive.rs` | runs them within the budget |
//! | `scene.rs` | the runs of a scene side by side |
//! | `overview.rs` | all scenes side by side |
//! | `summary.rs` | pages and files |
//!
//! Tests: experiment.

mod drive;
mod file;
mod overview;
mod plan;
mod scene;
mod summary;

pub use crate::lab::experiment::drive::{Job, Launch, Outcome, last_error, run};
pub use crate::lab::experiment::file::{Experiment, Scene, Setting};
pub use crate::lab::experiment::overview::{Against, Overview, SceneAgainst};
pub use crate::lab::experiment::plan::{Found, Planned, State, blocks, expected, look, state};
pub use crate::lab::experiment::scene::SceneSummary;
pub use crate::lab::experiment::summary::{Summary, write};
