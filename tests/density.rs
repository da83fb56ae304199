//! Density control: random numbers, relocation, voxel counts, importance, proposals, acceptance, the whole step.

mod adc;
mod chain;
mod deaths;
mod decisions;
mod extremes;
mod mcmc;
mod moved;
mod parts;
mod pixels;
mod probes;
mod sharing;
mod step;
mod switches;
mod voxels;

use mhsplat::base::rng::{Philox, Stream};
use mhsplat::density::{ErrorStatistics, SceneState, Statistics};

/// A scene and its cues, owned.
#[derive(Clone)]
pub struct Scene {
    positions: [Vec<f32>; 3],
    log_scales: [Vec<f32>; 3],
    rotations: [Vec<f32>; 4],
    logits: Vec<f32>,
    ssim: Vec<f32>,
    l1: Vec<f32>,
    views: Vec<u32>,
}

impl Scene {
    /// `n` Gaussians around the origin, opacities around ½, every third one unseen.
    pub fn random(n: usize, seed: u64) -> Self {
        let stream = Stream::Synthetic.stream(0);
        let plane = |k: u64, scale: f64, shift: f64| -> Vec<f32> {
            (0..n as u64)
                .map(|i| (shift + scale * Philox::normal(seed, stream + k, i)[0]) as f32)
                .collect()
        };
        let error = |k: u64| -> Vec<f32> { plane(k, 1.0, 2.0).iter().map(|v| v.abs()).collect() };
        Self {
            positions: [0, 1, 2].map(|k| plane(k, 0.05, 0.0)),
            log_scales: [3, 4, 5].map(|k| plane(k, 0.3, -4.5)),
            rotations: [6, 7, 8, 9].map(|k| plane(k, 1.0, 0.0)),
            logits: plane(10, 1.0, 0.0),
            ssim: error(11),
            l1: error(12),
            views: (0..n as u32).map(|i| i % 3).collect(),
        }
    }

    pub fn state(&self) -> SceneState<'_> {
        SceneState {
            positions: self.positions.each_ref().map(|p| p.as_slice()),
            log_scales: self.log_scales.each_ref().map(|p| p.as_slice()),
            rotations: self.rotations.each_ref().map(|p| p.as_slice()),
            opacity_logits: &self.logits,
        }
    }

    pub fn cues(&self) -> ErrorStatistics<'_> {
        ErrorStatistics {
            ssim: &self.ssim,
            l1: &self.l1,
            views: &self.views,
        }
    }

    pub fn errors(&self) -> Statistics<'_> {
        Statistics::Errors(self.cues())
    }
}

/// Runs `f` on a pool of so many threads.
pub fn on_threads<T: Send>(threads: usize, f: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .unwrap()
        .install(f)
}

/// Share of mass that two distributions over the same outcomes do not have in common.
pub fn total_variation(a: &[f64], b: &[f64]) -> f64 {
    assert!(a.iter().chain(b).all(|v| v.is_finite()));
    0.5 * a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f64>()
}
