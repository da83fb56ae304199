//! [`Crew`]: the ranks that train with the leader, and how rows and bands are divided among them.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;
use std::thread::JoinHandle;

use crate::base::error::{Error, Result};
use crate::config::{Length, TrainingSize};
use crate::device::ImageSize;
use crate::pipeline::share::{Share, Worked};
use crate::ranks::{Exchange, LEADER, Part, to_all};

/// Time of the loss of so many pixels in a division by bands, in times of finding and sorting a pair; by the stages of 500,000 Gaussians at
/// 800 px on a CPU, and so for the next: 96 of a tile of 16 pixels a side, 400 of one of 32.
const LOSS_WORK: [u64; 2] = [8, 3];
/// Time of compositing a pair and of its gradient, in the same (2.3 in tiles of 32 pixels).
const USED_PAIR_WORK: u64 = 3;

/// The ranks as the leader sees them: messages, threads, pairs of views, counts.
#[derive(Debug)]
pub struct Crew {
    /// Messages to the others and from them.
    pub exchange: Arc<dyn Exchange>,
    threads: Vec<JoinHandle<()>>,
    /// The leader's part of a view, while the rows are gathered.
    pub idle: Option<Share<f32>>,
    /// Pairs of each row of tiles of a view when it was seen last, and those that were looked at, by view and number of rows.
    pairs: BTreeMap<(usize, usize), Vec<[u32; 2]>>,
    /// Parts of the ranks in the rows of the Gaussians.
    row_parts: Parts,
    /// Parts of the ranks in the rows of tiles.
    band_parts: Parts,
    /// Seconds that each rank worked on its rows since they were divided.
    worked_on_rows: Vec<f64>,
    /// Seconds that a rank has worked on its rows and on its band so far, in the mean.
    worked: [f64; 2],
    /// CPU seconds of the processes of other ranks, and those of them before training.
    process_seconds: [f64; 2],
    /// First row of each rank, and the number of all, when they were divided last.
    rows: Vec<usize>,
    /// Non-finite gradient values of the other ranks.
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
/// Begin a density step: iterations done.
pub const DECIDE: u32 = 4;
/// End a density step: iterations done, first rows of the ranks afterwards and the number of all, maybe the decision.
pub const EDIT: u32 = 5;
/// Raise the SH degree: the new one.
pub const RAISE: u32 = 6;
/// Go by another length of the run: see [`words_of_length`].
pub const LENGTH: u32 = 7;
/// Compile the kernels of exposure compensation: the iteration that it begins with.
pub const EXPOSE: u32 = 8;
/// Render a view: background, camera.
pub const LOOK: u32 = 9;
/// Tell which rows any training view shows.
pub const SEEN: u32 = 10;
/// Keep some rows: first rows of the ranks and the number of all, before and afterwards, and flags of those that are kept.
pub const KEEP: u32 = 11;
/// Tell how many gradient values were not finite.
pub const COUNT: u32 = 12;
/// Compute the smoothing filter.
pub const SMOOTH: u32 = 13;

/// Gain of a step of the bands towards even times, after every view.
const BAND_GAIN: f64 = 0.1;
/// The same of the rows, when they are divided.
const ROW_GAIN: f64 = 0.5;
/// Least share of a rank, as a part of an even one: it goes on being measured.
const LEAST_PART: f64 = 0.02;

/// Shares of the ranks in a work, above 0, with the sum 1.
#[derive(Debug, Clone, PartialEq)]
struct Parts(Vec<f64>);

impl Parts {
    fn even(ranks: usize) -> Self {
        Self(vec![1.0 / ranks.max(1) as f64; ranks])
    }

    /// Steps towards shares that take all ranks the same time, from the seconds that the present ones took. One view that took a rank
    /// long for another reason changes little.
    fn level(&mut self, seconds: &[f64], gain: f64) {
        let mean = seconds.iter().sum::<f64>() / seconds.len().max(1) as f64;
        if !(mean > 0.0 && mean.is_finite()) {
            return;
        }
        let least = LEAST_PART / self.0.len() as f64;
        for (part, seconds) in self.0.iter_mut().zip(seconds) {
            let ratio = (mean / seconds).clamp(0.5, 2.0);
            *part = (*part * ratio.powf(gain)).max(least);
        }
        let sum: f64 = self.0.iter().sum();
        self.0.iter_mut().for_each(|part| *part /= sum);
    }

    /// Sum of the shares before each rank, and 1.
    fn ends(&self) -> Vec<f64> {
        let mut before = 0.0;
        let mut ends = vec![0.0];
        ends.extend(self.0.iter().map(|part| {
            before += part;
            before
        }));
        // Rounding must not lose a row.
        ends.pop();
        ends.push(1.0);
        ends
    }

    /// First row of each rank, and the number of all: parts that lie one after the other.
    fn rows(&self, all: usize) -> Vec<usize> {
        let at = |end: f64| (end * all as f64).round() as usize;
        self.ends().into_iter().map(at).collect()
    }

    /// First row of tiles of each band, and the number of rows: bands whose weights have these shares.
    fn bands(&self, weights: &[u64]) -> Vec<u32> {
        let all = weights.iter().sum::<u64>() as f64;
        let (ends, mut bands) = (self.ends(), vec![0]);
        let (mut row, mut before) = (0, 0.0);
        for end in &ends[1..self.0.len()] {
            // A row belongs to the band in which most of it lies.
            while row < weights.len() && before + weights[row] as f64 / 2.0 < all * end {
                before += weights[row] as f64;
                row += 1;
            }
            bands.push(row as u32);
        }
        bands.push(weights.len() as u32);
        bands
    }
}

impl Crew {
    /// The ranks of an exchange, of which these are threads.
    #[must_use]
    pub fn new(exchange: Arc<dyn Exchange>, threads: Vec<JoinHandle<()>>) -> Self {
        Self {
            non_finite: vec![0; exchange.ranks()],
            row_parts: Parts::even(exchange.ranks()),
            band_parts: Parts::even(exchange.ranks()),
            worked_on_rows: vec![0.0; exchange.ranks()],
            worked: [0.0; 2],
            process_seconds: [0.0; 2],
            rows: Vec::new(),
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

    /// CPU seconds of the processes of other ranks so far, without those of building and trying the kernels.
    #[must_use]
    pub fn process_seconds(&self) -> f64 {
        self.process_seconds[0] - self.process_seconds[1]
    }

    /// Seconds that a rank has worked on its rows and on its band so far, in the mean.
    #[must_use]
    pub fn worked(&self) -> [f64; 2] {
        self.worked
    }

    /// Notes the non-finite gradient values of another rank.
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

    /// Bands of the next render of a view of this size.
    #[must_use]
    pub fn bands(&self, view: usize, size: ImageSize) -> Vec<u32> {
        let (rows, [pixels, work]) = (size.tiles()[1], LOSS_WORK);
        let empty = (size.padded()[0] * size.tile) as u64 * work / pixels;
        let weights = match self.pairs.get(&(view, rows)) {
            Some(pairs) => {
                let weight = |[all, used]: &[u32; 2]| {
                    u64::from(*all) + USED_PAIR_WORK * u64::from(*used) + empty
                };
                pairs.iter().map(weight).collect()
            }
            None => vec![empty; rows],
        };
        self.band_parts.bands(&weights)
    }

    /// Notes the pairs of each row of tiles of a view, for its next bands, and how long each rank worked, for the next parts.
    pub fn note_view(&mut self, view: usize, pairs: &[[u32; 2]], worked: &[Worked]) {
        self.pairs.insert((view, pairs.len()), pairs.to_vec());
        for (sum, worked) in self.worked_on_rows.iter_mut().zip(worked) {
            *sum += f64::from(worked.rows);
            for (sum, seconds) in self.worked.iter_mut().zip([worked.rows, worked.band]) {
                *sum += f64::from(seconds) / self.exchange.ranks() as f64;
            }
        }
        self.process_seconds[0] = worked.iter().map(|worked| f64::from(worked.process)).sum();
        let seconds: Vec<f64> = worked.iter().map(|worked| worked.band.into()).collect();
        self.band_parts.level(&seconds, BAND_GAIN);
    }

    /// Forgets how long the ranks worked: on nothing, to warm up.
    pub fn forget_times(&mut self) {
        let ranks = self.exchange.ranks();
        self.worked_on_rows = vec![0.0; ranks];
        self.row_parts = Parts::even(ranks);
        self.band_parts = Parts::even(ranks);
        self.process_seconds[1] = self.process_seconds[0];
    }

    /// Divides rows among the ranks; returns the first row of each, and the number of all.
    pub fn divide_rows(&mut self, all: usize) -> Vec<usize> {
        let ranks = self.exchange.ranks();
        let worked = std::mem::replace(&mut self.worked_on_rows, vec![0.0; ranks]);
        self.row_parts.level(&worked, ROW_GAIN);
        self.rows = self.row_parts.rows(all);
        self.rows.clone()
    }

    /// First row of each rank, and the number of all, since they were divided last.
    #[must_use]
    pub fn division(&self) -> &[usize] {
        &self.rows
    }

    /// Rows of a rank, since they were divided last.
    #[must_use]
    pub fn rows_of(&self, rank: usize) -> Range<usize> {
        self.rows[rank]..self.rows[rank + 1]
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

/// A length of the run as words: from which iteration on, iterations, size of the photos.
pub fn words_of_length(length: &Length) -> [u32; 3] {
    let place = TrainingSize::ALL.iter().position(|s| *s == length.size);
    [length.from, length.iterations, place.unwrap_or(0) as u32]
}

/// The length of [`words_of_length`].
///
/// # Errors
/// No such size.
pub fn length_of([from, iterations, size]: [u32; 3]) -> Result<Length> {
    let size = TrainingSize::ALL.get(size as usize).copied();
    Ok(Length {
        from,
        iterations,
        size: size.ok_or_else(|| Error::numerics("exchange", "an unknown size of photos"))?,
    })
}

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
    use super::{BAND_GAIN, Parts, ROW_GAIN};

    #[test]
    fn every_row_belongs_to_one_rank() {
        for (ranks, all) in [(1, 7), (2, 7), (3, 2), (4, 1000)] {
            let mut parts = Parts::even(ranks);
            for seconds in [1.0, 9.0, 0.1] {
                let rows = parts.rows(all);
                assert!(rows.is_sorted() && rows.len() == ranks + 1);
                assert_eq!((rows[0], rows[ranks]), (0, all), "{ranks} ranks");
                let seconds: Vec<f64> = (0..ranks).map(|r| seconds + r as f64).collect();
                parts.level(&seconds, ROW_GAIN);
            }
        }
    }

    #[test]
    fn bands_have_even_weights() {
        let divide = |weights: &[u64], ranks| Parts::even(ranks).bands(weights);
        assert_eq!(divide(&[1; 8], 2), [0, 4, 8]);
        assert_eq!(divide(&[9, 1, 1, 1, 1, 1], 2), [0, 1, 6]);
        assert_eq!(divide(&[0, 0, 5], 2), [0, 2, 3]);
        assert_eq!(divide(&[1], 3), [0, 0, 1, 1], "bands may be empty");
        for (weights, ranks) in [(vec![3, 1, 4, 1, 5, 9, 2, 6], 3), (vec![7; 50], 16)] {
            let bands = divide(&weights, ranks);
            assert!(bands.is_sorted() && bands.len() == ranks + 1);
            assert_eq!(
                (bands[0], bands[ranks]),
                (0, u32::try_from(weights.len()).unwrap())
            );
        }
    }

    #[test]
    fn parts_follow_measured_time() {
        let (speeds, fixed) = ([1.0, 3.0, 0.5], 0.01);
        let mut parts = Parts::even(3);
        let times = |parts: &Parts| -> Vec<f64> {
            let ranks = parts.0.iter().zip(speeds);
            ranks.map(|(part, speed)| fixed + part / speed).collect()
        };
        for _ in 0..200 {
            parts.level(&times(&parts), BAND_GAIN);
        }
        for seconds in times(&parts) {
            assert!((seconds - (fixed + 1.0 / 4.5)).abs() < 1e-6, "{seconds}");
        }
        // One hiccup does not overturn that, nor do times that are none.
        let before = parts.clone();
        parts.level(&[100.0, 0.01, 0.01], BAND_GAIN);
        for (now, before) in parts.0.iter().zip(&before.0) {
            assert!((now / before - 1.0).abs() < 0.15, "{now} {before}");
        }
        let before = parts.clone();
        parts.level(&[0.0; 3], BAND_GAIN);
        parts.level(&[f64::NAN, 1.0, 1.0], BAND_GAIN);
        assert_eq!(parts, before);
        // A rank that is hopeless keeps a little, which shows when it recovers.
        for _ in 0..1000 {
            parts.level(&[10.0, 1.0, 1.0], BAND_GAIN);
        }
        assert!(parts.0[0] > 0.005 && parts.0[0] < 0.01, "{parts:?}");
    }
}
