//! What every room uses: errors, random numbers, files written as a whole, constants, PLY tables.

pub mod constants;
pub mod error;
pub mod files;
pub(crate) mod ply;
pub mod rng;
