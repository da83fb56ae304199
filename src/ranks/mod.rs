//! Ranks: the threads or processes that train one scene together, each with a device of its own.

pub mod exchange;
pub mod launched;
#[cfg(feature = "mpi")]
mod mpi;
mod threads;

pub use exchange::{
    Exchange, LEADER, Part, Traffic, Waits, bits_of, flags_of, text_of, to_all, to_one, words_of,
};
#[cfg(feature = "mpi")]
pub use mpi::{Patience, mpi};
pub use threads::threads;
