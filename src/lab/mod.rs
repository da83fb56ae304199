//! Evidence: what measures, checks and compares. Nothing but the command line uses it.

pub mod bench;
pub mod cache;
pub mod compare;
pub mod error;
pub mod experiment;
pub mod folder;
pub mod page;
pub mod selftest;
pub mod stats;
pub mod surrogate;
pub mod synth;
pub mod table;
pub mod tune;
pub mod verify;
