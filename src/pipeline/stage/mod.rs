//! One file per kernel: its definition in f64 and its launcher. Shapes and units of every array are in `kernels/README.md`.

pub mod adam;
pub mod bin;
pub mod edit;
pub mod exposure;
pub mod filter;
pub mod importance;
pub mod live;
pub mod loss;
pub mod metrics;
pub mod noise;
pub mod peak;
pub mod project;
pub mod project_grad;
pub mod scan;
pub mod screen_grad;
pub mod seen;
pub mod shrink;
pub mod sort;
pub mod splat;
pub mod splat_grad;
