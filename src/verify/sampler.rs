//! The stages that some samplers add to an iteration.

use super::chain::{Outputs, Run};
use super::readback::widen;
use crate::density::NoiseLaw;
use crate::error::Result;
use crate::gpu::{Array, Real};
use crate::model::Plane;
use crate::stage::loss::size_of_image;
use crate::stage::noise::NoiseArgs;
use crate::stage::screen_grad::ScreenGradArgs;
use crate::stage::weight::{WeightArgs, red_image};

/// The noise of every case: gentle enough a gate that all Gaussians take part, and as long as the scene is large.
pub const NOISE: NoiseLaw = NoiseLaw {
    rate: 100.0,
    steepness: 4.0,
    opacity: 0.5,
};
/// Seed and stream of the noise: high words that are not zero, so that none may be dropped.
pub const NOISE_KEYS: [u64; 2] = [0x0123_4567_89ab_cdef, (13 << 32) | 777];

impl<R: Real> Run<'_, R> {
    /// What some samplers add to an iteration; the noise on a copy of the parameters.
    pub(super) fn sampler_stages(&mut self, out: &mut Outputs) -> Result<()> {
        let (device, s, f) = (self.device, &self.stages, &self.renderer.frame);
        let (stride, count) = (self.scene.stride, self.scene.count);
        let moved = Array::zeros(device, "params", self.scene.params.len())?;
        moved.copy_from(0, &self.scene.params, 0, self.scene.params.len())?;
        s.noise.run(&NoiseArgs {
            stride,
            count,
            seed: NOISE_KEYS[0],
            stream: NOISE_KEYS[1],
            rate: NOISE.rate,
            steepness: NOISE.steepness,
            opacity: NOISE.opacity,
            status: &f.status,
            params: &moved,
        })?;
        let (before, after) = (self.planes(&self.scene.params)?, self.planes(&moved)?);
        out.noise = (Plane::POSITION..Plane::LOG_SCALE)
            .map(|p| {
                after[p]
                    .iter()
                    .zip(&before[p])
                    .map(|(a, b)| a - b)
                    .collect()
            })
            .collect();
        let cues = Array::zeros(device, "cues", 2 * stride)?;
        for _ in 0..2 {
            s.screen_grad.run(&ScreenGradArgs {
                records: &f.records,
                stride,
                count,
                pair_start: &f.pair_start,
                pair_counts: &f.pair_counts,
                sums: &f.sums,
                size: self.camera.size,
                status: &f.status,
                cues: &cues,
            })?;
        }
        let row = |k: usize| Ok(widen(cues.read(k * stride, count)?));
        out.screen_grad = [row(0)?, row(1)?];
        Ok(())
    }

    /// What the view shows of each Gaussian; the sums of splat_grad are others afterwards.
    pub(super) fn weights(&mut self, out: &mut Outputs) -> Result<()> {
        let (s, f, count) = (&self.stages, &self.renderer.frame, self.scene.count);
        let red = red_image::<R>(size_of_image(&self.camera));
        let red = Array::from_slice(self.device, "dimage", &red)?;
        s.splat_grad
            .run(&self.renderer.lists(&self.camera), &red, &f.sums)?;
        let most = Array::zeros(self.device, "weights", count)?;
        s.weight.run(&WeightArgs {
            count,
            pair_start: &f.pair_start,
            pair_counts: &f.pair_counts,
            sums: &f.sums,
            most: &most,
        })?;
        out.weights = widen(most.read(0, count)?);
        Ok(())
    }
}
