//! Order along the Z curve (Morton 1966), layer by layer from the top: Gaussians that are neighbours in space become neighbours in
//! memory, so that those of one tile share cache lines, and those of a few layers lie in a few rows of tiles. Faster-GS and
//! LiteGS reorder for the first reason; for the second, ranks of which each has a part of the rows have most of the Gaussians of their
//! bands of tile rows.

use rayon::prelude::*;

/// Bits per axis of a code.
pub const BITS: u32 = 18;
/// Bits of the number of a layer, in front of a code.
pub const LAYER_BITS: u32 = 7;
/// Layers in which 1 + 2 |height| doubles, heights in local units, from that of the origin on: 2 to the power of this.
pub const OCTAVE_BITS: u32 = 3;

/// The direction that is up of a set of Gaussians that has none: all finite positions are one layer.
pub const NO_UP: [f32; 3] = [0.0; 3];

/// Rows in the order of their layers from the top, for the direction that is up, and in each of their Morton codes over the bounding box, ties
/// by row. Slices of equal length, local units; a position that is not finite is in a layer at either end, and counts as the box's corner there.
#[must_use]
pub fn order(positions: [&[f32]; 3], up: [f32; 3]) -> Vec<u32> {
    let scales = positions.map(|axis| {
        let finite = || axis.iter().copied().filter(|v| v.is_finite());
        let low = finite().fold(f32::INFINITY, f32::min);
        let high = finite().fold(f32::NEG_INFINITY, f32::max);
        let extent = f64::from(high) - f64::from(low);
        let cells = f64::from((1u32 << BITS) - 1);
        (low, if extent > 0.0 { cells / extent } else { 0.0 })
    });
    let code = |i: usize| {
        let layer = u64::from(layer(positions.map(|axis| axis[i]), up)) << (3 * BITS);
        (0..3).fold(layer, |code, k| {
            let (low, scale) = scales[k];
            let cell = (f64::from(positions[k][i]) - f64::from(low)) * scale;
            code | spread(cell as u64) << k // a cast of NaN is 0
        })
    };
    let mut rows: Vec<(u64, u32)> = (0..positions[0].len())
        .into_par_iter()
        .map(|i| (code(i), i as u32))
        .collect();
    rows.par_sort_unstable();
    rows.into_iter().map(|(_, i)| i).collect()
}

/// Number of the layer of a position, local units: the topmost is 0, and half of them are above the origin. The bits of a float
/// are a logarithm that is a straight line between powers of two, and every step is rounded once, so that all devices have the same; heights that
/// some flush to 0 are in its layer.
#[must_use]
pub fn layer([x, y, z]: [f32; 3], up: [f32; 3]) -> u32 {
    let half = 1u32 << (LAYER_BITS - 1);
    let height = x.mul_add(up[0], y.mul_add(up[1], z * up[2]));
    let stretched = 1.0 + 2.0 * height.abs();
    let away = match stretched.is_finite() {
        true => (stretched.to_bits() - 1f32.to_bits()) >> (f32::MANTISSA_DIGITS - 1 - OCTAVE_BITS),
        false => half,
    };
    let away = away.min(half - 1);
    if height >= f32::MIN_POSITIVE {
        half - 1 - away
    } else {
        half + away
    }
}

/// The low bits with two zeros between neighbours; there is room for 21.
fn spread(cell: u64) -> u64 {
    let mut v = cell & ((1 << BITS) - 1);
    v = (v | v << 32) & 0x001f_0000_0000_ffff;
    v = (v | v << 16) & 0x001f_0000_ff00_00ff;
    v = (v | v << 8) & 0x100f_00f0_0f00_f00f;
    v = (v | v << 4) & 0x10c3_0c30_c30c_30c3;
    (v | v << 2) & 0x1249_2492_4924_9249
}
