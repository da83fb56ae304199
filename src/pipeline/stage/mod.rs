//! One file per stage: its launchers, then its definition in f64. `kernels/README.md` lists shapes and units of all arrays.
//!
//! A launcher is a function that takes the stage's compiled [`crate::device::Program`], which its caller builds, and the buffers;
//! the stages with arrays of their own (sort, loss, exposure, photo_error, route) are structs. Constructors fail if the device's compiler does;
//! launches fail for arrays that are too short and on the driver's errors. A launch does not wait.
#![allow(clippy::missing_errors_doc)]

pub mod active_tiles;
pub mod adam;
pub mod bin;
pub mod edit;
pub mod exposure;
pub mod filter;
pub mod flip;
pub mod importance;
pub mod loss;
pub mod metrics;
pub mod morton;
pub mod noise;
pub mod peak;
pub mod photo_error;
pub mod project;
pub mod project_grad;
pub mod route;
pub mod scan;
pub mod screen_grad;
pub mod seen;
pub mod shrink;
pub mod sort;
pub mod splat;
pub mod splat_grad;
