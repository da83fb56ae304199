//! Placeholder map; completed with the first working line.

pub mod config;
pub mod dataset;
pub mod density;
pub mod error;
pub mod export;
pub mod model;
pub mod reference;
pub mod report;
