//! [`Optimizer`]: Adam's step with the gradients of the raw parameters.

use crate::base::error::Result;
use crate::device::{Kernels, Program};
use crate::pipeline::pass::Pipeline;
use crate::pipeline::stage::adam::Step;
use crate::pipeline::stage::project_grad;
use crate::train::gaussians::GaussianState;
use crate::train::plan::Plan;
use crate::train::schedule::Schedule;

/// Adam with the run's constants and schedule.
#[derive(Debug)]
pub struct Optimizer {
    /// One build for every SH degree.
    stages: Vec<Program>,
    pub(super) schedule: Schedule,
    /// β₁, β₂, ε.
    constants: [f64; 3],
    /// Weights of the regularisers on opacity and scale.
    lambdas: [f64; 2],
}

impl Optimizer {
    /// Builds the kernels.
    pub fn new(kernels: &Kernels, plan: &Plan) -> Result<Self> {
        let (o, l) = (&plan.config.optimizer, &plan.config.loss);
        let kernels = kernels.taking_steps();
        let build = |degree| kernels.of_degree(degree).build::<f32>("project_grad");
        let degrees = 0..=plan.sh_degree.value;
        Ok(Self {
            stages: degrees.map(build).collect::<Result<_>>()?,
            schedule: plan.schedule(),
            constants: [o.beta1, o.beta2, o.epsilon],
            lambdas: [l.lambda_opacity, l.lambda_scale],
        })
    }

    /// β₁, β₂, ε.
    #[must_use]
    pub fn constants(&self) -> [f64; 3] {
        self.constants
    }

    /// Takes the sums of the view rendered last back to the parameters and updates them.
    pub fn step(
        &self,
        pipeline: &Pipeline,
        gaussians: &GaussianState,
        iteration: u32,
        sh_degree: u32,
    ) -> Result<()> {
        let step = Step {
            rate: self.schedule.rates(iteration),
            constants: self.constants,
            t: iteration + 1,
        };
        let (stage, frame) = (&self.stages[sh_degree as usize], pipeline.home());
        let moments = gaussians.moments.each_ref();
        project_grad::update(stage, &gaussians.scene, frame, self.lambdas, moments, &step)
    }
}
