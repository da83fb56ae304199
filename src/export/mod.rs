//! Scene files and checkpoints.

pub mod checkpoint;
pub mod ply;
