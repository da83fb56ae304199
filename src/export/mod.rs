//! Scene files and checkpoints.

pub mod checkpoint;
pub mod ply;
mod ply_header;
