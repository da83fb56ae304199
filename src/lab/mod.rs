//! The laboratory: measuring, checking and comparing. Only the command line uses it.

pub mod bench;
pub mod cache;
pub mod compare;
pub mod doctor;
pub mod error;
pub mod experiment;
pub mod folder;
pub mod report;
pub mod selftest;
pub mod stats;
pub mod surrogate;
pub mod synth;
pub mod table;
pub mod text;
pub mod tune;
pub mod verify;
