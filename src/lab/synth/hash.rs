//! Numbers without state: hashes, lattice noise and the few functions a renderer needs beyond + − × ÷ √.
//!
//! IEEE 754 fixes the result of those five operations, and Rust never contracts them; `sin`, `powf` and their kin come from
//! the platform's libm and may differ in the last bit. Nothing here uses libm, so scenes do not depend on it.

use glam::{DMat3, DVec3};

/// SplitMix64's finaliser (Steele, Lea & Flood 2014, "Fast splittable pseudorandom number generators").
fn mix(mut x: u64) -> u64 {
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// Hash of a few words; the order of the words counts.
pub(super) fn hash(words: &[u64]) -> u64 {
    words.iter().fold(0x9e37_79b9_7f4a_7c15, |h, w| {
        mix(h.wrapping_add(0x9e37_79b9_7f4a_7c15) ^ mix(w.wrapping_add(0x632b_e59b_d9b4_e019)))
    })
}

/// The upper 53 bits of a hash as a number in [0, 1).
pub(super) fn unit(h: u64) -> f64 {
    (h >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
}

/// Random number in [0, 1) keyed by `words`.
pub(super) fn random(words: &[u64]) -> f64 {
    unit(hash(words))
}

/// Random number of a cell of the integer lattice, in [0, 1). One round of mixing: textures ask for millions of these.
pub(super) fn cell(x: f64, y: f64, z: f64, seed: u64) -> f64 {
    let h = (x as i64 as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ (y as i64 as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f)
        ^ (z as i64 as u64).wrapping_mul(0x1656_67b1_9e37_79f9);
    unit(mix(h ^ seed.wrapping_mul(0xd6e8_feb8_6659_fd93)))
}

/// Value noise in [0, 1): random numbers on the integer lattice, blended by 3t² − 2t³.
pub(super) fn noise(p: DVec3, seed: u64) -> f64 {
    let base = p.floor();
    let f = p - base;
    let w = f * f * (DVec3::splat(3.0) - 2.0 * f);
    let corner = |dx: f64, dy: f64, dz: f64| cell(base.x + dx, base.y + dy, base.z + dz, seed);
    let plane = |dz: f64| {
        let near = mix_f(corner(0.0, 0.0, dz), corner(1.0, 0.0, dz), w.x);
        let far = mix_f(corner(0.0, 1.0, dz), corner(1.0, 1.0, dz), w.x);
        mix_f(near, far, w.y)
    };
    mix_f(plane(0.0), plane(1.0), w.z)
}

/// Three octaves of [`noise`], in [0, 1).
pub(super) fn fractal(p: DVec3, seed: u64) -> f64 {
    (4.0 * noise(p, seed) + 2.0 * noise(p * 2.03, seed + 1) + noise(p * 4.11, seed + 2)) / 7.0
}

fn mix_f(a: f64, b: f64, t: f64) -> f64 {
    a + (b - a) * t
}

/// 0 below `a`, 1 above `b`, 3t² − 2t³ between.
pub(super) fn smooth(a: f64, b: f64, x: f64) -> f64 {
    let t = ((x - a) / (b - a)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
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

/// x to the power of 2^`doublings`.
pub(super) fn power(x: f64, doublings: u32) -> f64 {
    (0..doublings).fold(x, |y, _| y * y)
}

/// Rotation about the z axis (up), counter-clockwise seen from above, in turns.
pub(super) fn about_z(turns: f64) -> DMat3 {
    let (s, c) = (sin_turns(turns), cos_turns(turns));
    DMat3::from_cols_array(&[c, s, 0.0, -s, c, 0.0, 0.0, 0.0, 1.0])
}

/// Rotation about the x axis, in turns.
pub(super) fn about_x(turns: f64) -> DMat3 {
    let (s, c) = (sin_turns(turns), cos_turns(turns));
    DMat3::from_cols_array(&[1.0, 0.0, 0.0, 0.0, c, s, 0.0, -s, c])
}
