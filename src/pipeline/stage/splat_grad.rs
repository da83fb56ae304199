//! Derivative of the compositing (`kernels/splat_grad.cl`).

use crate::base::error::Result;
use crate::device::{Array, Program, Real};
use crate::pipeline::buffers::ViewBuffers;
use crate::pipeline::launch::Arguments;
use crate::pipeline::reference::{Camera64, Options};
use crate::pipeline::stage::project::Projected64;
use crate::pipeline::stage::splat::{contributions, list_at};

/// Writes nine sums for each pair of the view composited last, from the gradient of the loss with respect to its image.
pub fn backward<R: Real>(stage: &Program, view: &ViewBuffers<R>, dimage: &Array<R>) -> Result<()> {
    let size = view.camera.image();
    let launch = stage
        .launch("splat_grad")
        .tile_lists(view)
        .array(&view.tile_used, size.tile_count())
        .tiles(size)
        .array(&view.image, 4 * size.plane())
        .array(dimage, 3 * size.plane());
    let tuning = &stage.defines().tuning;
    if !tuning.group_style {
        return launch.array(&view.sums, 1).over_tiles(size, &view.band);
    }
    // One at least: a launch needs a work-group where the band has no tiles.
    let runs = view.capacity.div_ceil(tuning.grad_segment as usize).max(1);
    let across = size.tiles()[0];
    let group = tuning.grad_group as usize;
    launch
        .uints([runs, view.band.start * across])
        .status(view)
        .array(view.tile_of_pairs(), 1)
        .array(&view.snapshots, tuning.snapshot_values(view.capacity))
        .array(&view.sums, 1)
        .run([(runs + view.band.len() * across) * group, 1], [group, 1])
}

// Definition in f64.

/// Nine sums of each Gaussian: g, g·u, g·dy, g·u², g·u·dy, g·dy² with g = dL/dα·α (0 where α is capped), then
/// α·T·dL/dcolour.
#[must_use]
pub fn splat_grad(
    projected: &[Option<Projected64>],
    tiles: &[Vec<u32>],
    camera: &Camera64,
    options: &Options,
    dimage: &[f64],
) -> Vec<[f64; 9]> {
    let n = camera.pixels();
    let mut sums = vec![[0.0; 9]; projected.len()];
    for y in 0..camera.size[1] {
        for x in 0..camera.size[0] {
            let at = (y * camera.size[0] + x) as usize;
            let d: [f64; 3] = std::array::from_fn(|c| dimage[c * n + at]);
            let list = list_at(tiles, camera, x, y);
            let (parts, _) = contributions(projected, list, x, y, options.alpha_min);
            // Colour seen behind a contribution, per unit of transmittance: starts with the background.
            let mut behind = options.background;
            for p in parts.iter().rev() {
                let Some(g) = &projected[p.gaussian as usize] else {
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
