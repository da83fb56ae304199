//! The optimiser under gradients of any size.

use crate::base::error::Result;
use crate::device::tuning::status;
use crate::device::{Array, Defines, Device, Kernels, Real};
use crate::lab::verify::cases::ADAM;
use crate::lab::verify::check::{EXACT, Row};
use crate::lab::verify::stress::family::host_row;
use crate::lab::verify::verification::FamilyNote;
use crate::pipeline::buffers::{GaussianBuffers, GradientBlock, ViewBuffers};
use crate::pipeline::stage::adam::{Adam, LearningRates, Step, adam};
use crate::scene::Plane;

/// Name, axis and bound of the family.
pub const NOTE: FamilyNote = FamilyNote {
    name: "optimiser",
    axis: "size of the gradients",
    bound: SINGLE,
    reason: "below 1e-17 the second moment is no normal number of f32, and counts for less beside ε than it should",
};
/// Bound in f32. Below 1e-17 the second moment is no normal number of f32 and counts for less beside ε than it should.
const SINGLE: f64 = 2e-3;
/// Gaussians: one vector of the widest kind and one more.
const N: usize = 32;

/// Rows of one precision.
pub fn rows<R: Real>(device: &Device, precision: &str, bound: f64) -> Result<Vec<Row>> {
    let sizes = [-30, -25, -20, -18, -15, -10, -5, 0, 5, 10, 17, 19, 25, 30];
    let mut rows = Vec::new();
    for size in sizes.map(|e| 10f64.powi(e)) {
        for (rate, what) in [(1e-2, "steps"), (0.0, "steps at rate 0")] {
            let errors = errors::<R>(device, size, rate)?;
            let case = format!("gradients of {size:.0e}");
            let quantity = format!("{what} ({precision})");
            rows.push(host_row(
                NOTE.name, &case, "adam", &quantity, size, &errors, bound,
            ));
        }
    }
    Ok(rows)
}

/// Rows of both precisions, if the device has f64.
///
/// # Errors
/// Those of [`rows`].
pub fn all(device: &Device) -> Result<Vec<Row>> {
    let mut all = rows::<f32>(device, "f32", SINGLE)?;
    if device.info().fp64 {
        all.extend(rows::<f64>(device, "f64", EXACT)?);
    }
    Ok(all)
}

/// Number of steps.
const STEPS: u32 = 3;

/// Errors of the parameters after the steps from 0, over the largest wanted one, and of the count of non-finite gradients.
fn errors<R: Real>(device: &Device, size: f64, rate: f64) -> Result<Vec<f64>> {
    let planes = Plane::count(0);
    let sign = |i: usize| if i.is_multiple_of(3) { -1.0 } else { 1.0 };
    let gradient = |i: usize| R::of(size * sign(i) * (1.0 + (i % 7) as f64));
    let gradients: Vec<R> = (0..planes * N).map(gradient).collect();
    let (got, counted) = stepped(device, &gradients, rate)?;
    let wide: Vec<f64> = gradients.iter().map(|g| (*g).into()).collect();
    let zeros = || vec![0.0; wide.len()];
    let (mut want, mut m, mut v, mut bad) = (zeros(), zeros(), zeros(), 0);
    for t in 1..=STEPS {
        let step = Step {
            rate,
            constants: ADAM,
            t,
        };
        bad += adam(&wide, &step, &mut want, &mut m, &mut v);
    }
    let largest = want.iter().fold(0.0f64, |l, w| l.max(w.abs()));
    let scale = if largest > 0.0 { largest } else { 1.0 };
    let (params, moments) = got.split_at(wide.len());
    let apart = params.iter().zip(&want).map(|(g, w)| (g - w).abs() / scale);
    let broken = |m: &f64| if m.is_finite() { 0.0 } else { f64::NAN };
    let mut errors: Vec<f64> = apart.chain(moments.iter().map(broken)).collect();
    errors.push(f64::from(counted.abs_diff(bad)));
    Ok(errors)
}

/// Parameters and both moments after the steps from 0 with the same gradients, and number of non-finite ones among those.
fn stepped<R: Real>(device: &Device, gradients: &[R], rate: f64) -> Result<(Vec<f64>, u32)> {
    let kernels = Kernels::new(device, Defines::new(device.tuning()));
    let stage = Adam::new::<R>(&kernels)?;
    let grads = Array::from_slice(device, "grads", gradients)?;
    let zeros = |name| Array::<R>::zeros(device, name, gradients.len());
    let scene = GaussianBuffers {
        params: zeros("params")?,
        filter: Array::zeros(device, "filter", 0)?,
        stride: N,
        count: N,
        sh_degree: 0,
    };
    let [moment1, moment2] = [zeros("moment1")?, zeros("moment2")?];
    let frame = ViewBuffers::new(device, &device.tuning(), false)?;
    let block = GradientBlock {
        values: &grads,
        planes: scene.planes(),
        stride: N,
        rows: 0..N,
    };
    for t in 1..=STEPS {
        let rate = LearningRates {
            position: rate,
            scale: rate,
            rotation: rate,
            opacity: rate,
            sh0: rate,
            sh: rate,
        };
        let step = Step {
            rate,
            constants: ADAM,
            t,
        };
        stage.run(&scene, [&moment1, &moment2], &block, &step, &frame)?;
    }
    let counted = frame.status.read(status::NON_FINITE as usize, 1)?[0];
    let all = [scene.params.to_vec()?, moment1.to_vec()?, moment2.to_vec()?].concat();
    Ok((all.into_iter().map(Into::into).collect(), counted))
}
