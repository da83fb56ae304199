//! What can be seen of a trainer between iterations.

use crate::base::error::Result;
use crate::density::DensityStats;
use crate::device::tuning::Tuning;
use crate::device::{Array, StageTime};
use crate::pipeline::buffers::Scene;
use crate::pipeline::forward::Renderer;
use crate::pipeline::photos::PhotoStats;
use crate::train::bands::spread;
use crate::train::schedule::Schedule;
use crate::train::{LOSS_RING, Trainer};

impl Trainer {
    /// Mean total loss without the regularisers, (1 − λ)·L1 + λ·(1 − SSIM), over the last iterations (at most 256, and no
    /// more than there are views). None before the first iteration. Where every iteration has a background of its own, that of
    /// at most 32 views, rendered over the background that does not change.
    ///
    /// # Errors
    /// The driver's.
    pub fn recent_loss(&mut self) -> Result<Option<f64>> {
        self.settle()?;
        if self.iteration > 0 && self.config.background.changes(self.transparent()) {
            self.device.finish()?;
            self.device.collect_times(usize::MAX)?;
            let loss = self.steady_loss().map(Some);
            // No part of training's stages.
            self.device.forget_launches();
            return loss;
        }
        let n = (self.iteration as usize)
            .min(LOSS_RING)
            .min(self.views.len());
        if n == 0 {
            return Ok(None);
        }
        let ring = self.losses.to_vec()?;
        let lambda = self.config.loss.lambda_ssim;
        let sum: f64 = (0..n)
            .map(|k| {
                let slot = (self.iteration as usize + LOSS_RING - 1 - k) % LOSS_RING;
                let (l1, ssim) = (f64::from(ring[2 * slot]), f64::from(ring[2 * slot + 1]));
                (1.0 - lambda) * l1 + lambda * (1.0 - ssim)
            })
            .sum();
        Ok(Some(sum / n as f64))
    }

    /// Mean loss of some views that are trained on now, over the background that does not change, at the size that they have now.
    fn steady_loss(&mut self) -> Result<f64> {
        let (n, bands) = (self.views.len(), &self.findings.bands);
        let all: Vec<usize> = (0..n).map(|v| bands.instead(v, n)).collect();
        let (views, sums) = (spread(&all), Array::zeros(&self.device, "loss", 2)?);
        let lambda = self.config.loss.lambda_ssim;
        let losses = self.over_views(&views, &[], |t, pair| {
            t.loss.errors(pair, &t.maps, &t.partial)?;
            t.loss.sum(pair, &t.partial, &sums, 0)?;
            let parts: Vec<f32> = sums.to_vec()?;
            let [l1, ssim] = [0, 1].map(|k| f64::from(parts[k]));
            Ok((1.0 - lambda) * l1 + lambda * (1.0 - ssim))
        })?;
        Ok(losses.iter().sum::<f64>() / views.len() as f64)
    }

    /// First iteration that takes photos at their full size.
    #[must_use]
    pub fn full_size_from(&self) -> u32 {
        self.schedule.full_size_from(self.views.largest)
    }

    /// How the kernels were cut.
    #[must_use]
    pub fn tuning(&self) -> Tuning {
        self.device.tuning()
    }

    /// Iterations enqueued so far.
    #[must_use]
    pub fn iteration(&self) -> u32 {
        self.iteration
    }

    /// Number of Gaussians.
    #[must_use]
    pub fn gaussians(&self) -> usize {
        self.scene.count
    }

    /// Density statistics over the run.
    #[must_use]
    pub fn stats(&self) -> &DensityStats {
        &self.tally.stats
    }

    /// Gradient values that were not finite, as far as the host has seen.
    #[must_use]
    pub fn non_finite(&self) -> u64 {
        self.tally.non_finite
    }

    /// How often pairs did not fit and iterations were repeated.
    #[must_use]
    pub fn overflows(&self) -> u64 {
        self.tally.overflows
    }

    /// Leaves room for no more than `pairs` pairs, so that a test can see what happens then.
    ///
    /// # Errors
    /// The driver's.
    #[doc(hidden)]
    pub fn shrink_pairs(&mut self, pairs: usize) -> Result<()> {
        self.settle()?;
        self.renderer.frame.set_pairs(&self.device, pairs)
    }

    /// Device time per stage so far, and under `density` the host's time in density steps, transfers included and without
    /// the device's `edit` and the probes, whose time on host and device is under `probe`.
    #[must_use]
    pub fn stage_times(&self) -> Vec<(&'static str, StageTime)> {
        let mut times = self.device.times();
        if self.tally.density_time.calls > 0 {
            let edit = times.iter().find(|(name, _)| *name == "edit");
            let mut host = self.tally.density_time;
            host.seconds = (host.seconds - edit.map_or(0.0, |(_, t)| t.seconds)).max(0.0);
            if self.tally.probe_time.calls > 0 {
                host.seconds = (host.seconds - self.tally.probe_time.seconds).max(0.0);
                times.push(("probe", self.tally.probe_time));
            }
            times.push(("density", host));
        }
        times
    }

    /// Photos waited for, and what they took of their budget; sets of views that share it are counted, too.
    #[must_use]
    pub fn photo_stats(&self) -> PhotoStats {
        self.views.photos().stats()
    }

    /// The schedules of this run.
    #[must_use]
    pub fn schedule(&self) -> &Schedule {
        &self.schedule
    }

    /// The scene on the device and the renderer, for evaluation between iterations.
    pub fn scene_and_renderer(&mut self) -> (&Scene, &mut Renderer) {
        (&self.scene, &mut self.renderer)
    }
}
