//! [`Digests`] of the files that a dataset was read from.

use std::path::PathBuf;

use glam::DVec3;
use rayon::prelude::*;

use crate::base::error::Result;
use crate::base::files;
use crate::base::hash::Fnv;

/// A number that changes when a byte does: FNV-1a over words of eight bytes, with the upper half mixed into the lower one.
pub(super) fn digest(bytes: &[u8]) -> u64 {
    let mut hash = Fnv::default();
    let mut take = |word| {
        hash.word(word);
        hash.0 ^= hash.0 >> 32;
    };
    let words = bytes.chunks_exact(8);
    let rest = words.remainder();
    for word in words {
        take(word.iter().fold(0, |sum, b| sum << 8 | u64::from(*b)));
    }
    rest.iter().for_each(|b| take(u64::from(*b)));
    hash.0
}

/// Numbers by which copies of a dataset are compared: each changes when a byte does.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Digests {
    /// Files of photos and masks with theirs, in the order of the views; that of a panorama once for all of its sides.
    pub files: Vec<(PathBuf, u64)>,
    /// That of the sparse points' positions and colours.
    pub points: u64,
}

impl Digests {
    /// Reads the files of photos and of their masks, those of views that follow each other and share them once.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub(super) fn new(
        mut views: Vec<(&PathBuf, Option<&PathBuf>)>,
        (positions, colors): (&[DVec3], &[[u8; 3]]),
    ) -> Result<Self> {
        views.dedup();
        let read = |file: &PathBuf| Ok((file.clone(), digest(&files::read(file)?)));
        let all = views
            .into_iter()
            .flat_map(|(photo, mask)| [Some(photo), mask]);
        let all: Vec<&PathBuf> = all.flatten().collect();
        let coordinates = positions.iter().flat_map(|p| p.to_array());
        let points = coordinates.flat_map(f64::to_le_bytes);
        let points: Vec<u8> = points.chain(colors.iter().copied().flatten()).collect();
        Ok(Self {
            files: all.into_par_iter().map(read).collect::<Result<_>>()?,
            points: digest(&points),
        })
    }

    /// The numbers alone: of the files, then of the points.
    #[must_use]
    pub fn numbers(&self) -> Vec<u64> {
        let files = self.files.iter().map(|(_, number)| *number);
        files.chain([self.points]).collect()
    }

    /// The first files that another copy of the dataset, of these [`Digests::numbers`], has with other bytes, or its other points, in words; `None` if all are the
    /// same.
    #[must_use]
    pub fn difference(&self, other: &[u64]) -> Option<String> {
        let (own, files) = (self.numbers(), self.files.len());
        if own.len() != other.len() {
            return Some("the number of photos and masks".to_owned());
        }
        let mut unlike = (0..files).filter(|at| own[*at] != other[*at]);
        match (unlike.next(), unlike.count()) {
            (None, _) => (own[files] != other[files]).then(|| "the sparse points".to_owned()),
            (Some(at), 0) => Some(self.files[at].0.display().to_string()),
            (Some(at), more) => Some(format!("{} and {more} more", self.files[at].0.display())),
        }
    }
}
