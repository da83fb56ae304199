//! Front-to-back compositing (`kernels/splat.cl`).

use crate::error::Result;
use crate::gpu::tuning::TILE;
use crate::gpu::{Array, CameraArg, Kernel, Kernels, Real, Record};

/// The splat stage.
#[derive(Debug)]
pub struct Splat {
    kernel: Kernel,
    group: usize,
}

/// The sorted pairs of a view, shared by splat, splat_grad and seen.
#[derive(Debug)]
pub struct TileLists<'a, R: Real> {
    /// Records \[count\].
    pub records: &'a Array<Record<R>>,
    /// Gaussian of each pair, by emission slot \[pairs\].
    pub pair_owner: &'a Array<u32>,
    /// Emission slots sorted by tile, then depth \[pairs\].
    pub order: &'a Array<u32>,
    /// First pair of each tile \[tiles + 1\].
    pub tile_start: &'a Array<u32>,
    /// Pairs used of each tile \[tiles\] (written by splat).
    pub tile_used: &'a Array<u32>,
    /// Tiles per row, tiles.
    pub tiles: [usize; 2],
    /// Planes red, green, blue, transmittance \[4, rows, stride\] (written by splat).
    pub image: &'a Array<R>,
}

impl<R: Real> TileLists<'_, R> {
    /// Pixels of a padded plane.
    #[must_use]
    pub fn plane(&self) -> usize {
        self.tiles[1] * (TILE * TILE) as usize
    }
}

/// Work-items of a launch that covers every tile: (global, local).
pub(super) fn tile_grid(tiles: usize, group: usize) -> ([usize; 2], [usize; 2]) {
    ([tiles * group, 1], [group, 1])
}

impl Splat {
    /// Builds the kernel.
    ///
    /// # Errors
    /// A build failure.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let [kernel] = kernels.build::<R, 1>("splat", ["splat"])?;
        Ok(Self {
            kernel,
            group: group_size(kernels),
        })
    }

    /// Enqueues the stage over a background colour.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn run<R: Real>(&self, a: &TileLists<'_, R>, background: [f32; 3]) -> Result<()> {
        let [tiles_x, tiles] = a.tiles;
        let bg = background.map(|c| R::of(f64::from(c)));
        let (global, local) = tile_grid(tiles, self.group);
        self.kernel
            .launch()
            .array(a.records, 1)
            .array(a.pair_owner, 1)
            .array(a.order, 1)
            .array(a.tile_start, tiles + 1)
            .value(tiles_x as i32)
            .value(tiles as i32)
            .value(bg[0])
            .value(bg[1])
            .value(bg[2])
            .array(a.image, 4 * a.plane())
            .array(a.tile_used, tiles)
            .run(global, local)
    }
}

/// Work-items per tile.
pub(super) fn group_size(kernels: &Kernels) -> usize {
    if kernels.defines().tuning.group_style {
        (TILE * TILE) as usize
    } else {
        1
    }
}

/// Tiles per row and in all, as [`TileLists::tiles`] wants them.
#[must_use]
pub fn tiles_of<R: Real>(camera: &CameraArg<R>) -> [usize; 2] {
    [camera.tiles[0] as usize, camera.tile_count()]
}
