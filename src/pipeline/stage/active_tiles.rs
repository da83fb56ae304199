//! Tiles of a masked photo in which any pixel counts, or of a transparent one in which any is not clear (`kernels/active_tiles.cl`).

use crate::base::error::Result;
use crate::device::{Array, CameraArg, Kernels, Program, Real};
use crate::pipeline::reference::TILE;

/// The kernel.
#[derive(Debug)]
pub struct ActiveTiles(Program);

impl ActiveTiles {
    /// Builds the kernel.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        kernels.build::<R>("active_tiles").map(Self)
    }

    /// Marks the active tiles of a photo of a camera's size.
    pub fn run<R: Real>(
        &self,
        photo: &Array<u8>,
        camera: &CameraArg<R>,
        active_tiles: &Array<u32>,
    ) -> Result<()> {
        let ([w, h], tiles) = (camera.image().0, camera.tile_count());
        self.0
            .launch("active_tiles")
            .array(photo, 4 * w * h)
            .ints([w, h])
            .tiles(camera)
            .array(active_tiles, tiles)
            .over_chunks([tiles, 1])
    }
}

// Definition in f64.

/// True for each tile (row major) of a mask \[height, width\] in which any pixel counts.
#[must_use]
pub fn active_tiles(mask: &[u8], [width, height]: [usize; 2]) -> Vec<bool> {
    let tile = TILE as usize;
    let (across, down) = (width.div_ceil(tile), height.div_ceil(tile));
    let mut tiles = vec![false; across * down];
    for (at, m) in mask.iter().enumerate() {
        tiles[at / width / tile * across + at % width / tile] |= *m > 0;
    }
    tiles
}
