//! What some samplers add to an iteration. For the others these stages are not even built.

use crate::base::error::Result;
use crate::base::rng::Purpose;
use crate::config::TrainConfig;
use crate::density::{DensityControl, NoiseLaw, Wanted};
use crate::device::{Array, CameraArg, Device, Kernels};
use crate::pipeline::stage::importance::Importance;
use crate::pipeline::stage::noise::Noise;
use crate::pipeline::stage::screen_grad::ScreenGrad;
use crate::train::Trainer;

/// Stages of one sampler alone.
#[derive(Debug)]
pub(super) struct SamplerStages {
    noise: Option<(Noise, NoiseLaw)>,
    screen_grad: Option<ScreenGrad>,
    /// Gathers errors of views per Gaussian.
    pub(super) importance: Option<Importance>,
    /// Rows of cues that the sampler wants gathered.
    pub(super) cue_rows: usize,
}

impl SamplerStages {
    pub(super) fn new(kernels: &Kernels, density: &dyn DensityControl) -> Result<Self> {
        let wanted = density.wanted(1, 1.0);
        let noise = density.noise();
        Ok(Self {
            noise: noise
                .map(|law| Ok((Noise::new::<f32>(kernels)?, law)))
                .transpose()?,
            screen_grad: (wanted == Wanted::ScreenGradient)
                .then(|| ScreenGrad::new::<f32>(kernels))
                .transpose()?,
            importance: matches!(wanted, Wanted::Errors { .. })
                .then(|| Importance::new::<f32>(kernels))
                .transpose()?,
            cue_rows: wanted.rows(),
        })
    }

    /// Zeroed cues for so many Gaussians.
    pub(super) fn cues(&self, device: &Device, stride: usize) -> Result<Array<f32>> {
        Array::zeros(device, "cues", self.cue_rows * stride)
    }
}

/// Gaussians to make room for at the start: no more where the set never changes.
pub(super) fn capacity(config: &TrainConfig, count: usize) -> usize {
    match config.density_times() {
        None => count,
        Some(_) => crate::pipeline::buffers::Scene::<f32>::grown_stride(count),
    }
}

impl Trainer {
    /// The sampler's own part of an iteration, after the update: gradients on the screen are added up until the last density
    /// step, noise goes on to the end.
    pub(super) fn sample(&self, iteration: u32, camera: &CameraArg<f32>) -> Result<()> {
        let (frame, scene) = (&self.renderer.frame, &self.scene);
        if let Some(stage) = &self.sampler.screen_grad
            && self.schedule.next_density(iteration).is_some()
        {
            stage.run(scene, frame, camera, &self.cues)?;
        }
        if let Some((stage, law)) = &self.sampler.noise {
            let law = NoiseLaw {
                rate: law.rate * self.schedule.position_rate(iteration),
                ..*law
            };
            let stream = Purpose::Noise.stream(iteration);
            stage.run(scene, frame, &law, self.config.seed, stream)?;
        }
        Ok(())
    }
}
