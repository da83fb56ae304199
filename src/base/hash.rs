//! Fingerprints that are written into files: they must not change from version to version.

/// The 64-bit FNV-1a hash (Fowler, Noll, Vo), of bytes or of words in their place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Fnv(pub u64);

impl Default for Fnv {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Fnv {
    /// Takes in one byte or word.
    pub fn word(&mut self, word: u64) {
        self.0 = (self.0 ^ word).wrapping_mul(0x0100_0000_01b3);
    }

    /// Takes in bytes one by one.
    pub fn bytes(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|b| self.word(u64::from(*b)));
    }
}
