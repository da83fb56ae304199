//! Hashes, and sine and cosine by + − × ÷ alone.
//!
//! IEEE 754 fixes the result of those operations and of √, and Rust never contracts them; `sin`, `powf` and their kin come from
//! the platform's libm and may differ in the last bit. Nothing here uses libm, so scenes do not depend on it.

/// SplitMix64's finaliser (Steele, Lea & Flood 2014, "Fast splittable pseudorandom number generators").
fn mix(mut x: u64) -> u64 {
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// Random number in [0, 1) keyed by `words`; their order counts.
pub(super) fn random(words: &[u64]) -> f64 {
    const STEP: u64 = 0x9e37_79b9_7f4a_7c15;
    let hash = words
        .iter()
        .fold(STEP, |h, w| mix(h.wrapping_add(STEP) ^ mix(w ^ STEP)));
    (hash >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
}

/// Sine of an angle in turns (1 = 360°), to about 1e-11: the Taylor series over a quarter turn either side of zero.
pub(super) fn sin_turns(turns: f64) -> f64 {
    let t = turns - (turns + 0.5).floor();
    let folded = if t > 0.25 {
        0.5 - t
    } else if t < -0.25 {
        -0.5 - t
    } else {
        t
    };
    let x = folded * std::f64::consts::TAU;
    let (mut term, mut sum) = (x, x);
    for k in 1..=9 {
        let n = f64::from(2 * k);
        term *= -x * x / (n * (n + 1.0));
        sum += term;
    }
    sum
}

/// Cosine of an angle in turns.
pub(super) fn cos_turns(turns: f64) -> f64 {
    sin_turns(turns + 0.25)
}
