//! The exposure stage in the check: on the image and the gradient that the stages before it gave.

use crate::base::error::Result;
use crate::device::{Array, Real};
use crate::lab::verify::chain::{ADAM, ExposureOutputs, Outputs, Run};
use crate::lab::verify::readback::{crop, widen};
use crate::pipeline::stage::adam::{Step, adam};
use crate::pipeline::stage::exposure::{ENTRIES, Exposures, IDENTITY, apply, backward, center};

/// The transforms of the views in every case, the second being that of the case's: a brightening with some mixing of
/// channels. Exact in f32.
pub const EXPOSURES: [[f64; 12]; 3] = [
    IDENTITY,
    [
        1.25, 0.0625, -0.03125, 0.015625, -0.125, 0.875, 0.25, -0.0625, 0.03125, 0.5, 0.75, 0.125,
    ],
    IDENTITY,
];
/// The case's view.
const VIEW: usize = 1;
/// Learning rate of both steps.
const RATE: f64 = 0.01;

impl<R: Real> Run<'_, R> {
    /// The stage on copies of the image's transform and of the gradient `dimage`.
    pub(super) fn exposure(&self, dimage: &Array<R>, plane: usize) -> Result<ExposureOutputs> {
        let (device, stage) = (self.device, &self.stages.exposure);
        let e = Exposures::<R>::new(device, stage, EXPOSURES.len(), plane)?;
        let start: Vec<R> = EXPOSURES.as_flattened().iter().map(|v| R::of(*v)).collect();
        e.transforms.write(0, &start)?;
        let gradient = Array::zeros(device, "dimage", 3 * plane)?;
        gradient.copy_from(0, dimage, 0, 3 * plane)?;
        let frame = &self.renderer.frame;
        stage.apply(&frame.image, plane, &e, VIEW)?;
        stage.backward(&frame.image, plane, &e, VIEW, &gradient)?;
        for t in 1..=2 {
            let step = Step {
                rate: RATE,
                constants: ADAM,
                t,
            };
            stage.step(&e, VIEW, &step, &frame.status)?;
        }
        let image = |a: &Array<R>| Ok(crop(&widen(a.to_vec()?), &self.camera, 0..3));
        Ok(ExposureOutputs {
            image: image(&e.corrected)?,
            dimage: image(&gradient)?,
            grads: widen(e.grads.to_vec()?),
            adam: [
                widen(e.transforms.to_vec()?),
                widen(e.moments[0].to_vec()?),
                widen(e.moments[1].to_vec()?),
            ],
        })
    }
}

/// The same from the reference, from the device's own image and gradients.
#[must_use]
pub fn reference(device: &Outputs) -> ExposureOutputs {
    let exposure = &EXPOSURES[VIEW];
    let (dimage, grads) = backward(&device.image, exposure, &device.dimage);
    let mut params = EXPOSURES.as_flattened().to_vec();
    let (mut m, mut v) = (vec![0.0; params.len()], vec![0.0; params.len()]);
    let mut all = vec![0.0; params.len()];
    all[VIEW * ENTRIES..(VIEW + 1) * ENTRIES].copy_from_slice(&device.exposure.grads);
    for t in 1..=2 {
        let step = Step {
            rate: RATE,
            constants: ADAM,
            t,
        };
        adam(&all, &step, &mut params, &mut m, &mut v);
        center(&mut params);
    }
    ExposureOutputs {
        image: apply(&device.image, exposure),
        dimage,
        grads: grads.to_vec(),
        adam: [params, m, v],
    }
}

/// The largest sum of magnitudes of the terms of dL/d\[A | b\].
#[must_use]
pub fn largest_sum(device: &Outputs) -> f64 {
    let magnitudes = |v: &[f64]| v.iter().map(|v| v.abs()).collect::<Vec<f64>>();
    let (_, sums) = backward(
        &magnitudes(&device.image),
        &IDENTITY,
        &magnitudes(&device.dimage),
    );
    sums.into_iter().fold(0.0, f64::max)
}
