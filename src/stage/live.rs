//! Tiles of a masked photo in which any pixel counts, or of a transparent one in which any is not clear (`kernels/live.cl`).

use crate::error::Result;
use crate::gpu::{Array, CameraArg, Kernel, Kernels, Real};

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
