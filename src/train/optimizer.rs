//! [`Optimizer`]: Adam's step with the gradients of the raw parameters.

use std::ops::Range;

use crate::base::error::Result;
use crate::device::{Kernels, Program};
use crate::pipeline::pass::Pipeline;
use crate::pipeline::stage::adam::Step;
use crate::pipeline::stage::{adam, project_grad};
use crate::train::gaussians::GaussianState;
use crate::train::plan::Plan;
use crate::train::schedule::Schedule;

/// Adam with the run's constants and schedule.
#[derive(Debug)]
pub struct Optimizer {
    /// One build for every SH degree.
    stages: Vec<Program>,
    /// Step with the mean gradient of a batch; `None` where every view has a step of its own, which the stages take.
    batched: Option<Program>,
    pub(super) schedule: Schedule,
    /// β₁, β₂ of runs of 30,000 iterations, ε.
    constants: [f64; 3],
    /// Views of a batch.
    batch: u32,
    /// Weights of the regularisers on opacity and scale.
    lambdas: [f64; 2],
}

impl Optimizer {
    /// Builds the kernels.
    pub fn new(kernels: &Kernels, plan: &Plan) -> Result<Self> {
        let (o, l) = (&plan.config.optimizer, &plan.config.loss);
        let batch = plan.config.batch;
        let stages = match batch {
            1 => kernels.taking_steps(),
            _ => kernels.clone(),
        };
        let build = |degree| stages.of_degree(degree).build::<f32>("project_grad");
        let degrees = 0..=plan.sh_degree.value;
        let batched = (batch > 1).then(|| kernels.build::<f32>("adam"));
        Ok(Self {
            stages: degrees.map(build).collect::<Result<_>>()?,
            batched: batched.transpose()?,
            schedule: plan.schedule(),
            constants: [o.beta1, o.beta2, o.epsilon],
            lambdas: [l.lambda_opacity, l.lambda_scale],
            batch,
        })
    }

    /// β₁, β₂, ε of steps of single views in runs of 30,000 iterations, and of the colour transforms in all: a photo's comes once in an epoch.
    #[must_use]
    pub fn constants(&self) -> [f64; 3] {
        self.constants
    }

    /// Takes the sums of some rows in the view rendered last back to the parameters and updates them, or adds their gradients to those of the
    /// batch, whose last view updates the parameters.
    pub fn step(
        &self,
        pipeline: &Pipeline,
        gaussians: &GaussianState,
        [iteration, sh_degree]: [u32; 2],
        rows: Range<usize>,
    ) -> Result<()> {
        let (stage, frame) = (&self.stages[sh_degree as usize], pipeline.frame());
        let (scene, moments) = (&gaussians.scene, gaussians.moments.each_ref());
        if self.batched.is_some() {
            let views = self.schedule.views_before(iteration);
            let sums = gaussians.gradients(views, rows.clone());
            project_grad::backward(stage, scene, frame, self.lambdas, &sums)?;
        }
        let Some(t) = self.schedule.step_of(iteration) else {
            return Ok(());
        };
        let [beta1, _, epsilon] = self.constants;
        let beta2 = self.schedule.beta2(iteration);
        // The moments forget a view as fast as if each had a step of its own.
        let [beta1, beta2] = [beta1, beta2].map(|beta| beta.powf(self.batch.into()));
        let correction = self.schedule.memory_correction(iteration);
        let step = Step {
            rate: self.schedule.rates(iteration).times(correction),
            constants: [beta1, beta2, epsilon],
            t,
        };
        match &self.batched {
            Some(adam) => {
                let sums = gaussians.gradients(self.batch as usize, rows);
                adam::update(adam, scene, moments, &sums, &step, frame)
            }
            None => {
                let of = (frame, rows);
                project_grad::update(stage, scene, of, self.lambdas, moments, &step)
            }
        }
    }
}
