//! Scene files and checkpoints.
