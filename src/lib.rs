//! Placeholder map; completed with the first working line.

pub mod buffers;
pub mod config;
pub mod dataset;
pub mod density;
pub mod error;
pub mod evaluate;
pub mod export;
pub mod gpu;
pub mod model;
pub mod plan;
pub mod reference;
pub mod render;
pub mod report;
pub mod run;
pub mod schedule;
pub mod stage;
pub mod train;
pub mod verify;
