//! Every stage on a device against the f64 reference: error and time.
//!
//! Each case goes through the reference, through the kernels in f64 (where the device has it; this finds wrong formulas)
//! and through the kernels in f32 (rounding alone).

pub mod cases;
pub mod check;
pub mod definition;
pub mod page;
pub mod pass;
pub mod stress;
mod suite;

pub use check::{FamilyNote, Verification};
pub use suite::{quick, tiny, verify_case};
