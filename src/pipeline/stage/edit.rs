//! The set of Gaussians changes: rows that density control decided on, another order (`kernels/edit.cl`).

use crate::base::error::Result;
use crate::density;
use crate::device::{Array, EditRow, Kernel, Kernels, Real};
use crate::scene::Plane;

/// The edit stage.
#[derive(Debug)]
pub struct Edit {
    rows: Kernel,
    limit_opacity: Kernel,
    reorder: Kernel,
    local: usize,
}

/// Arguments of [`Edit::run`].
#[derive(Debug)]
pub struct EditArgs<'a, R: Real> {
    /// Rows \[edits\].
    pub edits: &'a Array<EditRow>,
    /// Gaussians allocated.
    pub stride: usize,
    /// Planes.
    pub planes: usize,
    /// In/out \[planes, stride\].
    pub params: &'a Array<R>,
    /// In/out \[planes, stride\].
    pub moment1: &'a Array<R>,
    /// In/out \[planes, stride\].
    pub moment2: &'a Array<R>,
}

impl From<&density::Edit> for EditRow {
    fn from(e: &density::Edit) -> Self {
        Self {
            src: e.src,
            dst: e.dst,
            position: e.position,
            log_scale: e.log_scale,
            opacity_logit: e.opacity_logit,
            colored: u32::from(e.color.is_some()),
            color: e.color.unwrap_or_default(),
        }
    }
}

impl Edit {
    /// Builds the kernel.
    ///
    /// # Errors
    /// A build failure.
    pub fn new<R: Real>(kernels: &Kernels) -> Result<Self> {
        let names = ["edit", "edit_limit_opacity", "edit_reorder"];
        let [rows, limit_opacity, reorder] = kernels.build::<R, 3>("edit", names)?;
        Ok(Self {
            rows,
            limit_opacity,
            reorder,
            local: kernels.defines().tuning.local,
        })
    }

    /// Enqueues the edits.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn run<R: Real>(&self, a: &EditArgs<'_, R>) -> Result<()> {
        if a.edits.is_empty() {
            return Ok(());
        }
        let len = a.planes * a.stride;
        self.rows
            .launch()
            .array(a.edits, a.edits.len())
            .value(a.edits.len() as u32)
            .value(a.stride as u32)
            .array(a.params, len)
            .array(a.moment1, len)
            .array(a.moment2, len)
            .run([a.edits.len(), a.planes], [self.local, 1])
    }

    /// Lowers every opacity logit of the first `count` Gaussians to `limit` and zeroes its moments; `a.edits` is not used.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn limit_opacity<R: Real>(
        &self,
        a: &EditArgs<'_, R>,
        count: usize,
        limit: f64,
    ) -> Result<()> {
        let len = (Plane::OPACITY + 1) * a.stride;
        self.limit_opacity
            .launch()
            .value(count as u32)
            .value(a.stride as u32)
            .value(R::of(limit))
            .array(a.params, len)
            .array(a.moment1, len)
            .array(a.moment2, len)
            .run([count, 1], [self.local, 1])
    }

    /// Planes of `from` \[planes, stride\] with row `order[i]` as row i, in `to`; rows beyond `order` stay as they are.
    ///
    /// # Errors
    /// Arrays that are too short, or the driver's.
    pub fn reorder<R: Real>(
        &self,
        order: &Array<u32>,
        [planes, stride]: [usize; 2],
        from: &Array<R>,
        to: &Array<R>,
    ) -> Result<()> {
        self.reorder
            .launch()
            .array(order, order.len())
            .value(order.len() as u32)
            .value(stride as u32)
            .array(from, planes * stride)
            .array(to, planes * stride)
            .run([order.len(), planes], [self.local, 1])
    }
}

/// Applies edits to planes \[planes\]\[rows\] of parameters and moments.
pub fn edit(edits: &[density::Edit], params: &mut [Vec<f64>], moments: [&mut [Vec<f64>]; 2]) {
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
