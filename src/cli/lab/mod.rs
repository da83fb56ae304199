//! Commands that measure, check and compare.

pub mod bench;
pub mod compare;
pub mod experiment;
pub mod surrogate;
pub mod synth;
pub mod verify;
