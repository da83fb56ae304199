//! Which Gaussians views show (`kernels/seen.cl`).

use crate::base::error::Result;
use crate::device::{Array, Kernel, Kernels, Real};
use crate::pipeline::reference::Camera64;
use crate::pipeline::stage::project::Record64;
use crate::pipeline::stage::splat::{TileLists, contributions, group_size, list_at, tile_grid};

/// The seen stage.
#[derive(Debug)]
pub struct Seen {
    pairs: Kernel,
    gather: Kernel,
    group: usize,
    local: usize,
}

/// Arguments of [`Seen::run`].
#[derive(Debug)]
pub struct SeenArgs<'a, R: Real> {
    /// Gaussians.
    pub count: usize,
    /// Sorted pairs of the view; its image is not looked at.
    pub lists: TileLists<'a, R>,
    /// Width and height of the image, pixels: its padding does not count.
    pub size: [usize; 2],
    /// First pair of each Gaussian \[count\].
    pub pair_start: &'a Array<u32>,
    /// Pairs of each Gaussian \[count\].
    pub pair_counts: &'a Array<u32>,
    /// Scratch \[pairs\]: 1 where a pixel shows a pair of a Gaussian that was not seen before.
    pub shown: &'a Array<u8>,
    /// In/out \[count\]: 1 once a pixel of any view has shown a Gaussian.
    pub seen: &'a Array<u32>,
}

impl Seen {
    /// Builds the kernels.
    ///
    /// # Errors
    /// A build failure.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let [pairs, gather] = kernels.build::<R, 2>("seen", ["seen_pairs", "seen_gather"])?;
        Ok(Self {
            pairs,
            gather,
            group: group_size(kernels),
            local: kernels.defines().tuning.local,
        })
    }

    /// Enqueues the stage for one view.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn run<R: Real>(&self, a: &SeenArgs<'_, R>) -> Result<()> {
        let [tiles_x, tiles] = a.lists.tiles;
        let (global, local) = tile_grid(tiles, self.group);
        self.pairs
            .launch()
            .array(a.lists.records, 1)
            .array(a.lists.pair_owner, 1)
            .array(a.lists.order, 1)
            .array(a.lists.tile_start, tiles + 1)
            .value(tiles_x as i32)
            .value(tiles as i32)
            .value(a.size[0] as i32)
            .value(a.size[1] as i32)
            .array(a.seen, a.count)
            .array(a.shown, a.lists.pair_owner.len())
            .run(global, local)?;
        self.gather
            .launch()
            .value(a.count as u32)
            .array(a.pair_start, a.count)
            .array(a.pair_counts, a.count)
            .array(a.shown, 1)
            .array(a.seen, a.count)
            .run([a.count, 1], [self.local, 1])
    }
}

/// Whether a pixel of a view shows each Gaussian: adds α·T > 0 of its colour.
#[must_use]
pub fn seen(
    records: &[Option<Record64>],
    tiles: &[Vec<u32>],
    camera: &Camera64,
    alpha_min: f64,
) -> Vec<bool> {
    let mut seen = vec![false; records.len()];
    for y in 0..camera.size[1] {
        for x in 0..camera.size[0] {
            let list = list_at(tiles, camera, x, y);
            for part in contributions(records, list, x, y, alpha_min).0 {
                seen[part.gaussian as usize] |= part.alpha * part.transmittance > 0.0;
            }
        }
    }
    seen
}
