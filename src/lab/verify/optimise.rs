//! Steps of the optimiser with given gradients.

use crate::base::error::Result;
use crate::device::{Array, Kernels, Real};
use crate::lab::verify::cases::ADAM;
use crate::pipeline::buffers::{GaussianBuffers, GradientBlock, ViewBuffers};
use crate::pipeline::stage::adam::{self, LearningRates, Step};

/// Both moments after steps of the optimiser with the same gradients, which change the scene.
pub(super) fn optimise<R: Real>(
    kernels: &Kernels,
    scene: &GaussianBuffers<R>,
    block: &GradientBlock<'_, R>,
    (rate, steps): (LearningRates, u32),
    frame: &ViewBuffers<R>,
) -> Result<[Array<R>; 2]> {
    let stage = kernels.build::<R>("adam")?;
    let zeros = |name| Array::zeros(kernels.device(), name, scene.params.len());
    let [m, v] = [zeros("moment1")?, zeros("moment2")?];
    for t in 1..=steps {
        let step = Step {
            rate,
            constants: ADAM,
            t,
        };
        adam::update(&stage, scene, [&m, &v], block, &step, frame)?;
    }
    Ok([m, v])
}
