//! Counter-based random numbers: Philox4x32-10 (Salmon et al., *Parallel Random Numbers: As Easy as 1, 2, 3*, SC 2011).
//!
//! A number is a pure function of (seed, stream, index), so a result does not depend on who draws first or on how many
//! threads draw. The stream holds the purpose and the iteration (see [`Stream::stream`]); the index counts within it.

use std::f64::consts::TAU;

const MULTIPLIERS: [u32; 2] = [0xD251_1F53, 0xCD9E_8D57];
const WEYL: [u32; 2] = [0x9E37_79B9, 0xBB67_AE85];
const ROUNDS: usize = 10;
/// 2⁻³².
const UNIT_32: f64 = 1.0 / 4_294_967_296.0;
/// 2⁻⁵³.
const UNIT_53: f64 = 1.0 / 9_007_199_254_740_992.0;

/// The use of a random number. Each purpose owns 2³² streams, so that no two purposes share a number.
///
/// The values are part of the meaning of a seed: append, never renumber.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u32)]
#[non_exhaustive]
pub enum Stream {
    /// The first Gaussians.
    Init = 1,
    /// Order of the training views.
    ViewOrder = 2,
    /// Random background colour.
    Background = 3,
    /// Source of a relocated Gaussian.
    Relocation = 4,
    /// Source rows of the coarse proposals.
    CoarseDraw = 5,
    /// Offsets of the coarse proposals.
    CoarseOffset = 6,
    /// Acceptance of the coarse proposals.
    CoarseAccept = 7,
    /// Source rows of the fine proposals.
    FineDraw = 8,
    /// Offsets of the fine proposals.
    FineOffset = 9,
    /// Acceptance of the fine proposals.
    FineAccept = 10,
    /// Synthetic scenes and tests.
    Synthetic = 11,
    /// Choice of the sparse points that a bounded run starts from.
    Subset = 12,
    /// Noise on the positions after an optimiser step.
    Noise = 13,
    /// Sources of the growth by a fixed rate.
    Growth = 14,
    /// Positions of the two that a Gaussian is split into.
    Split = 15,
    /// Pixels of the births in image space.
    PixelDraw = 16,
    /// Position within the pixel and depth of those births.
    PixelPlace = 17,
    /// Acceptance of those births.
    PixelAccept = 18,
    /// Candidates, views and resamples of the check of the surrogate.
    Surrogate = 32,
}

impl Stream {
    /// The stream of this purpose at an iteration: purpose in the upper 32 bits, iteration in the lower.
    #[must_use]
    pub const fn stream(self, iteration: u32) -> u64 {
        ((self as u64) << 32) | iteration as u64
    }
}

/// The generator. It has no state: the key is the seed, the counter is (index, stream), low words first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Philox;

impl Philox {
    /// Four independent words, uniform over all 32-bit values.
    #[must_use]
    pub const fn words(seed: u64, stream: u64, index: u64) -> [u32; 4] {
        let mut c = [
            index as u32,
            (index >> 32) as u32,
            stream as u32,
            (stream >> 32) as u32,
        ];
        let mut key = [seed as u32, (seed >> 32) as u32];
        let mut round = 0;
        while round < ROUNDS {
            let p0 = MULTIPLIERS[0] as u64 * c[0] as u64;
            let p1 = MULTIPLIERS[1] as u64 * c[2] as u64;
            c = [
                (p1 >> 32) as u32 ^ c[1] ^ key[0],
                p1 as u32,
                (p0 >> 32) as u32 ^ c[3] ^ key[1],
                p0 as u32,
            ];
            key = [key[0].wrapping_add(WEYL[0]), key[1].wrapping_add(WEYL[1])];
            round += 1;
        }
        c
    }

    /// Four numbers uniform in [0, 1), each with 32 random bits: multiples of 2⁻³², zero included.
    #[must_use]
    pub fn uniform(seed: u64, stream: u64, index: u64) -> [f64; 4] {
        Self::words(seed, stream, index).map(|w| f64::from(w) * UNIT_32)
    }

    /// Two numbers uniform in [0, 1), each with 53 random bits: for draws among so many items that 32 bits would show.
    #[must_use]
    pub fn uniform_53(seed: u64, stream: u64, index: u64) -> [f64; 2] {
        let w = Self::words(seed, stream, index);
        let join = |low: u32, high: u32| {
            (((u64::from(high) << 32) | u64::from(low)) >> 11) as f64 * UNIT_53
        };
        [join(w[0], w[1]), join(w[2], w[3])]
    }

    /// Four standard normal numbers (Box and Muller 1958). With 32-bit uniforms no magnitude exceeds
    /// √(2·ln 2³²) ≈ 6.66.
    #[must_use]
    pub fn normal(seed: u64, stream: u64, index: u64) -> [f64; 4] {
        let w = Self::words(seed, stream, index);
        let pair = |a: u32, b: u32| {
            // (0, 1] instead of [0, 1): the logarithm stays finite.
            let radius = (-2.0 * ((f64::from(a) + 1.0) * UNIT_32).ln()).sqrt();
            let (sin, cos) = (TAU * f64::from(b) * UNIT_32).sin_cos();
            (radius * cos, radius * sin)
        };
        let (x, y) = pair(w[0], w[1]);
        let (z, t) = pair(w[2], w[3]);
        [x, y, z, t]
    }
}
