//! Density control on the host: which Gaussians are born or moved. No OpenCL here; importance arrives as slices.

pub mod mh;
mod none;
pub mod relocation;

pub use none::Fixed;

use crate::config::{Sampler, TrainConfig};
use crate::error::Result;

/// What density control sees of the scene: raw parameters, struct of arrays, each slice of length N.
#[derive(Debug, Clone, Copy)]
pub struct SceneState<'a> {
    /// Positions x, y, z, local units.
    pub positions: [&'a [f32]; 3],
    /// Natural log of the scales, local units.
    pub log_scales: [&'a [f32]; 3],
    /// Rotation quaternions w, x, y, z, of any norm.
    pub rotations: [&'a [f32]; 4],
    /// Opacity logits.
    pub opacity_logits: &'a [f32],
}

impl SceneState<'_> {
    /// Number of Gaussians.
    #[must_use]
    pub fn len(&self) -> usize {
        self.opacity_logits.len()
    }

    /// Whether there is no Gaussian.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.opacity_logits.is_empty()
    }
}

/// Error cues of each Gaussian over the view subset (\[MH\] Eq. 11, 13), each slice of length N.
#[derive(Debug, Clone, Copy)]
pub struct Cues<'a> {
    /// Sum over the seeing views of 1 − SSIM at the pixel under the projected centre.
    pub ssim: &'a [f32],
    /// Sum over the seeing views of the L1 error there.
    pub l1: &'a [f32],
    /// Number of views of the subset that see the centre.
    pub views: &'a [u32],
}

/// Where in the run a density step happens.
#[derive(Debug, Clone, Copy)]
pub struct StepContext {
    /// Iteration of the run; with the seed it keys every random number of the step.
    pub iteration: u32,
    /// Progress η ∈ [0, 1] over the span of density control.
    pub progress: f64,
    /// Seed of the run.
    pub seed: u64,
    /// Upper bound of the number of Gaussians.
    pub max_gaussians: Option<usize>,
}

/// One Gaussian to be written: the row `src` is copied to `dst`, then position, log-scale and opacity are replaced, and
/// both optimiser moments of `dst` are zeroed. `dst == src` changes the row in place; `dst ≥ N` appends.
///
/// Within one step no row is named twice as `dst`, and a row that another edit names as `src` is itself a `dst` only
/// with `src == dst` (so the order of the edits does not matter).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Edit {
    /// Row to copy from.
    pub src: u32,
    /// Row to write.
    pub dst: u32,
    /// New position, local units.
    pub position: [f32; 3],
    /// New log-scale.
    pub log_scale: [f32; 3],
    /// New opacity logit.
    pub opacity_logit: f32,
}

/// What happened in one step, or the sum over a run.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct DensityStats {
    /// Proposed births.
    pub proposed: u64,
    /// Accepted births.
    pub accepted: u64,
    /// Dead Gaussians moved.
    pub relocated: u64,
    /// Gaussians removed.
    pub pruned: u64,
    /// Coarse phase: proposed, accepted.
    pub coarse: [u64; 2],
    /// Fine phase: proposed, accepted.
    pub fine: [u64; 2],
    /// Occupied voxels at the end of the (last) step.
    pub occupied_voxels: u64,
    /// Mean of D(v′) over the proposals of the (last) step.
    pub mean_prior: f64,
}

impl DensityStats {
    /// Adds a later step: counters are summed, the two gauges (`occupied_voxels`, `mean_prior`) take its values. A step
    /// that proposed nothing leaves `mean_prior` as it was, for it has none.
    pub fn add(&mut self, step: &Self) {
        self.proposed += step.proposed;
        self.accepted += step.accepted;
        self.relocated += step.relocated;
        self.pruned += step.pruned;
        for k in 0..2 {
            self.coarse[k] += step.coarse[k];
            self.fine[k] += step.fine[k];
        }
        self.occupied_voxels = step.occupied_voxels;
        if step.proposed > 0 {
            self.mean_prior = step.mean_prior;
        }
    }
}

/// The outcome of a density step.
#[derive(Debug, Clone, Default)]
pub struct Outcome {
    /// Rows to write; appended rows are N, N+1, … without a gap.
    pub edits: Vec<Edit>,
    /// Number of Gaussians after the edits.
    pub len: usize,
    /// Statistics of this step.
    pub stats: DensityStats,
}

/// A strategy of density control. It decides from what a step gives it and keeps nothing between steps, so that a
/// checkpoint needs nothing of it.
pub trait DensityControl: Send {
    /// Of how many of the training views a step at this progress wants the errors, 0 for none (\[MH\] Eq. 10).
    fn views_wanted(&self, views: usize, progress: f64) -> usize;

    /// Decides on births and relocations.
    ///
    /// # Errors
    /// Cues that do not match the scene, or a scene that cannot be sampled.
    fn step(
        &mut self,
        context: &StepContext,
        scene: &SceneState<'_>,
        cues: &Cues<'_>,
    ) -> Result<Outcome>;
}

/// The strategy that a configuration names.
#[must_use]
pub fn make(config: &TrainConfig) -> Box<dyn DensityControl> {
    match config.sampler {
        Sampler::Mh => Box::new(mh::MetropolisHastings::new(&config.mh)),
        Sampler::None => Box::new(Fixed),
    }
}
