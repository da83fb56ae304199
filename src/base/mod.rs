//! Shared foundations: errors, random numbers, atomic files, constants, mathematics, hashes, PLY tables.

pub mod constants;
pub mod cores;
pub mod error;
pub mod files;
pub mod hash;
pub mod math;
pub(crate) mod ply;
pub mod process;
pub mod rng;
