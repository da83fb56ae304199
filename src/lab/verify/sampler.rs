//! The stages that some samplers add to an iteration, and those that look at the result.

use crate::base::error::Result;
use crate::density::NoiseLaw;
use crate::device::{Array, Real};
use crate::lab::verify::chain::{Outputs, Run};
use crate::lab::verify::readback::{crop, widen};
use crate::scene::Plane;

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
        let moved = self.copy_of_scene()?;
        s.noise
            .run(&moved, f, &NOISE, NOISE_KEYS[0], NOISE_KEYS[1])?;
        let (before, after) = (
            self.planes(&self.scene.params)?,
            self.planes(&moved.params)?,
        );
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
            s.screen_grad.run(&self.scene, f, &self.camera, &cues)?;
        }
        let row = |k: usize| Ok(widen(cues.read(k * stride, count)?));
        out.screen_grad = [row(0)?, row(1)?];
        Ok(())
    }

    /// Maps of errors, what importance takes from them, and what views are scored by.
    pub(super) fn importance_and_metrics(&mut self, out: &mut Outputs) -> Result<()> {
        let (device, s, n) = (self.device, &self.stages, self.scene.count);
        let pair = self.pair();
        let [w, h] = pair.size;
        let maps = Array::zeros(device, "maps", 2 * pair.plane())?;
        let partial = Array::zeros(device, "partial", s.loss.partial_len(w, h))?;
        s.loss.errors(&pair, &maps, &partial)?;
        out.error_maps = crop(&widen(maps.to_vec()?), &self.camera, 0..2);
        let stride = self.scene.stride;
        let cues = Array::zeros(device, "cues", 3 * stride)?;
        for first_view in [true, false] {
            let frame = &self.renderer.frame;
            s.importance
                .run(&self.scene, frame, &self.camera, &maps, first_view, &cues)?;
        }
        let row = |k: usize| Ok(widen(cues.read(k * stride, n)?));
        out.cues = [row(0)?, row(1)?, row(2)?];
        let rows = Array::zeros(device, "score", 3 * h)?;
        s.metrics.dissimilarity(&pair, &maps, &rows)?;
        s.metrics.run(&pair, &rows)?;
        out.squared_error = widen(rows.read(0, h)?).iter().sum();
        out.dissimilarity = widen(rows.read(2 * h, h)?).iter().sum();
        Ok(())
    }

    /// Which Gaussians the view shows, where some were seen before.
    pub(super) fn seen(&mut self, out: &mut Outputs) -> Result<()> {
        let (s, f, count) = (&self.stages, &self.renderer.frame, self.scene.count);
        let before: Vec<u32> = seen_before(count).collect();
        let seen = Array::from_slice(self.device, "seen", &before)?;
        let shown = Array::zeros(self.device, "shown", f.intersection_capacity())?;
        s.seen.run(f, &self.camera, &shown, &seen)?;
        out.seen = seen.to_vec()?.into_iter().map(f64::from).collect();
        Ok(())
    }
}

/// Which of so many Gaussians count as seen before: every third.
pub fn seen_before(count: usize) -> impl Iterator<Item = u32> {
    (0..count).map(|i| u32::from(i % 3 == 2))
}
