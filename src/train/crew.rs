//! [`Crew`]: the ranks that train with the leader, and how rows and bands are divided among them.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;
use std::thread::JoinHandle;

use crate::base::error::{Error, Result};
use crate::pipeline::share::Share;
use crate::ranks::{Exchange, LEADER, Part, to_all};

/// Weight of a row of tiles in a division by bands, in pairs per tile: compositing and loss of a tile without any.
const EMPTY_TILE: u64 = 16;

/// The ranks as the leader sees them: messages, threads, pairs of views, counts.
#[derive(Debug)]
pub struct Crew {
    /// Messages to the others and from them.
    pub exchange: Arc<dyn Exchange>,
    threads: Vec<JoinHandle<()>>,
    /// The leader's part of a view, while the rows are gathered.
    pub idle: Option<Share<f32>>,
    /// Pairs of each row of tiles of a view when it was seen last, by view and number of rows.
    pairs: BTreeMap<(usize, usize), Vec<u32>>,
    /// Non-finite gradient values of the other ranks, and of before there were any.
    non_finite: Vec<u64>,
    /// False while the others may be amidst something.
    pub at_rest: bool,
}

/// Iterate: iteration, SH degree, bands. An order is the first word of a message.
pub const ITERATE: u32 = 0;
/// Take rows.
pub const SPREAD: u32 = 1;
/// Give the rows back.
pub const GATHER: u32 = 2;
/// End.
pub const END: u32 = 3;

/// Rows of a rank: even parts, one after the other.
#[must_use]
pub fn rows_of(rank: usize, ranks: usize, all: usize) -> Range<usize> {
    rank * all / ranks..(rank + 1) * all / ranks
}

/// First row of tiles of each band, and the number of rows: bands of about the same weight.
fn divide(weights: &[u64], ranks: usize) -> Vec<u32> {
    let all: u64 = weights.iter().sum();
    let mut bands = vec![0];
    let (mut row, mut before) = (0, 0);
    for rank in 1..ranks {
        let goal = all * rank as u64 / ranks as u64;
        // A row belongs to the band in which most of it lies.
        while row < weights.len() && before + weights[row] / 2 < goal {
            before += weights[row];
            row += 1;
        }
        bands.push(row as u32);
    }
    bands.push(weights.len() as u32);
    bands
}

impl Crew {
    /// The ranks of an exchange, of which these are threads.
    #[must_use]
    pub fn new(exchange: Arc<dyn Exchange>, threads: Vec<JoinHandle<()>>) -> Self {
        Self {
            non_finite: vec![0; exchange.ranks()],
            pairs: BTreeMap::new(),
            idle: None,
            at_rest: false,
            threads,
            exchange,
        }
    }

    /// Non-finite gradient values that are not among those of the leader's own rows.
    #[must_use]
    pub fn non_finite(&self) -> u64 {
        self.non_finite.iter().sum()
    }

    /// Notes the non-finite gradient values of another rank, or, for the leader, those of before there were ranks.
    pub fn note_non_finite(&mut self, rank: usize, values: u64) {
        self.non_finite[rank] = values;
    }

    /// Sends an order to all other ranks.
    ///
    /// # Errors
    /// Another rank has failed.
    pub fn order(&self, words: Vec<u32>) -> Result<()> {
        let mut messages = to_all(self.exchange.as_ref(), words);
        messages[LEADER].clear();
        self.exchange.trade(Part::Orders, messages).map(|_| ())
    }

    /// Bands of the next render of a view of so many rows of `across` tiles.
    #[must_use]
    pub fn bands(&self, view: usize, [across, rows]: [usize; 2]) -> Vec<u32> {
        let empty = EMPTY_TILE * across as u64;
        let weights = match self.pairs.get(&(view, rows)) {
            Some(pairs) => pairs.iter().map(|n| u64::from(*n) + empty).collect(),
            None => vec![empty; rows],
        };
        divide(&weights, self.exchange.ranks())
    }

    /// Notes the pairs of each row of tiles of a view, for its next bands.
    pub fn note_pairs(&mut self, view: usize, pairs: &[u32]) {
        self.pairs.insert((view, pairs.len()), pairs.to_vec());
    }
}

impl Drop for Crew {
    fn drop(&mut self) {
        // Who is amidst something would take the order for something else.
        match self.at_rest && self.order(vec![END]).is_ok() {
            true => self.exchange.end(),
            // Processes are ended by whoever tells the error.
            false if self.threads.is_empty() => {}
            false => self.exchange.fail("the leader has ended"),
        }
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

/// Words of a message that are not read yet.
#[derive(Debug)]
pub struct Words<'a>(pub &'a [u32]);

impl<'a> Words<'a> {
    /// The next words, so many of them.
    ///
    /// # Errors
    /// The message ends before.
    pub fn some(&mut self, len: usize) -> Result<&'a [u32]> {
        let (some, rest) = self
            .0
            .split_at_checked(len)
            .ok_or_else(|| Error::numerics("exchange", "a message that is too short"))?;
        self.0 = rest;
        Ok(some)
    }

    /// The next words, as an array.
    ///
    /// # Errors
    /// See [`Words::some`].
    pub fn take<const K: usize>(&mut self) -> Result<[u32; K]> {
        let mut values = [0; K];
        values.copy_from_slice(self.some(K)?);
        Ok(values)
    }
}

#[cfg(test)]
mod tests {
    use super::{divide, rows_of};

    #[test]
    fn every_row_belongs_to_one_rank() {
        for (ranks, all) in [(1, 7), (2, 7), (3, 2), (4, 1000)] {
            let rows: Vec<usize> = (0..ranks).flat_map(|r| rows_of(r, ranks, all)).collect();
            assert!(rows.into_iter().eq(0..all), "{ranks} ranks");
        }
    }

    #[test]
    fn bands_have_even_weights() {
        assert_eq!(divide(&[1; 8], 2), [0, 4, 8]);
        assert_eq!(divide(&[9, 1, 1, 1, 1, 1], 2), [0, 1, 6]);
        assert_eq!(divide(&[0, 0, 5], 2), [0, 2, 3]);
        assert_eq!(divide(&[1], 3), [0, 0, 0, 1], "bands may be empty");
        for (weights, ranks) in [(vec![3, 1, 4, 1, 5, 9, 2, 6], 3), (vec![7; 50], 16)] {
            let bands = divide(&weights, ranks);
            assert!(bands.is_sorted() && bands.len() == ranks + 1);
            assert_eq!(
                (bands[0], bands[ranks]),
                (0, u32::try_from(weights.len()).unwrap())
            );
        }
    }
}
