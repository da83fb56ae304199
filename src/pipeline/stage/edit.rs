//! Changes of the set of Gaussians: rows that density control writes, an opacity reset, another order (`kernels/edit.cl`).

use crate::base::error::Result;
use crate::device::{Array, Program, Real};
use crate::pipeline::buffers::GaussianBuffers;
use crate::scene::{self, Plane};

/// Writes rows of parameters and moments.
pub fn write_rows<R: Real>(
    stage: &Program,
    scene: &GaussianBuffers<R>,
    [m, v]: [&Array<R>; 2],
    edits: &Array<scene::Edit>,
) -> Result<()> {
    if edits.is_empty() {
        return Ok(());
    }
    stage
        .launch("edit")
        .array(edits, edits.len())
        .uints([edits.len(), scene.stride])
        .arrays([&scene.params, m, v], scene.planes() * scene.stride)
        .over_items([edits.len(), scene.planes()])
}

/// Lowers the opacity logits to `limit` at most and clears their moments.
pub fn limit_opacity<R: Real>(
    stage: &Program,
    scene: &GaussianBuffers<R>,
    [m, v]: [&Array<R>; 2],
    limit: f64,
) -> Result<()> {
    stage
        .launch("edit_limit_opacity")
        .uints([scene.count, scene.stride])
        .reals::<R>([limit])
        .arrays([&scene.params, m, v], (Plane::OPACITY + 1) * scene.stride)
        .over_items([scene.count, 1])
}

/// Copies row `order[i]` of `planes` planes of `from`, from the plane `first` on, to row i of the first planes of `to`, whose rows beyond
/// the first `kept` are zero.
pub fn gather_rows<R: Real>(
    stage: &Program,
    (order, kept): (&Array<u32>, usize),
    [first, planes, stride]: [usize; 3],
    [from, to]: [&Array<R>; 2],
) -> Result<()> {
    stage
        .launch("edit_reorder")
        .array(order, kept)
        .uints([kept, stride, first])
        .array(from, (first + planes) * stride)
        .array(to, planes * stride)
        .over_items([stride, planes])
}

/// Packs the first planes of the parameters and `rows` rows of statistics \[planes + rows, N\].
pub fn pack<R: Real>(
    stage: &Program,
    scene: &GaussianBuffers<R>,
    (statistics, rows): (&Array<R>, usize),
    packed: &Array<R>,
) -> Result<()> {
    let planes = Plane::SH;
    stage
        .launch("edit_pack")
        .uints([scene.count, scene.stride, planes])
        .array(&scene.params, planes * scene.stride)
        .array(statistics, rows * scene.stride)
        .array(packed, (planes + rows) * scene.count)
        .over_items([scene.count, planes + rows])
}

// Definition in f64.

/// Applies edits to planes \[planes\]\[rows\] of parameters and moments.
pub fn edit(edits: &[scene::Edit], params: &mut [Vec<f64>], moments: [&mut [Vec<f64>]; 2]) {
    let before: Vec<Vec<f64>> = params.to_vec();
    for e in edits {
        let (src, dst) = (e.src as usize, e.dst as usize);
        for (p, plane) in params.iter_mut().enumerate() {
            plane[dst] = before[p][src];
        }
        for k in 0..3 {
            params[Plane::POSITION + k][dst] = f64::from(e.position[k]);
            params[Plane::LOG_SCALE + k][dst] = f64::from(e.log_scale[k]);
        }
        params[Plane::OPACITY][dst] = f64::from(e.opacity_logit);
        if let Some(color) = e.color.get() {
            for (k, plane) in params[Plane::SH..].iter_mut().enumerate() {
                plane[dst] = color.get(k).map_or(0.0, |c| f64::from(*c));
            }
        }
    }
    for planes in moments {
        for plane in planes.iter_mut() {
            for e in edits {
                plane[e.dst as usize] = 0.0;
            }
        }
    }
}

/// A plane with row `order[i]` as row i.
#[must_use]
pub fn reorder(order: &[u32], plane: &[f64]) -> Vec<f64> {
    order.iter().map(|&i| plane[i as usize]).collect()
}
