//! Counter-based random numbers (stand-in until the density branch is merged).

/// Generator.
pub struct Philox;

impl Philox {
    /// Uniform numbers.
    #[must_use]
    pub fn uniform(seed: u64, stream: u64, index: u64) -> [f64; 4] {
        let mut x = seed ^ stream.rotate_left(17) ^ index.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        std::array::from_fn(|_| {
            x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut z = x;
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            (z >> 11) as f64 / (1u64 << 53) as f64
        })
    }
}

/// Purposes.
#[derive(Debug, Clone, Copy)]
pub enum Stream {
    /// View order.
    ViewOrder,
    /// Background.
    Background,
}

impl Stream {
    /// Stream of an iteration.
    #[must_use]
    pub fn at(self, iteration: u64) -> u64 {
        (self as u64) << 56 | iteration
    }
}
