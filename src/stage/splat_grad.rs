//! Derivative of the compositing (`kernels/splat_grad.cl`).

use super::splat::{TileLists, group_size, tile_grid};
use crate::error::Result;
use crate::gpu::{Array, Kernel, Kernels, Real};

/// The splat_grad stage.
#[derive(Debug)]
pub struct SplatGrad {
    kernel: Kernel,
    group: usize,
}

impl SplatGrad {
    /// Builds the kernel.
    ///
    /// # Errors
    /// A build failure.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let [kernel] = kernels.build::<R, 1>("splat_grad", ["splat_grad"])?;
        Ok(Self {
            kernel,
            group: group_size(kernels),
        })
    }

    /// Enqueues the stage: `dimage` \[3, rows, stride\] → `sums` \[pairs, 9\].
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn run<R: Real>(
        &self,
        a: &TileLists<'_, R>,
        dimage: &Array<R>,
        sums: &Array<R>,
    ) -> Result<()> {
        let [tiles_x, tiles] = a.tiles;
        let (global, local) = tile_grid(tiles, self.group);
        self.kernel
            .launch()
            .array(a.records, 1)
            .array(a.pair_owner, 1)
            .array(a.order, 1)
            .array(a.tile_start, tiles + 1)
            .array(a.tile_used, tiles)
            .value(tiles_x as i32)
            .value(tiles as i32)
            .array(a.image, 4 * a.plane())
            .array(dimage, 3 * a.plane())
            .array(sums, 1)
            .run(global, local)
    }
}
