//! Tiles of a masked photo in which any pixel counts, or of a transparent one in which any is not clear (`kernels/active_tiles.cl`).

use std::ops::Range;

use crate::base::error::Result;
use crate::device::{Array, Device, ImageSize, Program};

/// Active tiles \[tiles\] of a photo of this size, which has an alpha plane: 1, or 0 for the others, and for those that none of the pixel rows
/// that there are lies in.
///
/// # Errors
/// No room for them, or the driver's.
pub fn mark(
    device: &Device,
    stage: &Program,
    (photo, rows): (&Array<u8>, &Range<usize>),
    size: ImageSize,
) -> Result<Array<u32>> {
    let ([w, _], count) = (size.pixels, size.tile_count());
    let tiles = Array::zeros(device, "active_tiles", count)?;
    stage
        .launch("active_tiles")
        .array(photo, 4 * w * rows.len())
        .ints([w, rows.start, rows.len()])
        .tiles(size)
        .array(&tiles, count)
        .over_chunks([count, 1])?;
    Ok(tiles)
}

// Definition in f64.

/// True for each tile (row major) of so many pixels a side of a mask \[height, width\] in which any pixel counts.
#[must_use]
pub fn active_tiles(mask: &[u8], [width, height]: [usize; 2], tile: usize) -> Vec<bool> {
    let (across, down) = (width.div_ceil(tile), height.div_ceil(tile));
    let mut tiles = vec![false; across * down];
    for (at, m) in mask.iter().enumerate() {
        tiles[at / width / tile * across + at % width / tile] |= *m > 0;
    }
    tiles
}
