//! [`BandTiles`]: the pairs of the tiles of a band, as the host has read them.

use std::ops::Range;

use crate::base::error::Result;
use crate::device::{Real, Section};
use crate::pipeline::buffers::ViewBuffers;

/// First pairs of the tiles of a band, and the pairs that were looked at.
#[derive(Debug)]
pub struct BandTiles<'a> {
    band: Range<usize>,
    /// Tiles of a row.
    across: usize,
    /// First pair of each tile of the band, and of the one after it.
    start: &'a [u32],
    /// Pairs that were looked at of each tile of the band.
    used: &'a [u32],
}

impl<'a> BandTiles<'a> {
    /// Sections to be read of a view for them.
    ///
    /// # Errors
    /// Tiles that the view has no room for.
    pub fn sections<R: Real>(view: &ViewBuffers<R>) -> Result<[Section<'_>; 2]> {
        let across = view.camera.across as usize;
        let (first, tiles) = (view.band.start * across, view.band.len() * across);
        let start = view.tile_start.section(first, tiles + 1)?;
        Ok([start, view.tile_used.section(first, tiles)?])
    }

    /// The words of [`BandTiles::sections`] of a view.
    #[must_use]
    pub fn new<R: Real>(view: &ViewBuffers<R>, words: &'a [u32]) -> Self {
        let across = view.camera.across as usize;
        let (start, used) = words.split_at(view.band.len() * across + 1);
        Self {
            band: view.band.clone(),
            across,
            start,
            used,
        }
    }

    /// First pairs of the tiles of a row of the band, and of the one after them.
    fn row(&self, row: usize) -> &[u32] {
        let first = (row - self.band.start) * self.across;
        &self.start[first..=first + self.across]
    }

    /// Flags of the tiles of a row of the band that have pairs, 1 or 0.
    pub fn paired(&self, row: usize) -> impl Iterator<Item = u32> {
        self.row(row).windows(2).map(|w| u32::from(w[0] != w[1]))
    }

    /// First pairs to be written for the tiles of a row beside the band that have pairs elsewhere, with the tile of the first: they differ from those of
    /// the next tile, and mean nothing else.
    #[must_use]
    pub fn marks(&self, row: usize, flags: &[u32]) -> (usize, Vec<u32>) {
        let at = row * self.across;
        if row < self.band.start {
            let mut value = self.start[0];
            let mut starts = vec![0; self.across];
            for (start, flag) in starts.iter_mut().zip(flags).rev() {
                value = value.wrapping_add(*flag);
                *start = value;
            }
            return (at, starts);
        }
        let mut value = self.start[self.start.len() - 1];
        let next = flags.iter().map(|flag| {
            value = value.wrapping_add(*flag);
            value
        });
        (at + 1, next.collect())
    }

    /// Number of pairs of each row of tiles of the band, and of those that were looked at.
    pub fn pairs_by_row(&self) -> impl Iterator<Item = [u32; 2]> {
        let across = self.across;
        self.band.clone().map(move |row| {
            let (start, first) = (self.row(row), (row - self.band.start) * across);
            // Lists of a view that had no room are of no use.
            let used = self.used[first..first + across].iter();
            let used = used.fold(0, |sum: u32, n| sum.wrapping_add(*n));
            [start[across].wrapping_sub(start[0]), used]
        })
    }
}
