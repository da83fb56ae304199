//! Ranks: the threads or processes that train one scene together, each with a device of its own.

mod threads;

use std::fmt::Debug;

use crate::base::error::Result;

pub use threads::threads;

/// The rank that leads: it takes the decisions and has the run's folder.
pub const LEADER: usize = 0;

/// Messages between ranks. All of them make the same calls in the same order.
pub trait Exchange: Debug + Send + Sync {
    /// Number of this rank.
    fn rank(&self) -> usize;

    /// Number of ranks.
    fn ranks(&self) -> usize;

    /// Sends a message to each rank, this one included, and waits for one from each: those for and from rank r stand at r.
    ///
    /// # Errors
    /// Another rank has failed, or is gone.
    fn trade(&self, messages: Vec<Vec<u32>>) -> Result<Vec<Vec<u32>>>;

    /// Tells the others that this rank cannot go on: what they trade from now on fails with this text.
    fn fail(&self, why: &str);
}

/// One message for each rank.
#[must_use]
pub fn to_all(exchange: &dyn Exchange, message: Vec<u32>) -> Vec<Vec<u32>> {
    vec![message; exchange.ranks()]
}

/// A message for one rank, none for the others.
#[must_use]
pub fn to_one(exchange: &dyn Exchange, rank: usize, message: Vec<u32>) -> Vec<Vec<u32>> {
    let mut all = vec![Vec::new(); exchange.ranks()];
    all[rank] = message;
    all
}
