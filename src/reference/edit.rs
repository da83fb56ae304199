//! Twin of `kernels/edit.cl`.

use crate::density::Edit;
use crate::model::Plane;

/// Applies edits to planes \[planes\]\[rows\] of parameters and moments.
pub fn edit(edits: &[Edit], params: &mut [Vec<f64>], moments: [&mut [Vec<f64>]; 2]) {
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
        if let Some(color) = e.color {
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
