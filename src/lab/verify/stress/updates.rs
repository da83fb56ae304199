//! The optimiser under gradients of any size.

use crate::base::error::Result;
use crate::device::tuning::status;
use crate::device::{Array, Defines, Device, Kernels, Real};
use crate::lab::verify::check::{FamilyNote, Row};
use crate::lab::verify::definition::steps;
use crate::lab::verify::optimise::optimise;
use crate::lab::verify::pass::widen;
use crate::pipeline::buffers::{GaussianBuffers, GradientBlock, ViewBuffers};
use crate::pipeline::stage::adam::LearningRates;
use crate::scene::Plane;

/// Name, axis and bound of the family.
pub const NOTE: FamilyNote = FamilyNote {
    name: "optimiser",
    axis: "size of the gradients",
    bound: 2e-3,
    reason: "below 1e-17 the second moment is no normal number of f32, and counts for less beside ε than it should",
};
/// Gaussians: one vector of the widest kind and one more.
const N: usize = 32;
/// Number of steps.
const STEPS: u32 = 3;

/// Rows of one precision.
pub fn rows<R: Real>(device: &Device, precision: &str, bound: f64) -> Result<Vec<Row>> {
    let sizes = [-30, -25, -20, -18, -15, -10, -5, 0, 5, 10, 17, 19, 25, 30];
    let mut rows = Vec::new();
    for size in sizes.map(|e| 10f64.powi(e)) {
        for (rate, what) in [(1e-2, "steps"), (0.0, "steps at rate 0")] {
            let errors = errors::<R>(device, size, rate)?;
            let case = format!("gradients of {size:.0e}");
            let names = [case.as_str(), &format!("{what} ({precision})")];
            let of = [NOTE.name, "adam"];
            rows.push(Row::of_errors(of, names, size, &errors, bound));
        }
    }
    Ok(rows)
}

/// Errors of the parameters after the steps from 0, over the largest wanted one, and of the count of non-finite gradients.
fn errors<R: Real>(device: &Device, size: f64, rate: f64) -> Result<Vec<f64>> {
    let planes = Plane::count(0);
    let sign = |i: usize| if i.is_multiple_of(3) { -1.0 } else { 1.0 };
    let gradient = |i: usize| R::of(size * sign(i) * (1.0 + (i % 7) as f64));
    let gradients: Vec<R> = (0..planes * N).map(gradient).collect();
    let scene = GaussianBuffers {
        params: Array::<R>::zeros(device, "params", planes * N)?,
        filter: Array::zeros(device, "filter", 0)?,
        stride: N,
        count: N,
        sh_degree: 0,
        shard: None,
    };
    let block = GradientBlock {
        values: &Array::from_slice(device, "grads", &gradients)?,
        planes,
        stride: N,
        first: 0,
        rows: 0..N,
        views: 1,
    };
    let rates = LearningRates {
        position: rate,
        scale: rate,
        rotation: rate,
        opacity: rate,
        sh0: rate,
        sh: rate,
    };
    let kernels = Kernels::new(device, Defines::new(device.tuning()));
    let frame = ViewBuffers::new(device, &device.tuning(), false)?;
    let moments = optimise(&kernels, &scene, &block, (rates, STEPS), &frame)?;
    let counted = frame.status.read(status::NON_FINITE as usize, 1)?[0];

    let gradients = widen(gradients);
    let zeros = vec![0.0; gradients.len()];
    let ([want, ..], bad) = steps(zeros, &gradients, (rate, STEPS), |_| ());
    let largest = want.iter().fold(0.0f64, |l, w| l.max(w.abs()));
    let scale = if largest > 0.0 { largest } else { 1.0 };
    let got = widen(scene.params.to_vec()?);
    let apart = got.iter().zip(&want).map(|(g, w)| (g - w).abs() / scale);
    let mut errors: Vec<f64> = apart.collect();
    for moment in moments {
        let broken = |m: f64| if m.is_finite() { 0.0 } else { f64::NAN };
        errors.extend(widen(moment.to_vec()?).into_iter().map(broken));
    }
    errors.push(f64::from(counted.abs_diff(bad)));
    Ok(errors)
}
