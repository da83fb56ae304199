//! Derivative of the compositing (`kernels/splat_grad.cl`).

use crate::base::error::Result;
use crate::device::{Array, Kernel, Kernels, Real};
use crate::pipeline::reference::{Camera64, Options};
use crate::pipeline::stage::project::Record64;
use crate::pipeline::stage::splat::{TileLists, contributions, group_size, list_at, tile_grid};

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

/// Nine sums of each Gaussian: g, g·u, g·dy, g·u², g·u·dy, g·dy² with g = dL/dα·α (0 where α is capped), then
/// α·T·dL/dcolour.
#[must_use]
pub fn splat_grad(
    records: &[Option<Record64>],
    tiles: &[Vec<u32>],
    camera: &Camera64,
    options: &Options,
    dimage: &[f64],
) -> Vec<[f64; 9]> {
    let n = camera.pixels();
    let mut sums = vec![[0.0; 9]; records.len()];
    for y in 0..camera.size[1] {
        for x in 0..camera.size[0] {
            let at = (y * camera.size[0] + x) as usize;
            let d: [f64; 3] = std::array::from_fn(|c| dimage[c * n + at]);
            let list = list_at(tiles, camera, x, y);
            let (parts, _) = contributions(records, list, x, y, options.alpha_min);
            // Colour seen behind a contribution, per unit of transmittance: starts with the background.
            let mut behind = options.background;
            for p in parts.iter().rev() {
                let Some(g) = &records[p.gaussian as usize] else {
                    continue;
                };
                let dot: f64 = (0..3).map(|c| d[c] * (g.rgb[c] - behind[c])).sum();
                let gr = if p.capped {
                    0.0
                } else {
                    p.transmittance * dot * p.alpha
                };
                let [u, dy] = g.offsets(x, y);
                let s = &mut sums[p.gaussian as usize];
                for (k, v) in [1.0, u, dy, u * u, u * dy, dy * dy].into_iter().enumerate() {
                    s[k] += gr * v;
                }
                for c in 0..3 {
                    s[6 + c] += p.alpha * p.transmittance * d[c];
                    behind[c] = p.alpha * g.rgb[c] + (1.0 - p.alpha) * behind[c];
                }
            }
        }
    }
    sums
}
