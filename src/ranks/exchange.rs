//! [`Exchange`]: messages between ranks.

use std::fmt::Debug;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use crate::base::error::{Error, Result};

/// The rank that leads: it takes the decisions and has the run's folder.
pub const LEADER: usize = 0;

/// Kinds of messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// Orders of the leader.
    Orders,
    /// Projected Gaussians, to the bands that they touch.
    Records,
    /// Pixel rows beside bands.
    Borders,
    /// Sums of pairs, or flags, back to the Gaussians.
    Sums,
    /// Sums of the loss, to the leader.
    Loss,
    /// Bands of images, to all or to the leader.
    Images,
    /// Parameters, moments and statistics of Gaussians, between iterations.
    Rows,
    /// Values of all Gaussians that every rank needs, or the leader: planes that density steps are decided from, checksums of decisions,
    /// largest filters, flags of what is seen.
    Evidence,
}

impl Part {
    /// All kinds.
    pub const ALL: [Self; 8] = [
        Self::Orders,
        Self::Records,
        Self::Borders,
        Self::Sums,
        Self::Loss,
        Self::Images,
        Self::Rows,
        Self::Evidence,
    ];

    /// Name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Orders => "orders",
            Self::Records => "records",
            Self::Borders => "borders",
            Self::Sums => "sums",
            Self::Loss => "loss",
            Self::Images => "images",
            Self::Rows => "rows",
            Self::Evidence => "evidence",
        }
    }
}

/// Bytes that a rank has sent to others, by [`Part::ALL`].
pub type Traffic = [u64; Part::ALL.len()];

/// Seconds for which a rank has waited for others, by [`Part::ALL`].
pub type Waits = [f64; Part::ALL.len()];

/// Counts of a rank's messages.
#[derive(Debug, Default)]
pub struct Meter {
    bytes: [AtomicU64; Part::ALL.len()],
    nanoseconds: [AtomicU64; Part::ALL.len()],
}

impl Meter {
    /// Counts the bytes of messages to others.
    pub fn send(&self, rank: usize, part: Part, messages: &[Vec<u32>]) {
        let others = messages.iter().enumerate().filter(|(to, _)| *to != rank);
        let bytes = others.map(|(_, m)| 4 * m.len() as u64).sum();
        self.bytes[part as usize].fetch_add(bytes, Ordering::Relaxed);
    }

    /// Counts the time since then as one of waiting.
    pub fn wait(&self, part: Part, since: Instant) {
        let waited = u64::try_from(since.elapsed().as_nanos()).unwrap_or(u64::MAX);
        self.nanoseconds[part as usize].fetch_add(waited, Ordering::Relaxed);
    }

    /// Bytes sent.
    #[must_use]
    pub fn sent(&self) -> Traffic {
        self.bytes.each_ref().map(|n| n.load(Ordering::Relaxed))
    }

    /// Seconds waited.
    #[must_use]
    pub fn waited(&self) -> Waits {
        let nanoseconds = self.nanoseconds.each_ref();
        nanoseconds.map(|n| Duration::from_nanos(n.load(Ordering::Relaxed)).as_secs_f64())
    }
}

/// Refuses another number of messages than there are ranks.
///
/// # Errors
/// That.
pub fn check_number(messages: &[Vec<u32>], ranks: usize) -> Result<()> {
    let what = format!("{} messages for {ranks} ranks", messages.len());
    match messages.len() == ranks {
        true => Ok(()),
        false => Err(Error::numerics("exchange", what)),
    }
}

/// Messages between ranks. All of them make the same calls in the same order.
pub trait Exchange: Debug + Send + Sync {
    /// Number of this rank.
    fn rank(&self) -> usize;

    /// Number of ranks.
    fn ranks(&self) -> usize;

    /// True if every rank is a process of its own.
    fn apart(&self) -> bool;

    /// Begins to send a message to each rank, this one included: that for rank r stands at r. Does not wait; messages are on their way while
    /// the rank goes on.
    ///
    /// # Errors
    /// Another number of messages than ranks, or another rank is gone.
    fn begin(&self, part: Part, messages: Vec<Vec<u32>>) -> Result<()>;

    /// Waits for the messages, one from each rank, of the oldest [`Exchange::begin`] that has not been waited for: that from rank r stands at r.
    ///
    /// # Errors
    /// Another rank has failed, or is gone; nothing is on its way.
    fn wait(&self) -> Result<Vec<Vec<u32>>>;

    /// Sends a message to each rank and waits for one from each. Nothing else may be on its way.
    ///
    /// # Errors
    /// See [`Exchange::begin`] and [`Exchange::wait`].
    fn trade(&self, part: Part, messages: Vec<Vec<u32>>) -> Result<Vec<Vec<u32>>> {
        self.begin(part, messages)?;
        self.wait()
    }

    /// Bytes that this rank has sent, and times for which it has waited, so far.
    fn meter(&self) -> &Meter;

    /// Tells the others that this rank cannot go on: what they trade from now on fails with this text. Processes are all ended at once, this
    /// one, too.
    fn fail(&self, why: &str);

    /// Ends the exchange in order, once no rank trades any more.
    fn end(&self);
}

/// The error of a wait for messages where none are on their way.
#[must_use]
pub fn nothing_begun() -> Error {
    Error::numerics("exchange", "nothing is on its way")
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

/// A text as words: its length in bytes, then four bytes a word.
#[must_use]
pub fn words_of(text: &str) -> Vec<u32> {
    let word = |bytes: &[u8]| {
        let mut four = [0; 4];
        four[..bytes.len()].copy_from_slice(bytes);
        u32::from_le_bytes(four)
    };
    let mut words = vec![text.len() as u32];
    words.extend(text.as_bytes().chunks(4).map(word));
    words
}

/// The text of [`words_of`]; `None` for other words.
#[must_use]
pub fn text_of(words: &[u32]) -> Option<String> {
    let (len, words) = words.split_first()?;
    let mut bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
    bytes.truncate(*len as usize);
    let whole = bytes.len() == *len as usize;
    String::from_utf8(bytes).ok().filter(|_| whole)
}

/// Flags as words, 32 in each.
#[must_use]
pub fn bits_of(flags: &[bool]) -> Vec<u32> {
    let word = |flags: &[bool]| {
        let bits = (0..).zip(flags);
        bits.fold(0, |word, (k, flag)| word | u32::from(*flag) << k)
    };
    flags.chunks(32).map(word).collect()
}

/// The flags of [`bits_of`], so many of them.
///
/// # Errors
/// Another number of words than they take.
pub fn flags_of(words: &[u32], len: usize) -> Result<Vec<bool>> {
    if words.len() != len.div_ceil(32) {
        let what = format!("{} words for {len} flags", words.len());
        return Err(Error::numerics("exchange", what));
    }
    let flag = |k: usize| words[k / 32] >> (k % 32) & 1 != 0;
    Ok((0..len).map(flag).collect())
}

#[cfg(test)]
mod tests {
    use super::{bits_of, flags_of, text_of, words_of};

    #[test]
    fn flags_come_back() {
        for len in [0_usize, 1, 31, 32, 33, 100] {
            let flags: Vec<bool> = (0..len).map(|k| k % 3 == 1).collect();
            let words = bits_of(&flags);
            assert_eq!(words.len(), len.div_ceil(32));
            assert_eq!(flags_of(&words, len).unwrap(), flags);
        }
        assert!(flags_of(&[1], 33).is_err() && flags_of(&[1, 0], 32).is_err());
    }

    #[test]
    fn texts_come_back() {
        for text in ["", "a", "four", "fünf!", "{\"seed\": 7}"] {
            assert_eq!(text_of(&words_of(text)).as_deref(), Some(text));
        }
        assert_eq!(text_of(&[9, 0x6161_6161]), None, "too short");
        assert_eq!(text_of(&[]), None);
    }
}
