//! What the stages left on the device, read back in one precision for all.

use crate::base::constants::TILE;
use crate::base::error::Result;
use crate::device::tuning::status;
use crate::device::{CameraArg, Projected, Real};
use crate::lab::verify::chain::Outputs;
use crate::pipeline::buffers::GaussianBuffers;
use crate::pipeline::forward::Renderer;

pub(super) fn widen<R: Real>(values: Vec<R>) -> Vec<f64> {
    values.into_iter().map(Into::into).collect()
}

pub(super) fn read_forward<R: Real>(
    renderer: &Renderer<R>,
    scene: &GaussianBuffers<R>,
    camera: &CameraArg<R>,
    out: &mut Outputs,
) -> Result<()> {
    let f = &renderer.frame;
    let keys = f.keys.read(0, scene.count)?;
    let records = f.records.read(0, scene.count)?;
    out.records = keys
        .iter()
        .zip(records)
        .map(|(key, r)| {
            (*key != crate::device::tuning::KEY_CULLED).then(|| Projected {
                x: r.x.into(),
                y: r.y.into(),
                a: r.a.into(),
                r: r.r.into(),
                c: r.c.into(),
                lo: r.lo.into(),
                rgb: r.rgb.map(Into::into),
                depth: r.depth.into(),
                bx: r.bx,
                by: r.by,
            })
        })
        .collect();
    let pairs = f.status.read(status::INTERSECTIONS as usize, 1)?[0] as usize;
    let visible = f.status.read(status::VISIBLE as usize, 1)?[0] as usize;
    out.counted = f.counts.read(0, visible)?.iter().map(|c| *c as usize).sum();
    let order = f.order.sorted_values().read(0, pairs)?;
    let owner = f.isect_owner.read(0, pairs)?;
    let start = f.tile_start.read(0, camera.tile_count() + 1)?;
    out.tiles = start
        .windows(2)
        .map(|w| {
            order[w[0] as usize..w[1] as usize]
                .iter()
                .map(|slot| owner[*slot as usize])
                .collect()
        })
        .collect();
    let planes = widen(f.image.read(0, 4 * camera.plane())?);
    out.image = crop(&planes, camera, 0..3);
    out.transmittance = crop(&planes, camera, 3..4);
    Ok(())
}

/// Planes of a padded image without the padding.
pub(super) fn crop<R: Real>(
    padded: &[f64],
    camera: &CameraArg<R>,
    planes: std::ops::Range<usize>,
) -> Vec<f64> {
    let [w, h] = camera.size.map(|s| s as usize);
    let [stride, rows] = camera.tiles.map(|t| t as usize * TILE as usize);
    planes
        .flat_map(|c| (0..h).map(move |y| (c * rows + y) * stride))
        .flat_map(|from| padded[from..from + w].iter().copied())
        .collect()
}
