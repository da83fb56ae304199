//! [`Optimizer`]: gradients of the raw parameters and Adam's step, block by block.

use crate::base::error::Result;
use crate::device::{Array, Kernels, Program};
use crate::pipeline::buffers::GradientBlock;
use crate::pipeline::pass::Pipeline;
use crate::pipeline::stage::adam::{self, Step};
use crate::scene::Plane;
use crate::train::gaussians::GaussianState;
use crate::train::plan::Plan;
use crate::train::schedule::Schedule;

/// Adam with the run's constants and schedule.
#[derive(Debug)]
pub struct Optimizer {
    adam: Program,
    pub(super) schedule: Schedule,
    /// β₁, β₂, ε.
    constants: [f64; 3],
    /// Weights of the regularisers on opacity and scale.
    lambdas: [f64; 2],
    /// Gradients of one block \[planes, block\].
    grads: Array<f32>,
    block: usize,
}

impl Optimizer {
    /// Builds the kernel.
    pub fn new(kernels: &Kernels, plan: &Plan) -> Result<Self> {
        let (o, l) = (&plan.config.optimizer, &plan.config.loss);
        let block = kernels.defines().tuning.update_block;
        let planes = Plane::count(plan.sh_degree.value);
        Ok(Self {
            adam: kernels.build::<f32>("adam")?,
            schedule: Schedule::new(&plan.config),
            constants: [o.beta1, o.beta2, o.epsilon],
            lambdas: [l.lambda_opacity, l.lambda_scale],
            grads: Array::zeros(kernels.device(), "grads", planes * block)?,
            block,
        })
    }

    /// β₁, β₂, ε.
    #[must_use]
    pub fn constants(&self) -> [f64; 3] {
        self.constants
    }

    /// Takes the view's gradients back to the parameters and updates them, block by block: a block's gradients are used while
    /// they are still in cache.
    pub fn step(
        &self,
        pipeline: &Pipeline,
        gaussians: &GaussianState,
        iteration: u32,
        sh_degree: u32,
    ) -> Result<()> {
        let (scene, count) = (&gaussians.scene, gaussians.scene.count);
        let moments = gaussians.moments.each_ref();
        let step = Step {
            rate: self.schedule.rates(iteration),
            constants: self.constants,
            t: iteration + 1,
        };
        // Once for no Gaussians, too: warming up builds the kernels so.
        for first in (0..count.max(1)).step_by(self.block) {
            let grads = GradientBlock {
                values: &self.grads,
                planes: Plane::count(sh_degree),
                stride: self.block,
                rows: first..count.min(first + self.block),
            };
            pipeline.parameter_gradient(scene, sh_degree, self.lambdas, &grads)?;
            let frame = &pipeline.forward.frame;
            adam::update(&self.adam, scene, moments, &grads, &step, frame)?;
        }
        Ok(())
    }
}
