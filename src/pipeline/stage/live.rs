//! Tiles of a masked photo in which any pixel counts, or of a transparent one in which any is not clear (`kernels/live.cl`).

use crate::base::error::Result;
use crate::device::{Array, CameraArg, Kernel, Kernels, Real};
use crate::pipeline::reference::TILE;

/// The live stage.
#[derive(Debug)]
pub struct Live {
    kernel: Kernel,
    local: usize,
}

impl Live {
    /// Builds the kernel.
    ///
    /// # Errors
    /// A build failure.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let [kernel] = kernels.build::<R, 1>("live", ["live"])?;
        Ok(Self {
            kernel,
            local: kernels.defines().tuning.coarse_local(),
        })
    }

    /// Builds the kernel where photos have masks, or where they are transparent and what is blank is skipped.
    ///
    /// # Errors
    /// A build failure.
    pub fn if_asked<R: Real>(kernels: &Kernels) -> Result<Option<Self>> {
        let defines = kernels.defines();
        let asked = defines.masked() || defines.skips_blank();
        asked.then(|| Self::new::<R>(kernels)).transpose()
    }

    /// Enqueues the stage for a photo \[4, height, width\] of a camera's size; `live` \[tiles\] receives 1 or 0.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn run<R: Real>(
        &self,
        photo: &Array<u8>,
        camera: &CameraArg<R>,
        live: &Array<u32>,
    ) -> Result<()> {
        let [w, h] = camera.size;
        let tiles = camera.tile_count();
        self.kernel
            .launch()
            .array(photo, 4 * w as usize * h as usize)
            .value(w)
            .value(h)
            .value(camera.tiles[0])
            .value(tiles as i32)
            .array(live, tiles)
            .run([tiles, 1], [self.local, 1])
    }
}

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
