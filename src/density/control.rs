//! The interface of density-control strategies: context and statistics in, edits out.

use crate::base::error::Result;
use crate::density::outcome::Outcome;
use crate::density::picture::Picture;
use crate::density::state::SceneState;
use crate::density::statistics::{Statistics, StatisticsKind};
use crate::scene::Edit;

/// Noise on the positions after every optimiser step: x += rate · lr_position · Σ·ξ · σ(−steepness·(o − opacity)),
/// ξ ~ N(0, I) (\[MCMC\] Eq. 8).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NoiseLaw {
    /// Factor on the position's learning rate, for Σ in local units.
    pub rate: f64,
    /// Steepness of the gate.
    pub steepness: f64,
    /// Opacity at which the gate is one half.
    pub opacity: f64,
}

/// The circumstances of a density step.
#[derive(Debug, Clone, Copy)]
pub struct StepContext<'a> {
    /// Iteration of the run; with the seed it keys every random number of the step.
    pub iteration: u32,
    /// Progress η ∈ [0, 1] over the span of density control.
    pub progress: f64,
    /// Seed of the run.
    pub seed: u64,
    /// Upper bound of the number of Gaussians; `None` if there is none.
    pub max_gaussians: Option<usize>,
    /// Number of scheduled opacity resets before this step.
    pub opacity_resets: u32,
    /// True if opacities are reset with this step.
    pub resets_opacity: bool,
    /// True if no step follows.
    pub last: bool,
    /// Progress of the step before; `None` if this is the first.
    pub before: Option<f64>,
    /// Difference Δη of the progress of one step and the next, as the run is planned now.
    pub spacing: f64,
    /// Centres of the training cameras, local units.
    pub cameras: &'a [[f32; 3]],
    /// Current renders of as many views as [`DensityControl::pictures`] names.
    pub pictures: &'a [Picture<'a>],
}

impl StepContext<'_> {
    /// A step after so many iterations at progress η, neither the last nor after another, at a spacing of 1, without a bound, resets, cameras or pictures.
    #[must_use]
    pub fn at(iteration: u32, progress: f64, seed: u64) -> Self {
        Self {
            iteration,
            progress,
            seed,
            max_gaussians: None,
            opacity_resets: 0,
            resets_opacity: false,
            last: false,
            before: None,
            spacing: 1.0,
            cameras: &[],
            pictures: &[],
        }
    }
}

/// Size of a set of Gaussians after a density step, as far as it can be foreseen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expected {
    /// Number of Gaussians.
    pub gaussians: f64,
    /// Number of those born in the step.
    pub born: f64,
}

/// Returns the first-order estimate of each birth, of which `dst` has no meaning, in the order given: the change of the loss, NaN for a birth that no view sees.
pub type Estimator<'a> = dyn FnMut(&[Edit]) -> Result<Vec<f64>> + 'a;

/// A strategy of density control. It decides from the arguments of a step and keeps nothing between steps, so that a
/// checkpoint needs nothing of it.
pub trait DensityControl: Send + Sync {
    /// The statistics that a step at this progress reads, for a run of so many training views: nothing, or the kind that a
    /// step at η = 1 reads.
    fn wanted(&self, views: usize, progress: f64) -> StatisticsKind;

    /// Number of views that a step at this progress wants rendered, with their photos.
    fn pictures(&self, _progress: f64) -> usize {
        0
    }

    /// Number of views that births are estimated in; 0 if none is.
    fn estimate_views(&self) -> usize {
        0
    }

    /// Noise on the positions after every optimiser step; `None` if there is none.
    fn noise(&self) -> Option<NoiseLaw> {
        None
    }

    /// The set expected after a step from that after the step before, for forecasts of a run's time and size; `None` from a strategy that
    /// cannot tell. The context has no cameras and no pictures.
    fn expected(&self, _context: &StepContext<'_>, _before: Expected) -> Option<Expected> {
        None
    }

    /// Decides on births, relocations and removals.
    ///
    /// # Errors
    /// Statistics that do not match the scene or the strategy, or a scene that cannot be sampled.
    fn step(
        &self,
        context: &StepContext<'_>,
        scene: &SceneState<'_>,
        evidence: &Statistics<'_>,
    ) -> Result<Outcome>;

    /// [`DensityControl::step`] by a strategy that may ask for estimates before it decides.
    ///
    /// # Errors
    /// Those of [`DensityControl::step`], and the estimates'.
    fn step_estimated(
        &self,
        context: &StepContext<'_>,
        scene: &SceneState<'_>,
        evidence: &Statistics<'_>,
        _estimate: &mut Estimator<'_>,
    ) -> Result<Outcome> {
        self.step(context, scene, evidence)
    }
}
