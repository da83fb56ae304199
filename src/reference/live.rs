//! Twin of `kernels/live.cl`.

use super::TILE;

/// Whether any pixel of each tile (row major) of a mask \[height, width\] counts.
#[must_use]
pub fn live(mask: &[u8], [width, height]: [usize; 2]) -> Vec<bool> {
    let tile = TILE as usize;
    let (across, down) = (width.div_ceil(tile), height.div_ceil(tile));
    let mut tiles = vec![false; across * down];
    for (at, m) in mask.iter().enumerate() {
        tiles[at / width / tile * across + at % width / tile] |= *m > 0;
    }
    tiles
}
