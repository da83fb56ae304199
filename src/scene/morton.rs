//! Order along the Z curve (Morton 1966): Gaussians that are neighbours in space become neighbours in memory, so that
//! those of one tile share cache lines. Faster-GS and LiteGS reorder for the same reason.

use rayon::prelude::*;

/// Bits per axis.
pub const BITS: u32 = 21;

/// Rows in the order of their Morton codes over the bounding box, ties by row. Slices of equal length; a position that
/// is not finite counts as the box's corner.
#[must_use]
pub fn order(positions: [&[f32]; 3]) -> Vec<u32> {
    let scales = positions.map(|axis| {
        let finite = || axis.iter().copied().filter(|v| v.is_finite());
        let low = finite().fold(f32::INFINITY, f32::min);
        let high = finite().fold(f32::NEG_INFINITY, f32::max);
        let extent = f64::from(high) - f64::from(low);
        let cells = f64::from((1u32 << BITS) - 1);
        (low, if extent > 0.0 { cells / extent } else { 0.0 })
    });
    let code = |i: usize| {
        (0..3).fold(0u64, |code, k| {
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

/// The low 21 bits with two zeros between neighbours.
fn spread(cell: u64) -> u64 {
    let mut v = cell & ((1 << BITS) - 1);
    v = (v | v << 32) & 0x001f_0000_0000_ffff;
    v = (v | v << 16) & 0x001f_0000_ff00_00ff;
    v = (v | v << 8) & 0x100f_00f0_0f00_f00f;
    v = (v | v << 4) & 0x10c3_0c30_c30c_30c3;
    (v | v << 2) & 0x1249_2492_4924_9249
}
