//! Streams of the check's random numbers.

use crate::base::rng::Stream;

/// Choice of the views.
pub(super) const VIEWS: u32 = 0;
/// Sources, one stream per group of candidates.
pub(super) const SOURCE: u32 = 10;
/// Offsets, one stream per group of candidates.
pub(super) const OFFSET: u32 = 20;
/// Bootstrap, one stream per predictor and subset.
pub(super) const RESAMPLE: u32 = 30;

/// The key of a stream.
pub(super) fn stream(which: u32) -> u64 {
    Stream::Surrogate.stream(which)
}
