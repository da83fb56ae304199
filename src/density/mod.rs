//! Density control on the host: which Gaussians are born, moved or removed. No OpenCL here; what the device gathered arrives
//! as slices.

mod adc;
pub mod draw;
mod mcmc;
pub mod mh;
mod none;
mod picture;
mod relocate;
pub mod relocation;

pub use crate::density::adc::Adaptive;
pub use crate::density::mcmc::Mcmc;
pub use crate::density::none::Fixed;
pub use crate::density::picture::Picture;
pub use crate::scene::Edit;

use crate::base::error::{Error, Result};
use crate::config::{Sampler, TrainConfig};

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

/// How hard training pulled at the projected centre of each Gaussian since the last step (\[3DGS\] §5.2), each slice of
/// length N.
#[derive(Debug, Clone, Copy)]
pub struct ScreenGradient<'a> {
    /// Sum over the iterations that saw it of the norm of the loss gradient of the projected centre, in normalised device
    /// coordinates.
    pub norms: &'a [f32],
    /// Number of those iterations.
    pub views: &'a [u32],
}

/// What a strategy wants gathered of each Gaussian before a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wanted {
    /// Nothing: it decides from the parameters alone.
    Nothing,
    /// [`Cues`] of the last so many renders of training.
    Errors {
        /// Renders.
        views: usize,
    },
    /// [`ScreenGradient`] of every iteration since the last step.
    ScreenGradient,
}

impl Wanted {
    /// Values per Gaussian that are gathered on the device.
    #[must_use]
    pub fn rows(self) -> usize {
        match self {
            Self::Nothing => 0,
            Self::Errors { .. } => 3,
            Self::ScreenGradient => 2,
        }
    }
}

/// What was gathered; the variant that [`DensityControl::wanted`] names.
#[derive(Debug, Clone, Copy)]
pub enum Evidence<'a> {
    /// Nothing.
    Nothing,
    /// Errors under the centres.
    Errors(Cues<'a>),
    /// Gradients on the screen.
    ScreenGradient(ScreenGradient<'a>),
}

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

/// Where in the run a density step happens.
#[derive(Debug, Clone, Copy)]
pub struct StepContext<'a> {
    /// Iteration of the run; with the seed it keys every random number of the step.
    pub iteration: u32,
    /// Progress η ∈ [0, 1] over the span of density control.
    pub progress: f64,
    /// Seed of the run.
    pub seed: u64,
    /// Upper bound of the number of Gaussians.
    pub max_gaussians: Option<usize>,
    /// Opacity resets of those that come at intervals, before this step.
    pub opacity_resets: u32,
    /// Whether a reset comes with this step.
    pub resets_opacity: bool,
    /// Centres of the training cameras, local units.
    pub cameras: &'a [[f32; 3]],
    /// As many views as [`DensityControl::pictures`] names, as they are rendered now.
    pub pictures: &'a [Picture],
    /// First-order changes of the loss by the births that [`DensityControl::trials`] names, in their order; NaN where no view
    /// sees a birth.
    pub changes: &'a [f64],
}

impl StepContext<'_> {
    /// A step after so many iterations at progress η, without a bound, resets, cameras, pictures or changes.
    #[must_use]
    pub fn at(iteration: u32, progress: f64, seed: u64) -> Self {
        Self {
            iteration,
            progress,
            seed,
            max_gaussians: None,
            opacity_resets: 0,
            resets_opacity: false,
            cameras: &[],
            pictures: &[],
            changes: &[],
        }
    }
}

/// A birth whose effect on the loss a step asks for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Trial {
    /// What would be written; `dst` is of no meaning.
    pub birth: Edit,
    /// By how much the source's opacity logit and its three log-scales change, if birth and source share.
    pub source_change: Option<[f64; 4]>,
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
    /// Births in image space (mh): proposed, accepted.
    #[serde(default)]
    pub pixel: [u64; 2],
    /// Occupied voxels at the end of the (last) step.
    pub occupied_voxels: u64,
    /// Mean of D(v′) over the proposals of the (last) step.
    pub mean_prior: f64,
    /// Of the accepted births, those that copy their source (adc).
    #[serde(default)]
    pub cloned: u64,
    /// Of the accepted births, those that share their source's room (adc).
    #[serde(default)]
    pub split: u64,
    /// Opacity resets (adc).
    #[serde(default)]
    pub opacity_resets: u64,
}

impl DensityStats {
    /// Adds a later step: counters are summed, the two gauges (`occupied_voxels`, `mean_prior`) take its values. A step
    /// that proposed nothing leaves `mean_prior` as it was, for it has none.
    pub fn add(&mut self, step: &Self) {
        self.proposed += step.proposed;
        self.accepted += step.accepted;
        self.relocated += step.relocated;
        self.pruned += step.pruned;
        self.cloned += step.cloned;
        self.split += step.split;
        self.opacity_resets += step.opacity_resets;
        for k in 0..2 {
            self.coarse[k] += step.coarse[k];
            self.fine[k] += step.fine[k];
            self.pixel[k] += step.pixel[k];
        }
        self.occupied_voxels = step.occupied_voxels;
        if step.proposed > 0 {
            self.mean_prior = step.mean_prior;
        }
    }
}

/// The outcome of a density step: edits, then an opacity reset, then removals.
#[derive(Debug, Clone, Default)]
pub struct Outcome {
    /// Rows to write; appended rows are N, N+1, … without a gap.
    pub edits: Vec<Edit>,
    /// Number of rows after the edits.
    pub rows: usize,
    /// No opacity logit is left above this, and every opacity's moments are zeroed.
    pub logit_limit: Option<f32>,
    /// Rows that go, rising; never all of them.
    pub removed: Vec<u32>,
    /// Statistics of this step.
    pub stats: DensityStats,
}

impl Outcome {
    /// Nothing is changed.
    #[must_use]
    pub fn unchanged(rows: usize) -> Self {
        Self {
            rows,
            ..Self::default()
        }
    }

    /// Number of Gaussians afterwards.
    #[must_use]
    pub fn gaussians(&self) -> usize {
        self.rows - self.removed.len()
    }
}

/// A strategy of density control. It decides from what a step gives it and keeps nothing between steps, so that a
/// checkpoint needs nothing of it.
pub trait DensityControl: Send {
    /// What a step at this progress wants gathered, for a run of so many training views: nothing, or what a step at η = 1 does.
    fn wanted(&self, views: usize, progress: f64) -> Wanted;

    /// How many views a step at this progress wants rendered, with their photos.
    fn pictures(&self, _progress: f64) -> usize {
        0
    }

    /// How many views a step's births are tried in; 0 if it never asks.
    fn trial_views(&self) -> usize {
        0
    }

    /// The births whose effect on the loss the step with these arguments needs to know, as [`StepContext::changes`].
    ///
    /// # Errors
    /// As [`DensityControl::step`].
    fn trials(
        &self,
        _context: &StepContext<'_>,
        _scene: &SceneState<'_>,
        _evidence: &Evidence<'_>,
    ) -> Result<Vec<Trial>> {
        Ok(Vec::new())
    }

    /// Noise on the positions after every optimiser step, if any.
    fn noise(&self) -> Option<NoiseLaw> {
        None
    }

    /// Decides on births, relocations and removals.
    ///
    /// # Errors
    /// Evidence that does not match the scene or the strategy, or a scene that cannot be sampled.
    fn step(
        &mut self,
        context: &StepContext<'_>,
        scene: &SceneState<'_>,
        evidence: &Evidence<'_>,
    ) -> Result<Outcome>;
}

/// The strategy that a configuration names: the only place that tells them apart.
#[must_use]
pub fn make(config: &TrainConfig) -> Box<dyn DensityControl> {
    match config.sampler {
        Sampler::Mh => Box::new(mh::MetropolisHastings::new(&config.mh)),
        Sampler::Mcmc => Box::new(Mcmc::new(&config.mcmc)),
        Sampler::Adc => Box::new(Adaptive::new(&config.adc)),
        Sampler::None => Box::new(Fixed),
    }
}

fn numerics(what: String) -> Error {
    Error::Numerics {
        stage: "density control".into(),
        what,
    }
}

/// Evidence of another kind than [`DensityControl::wanted`] names.
fn unexpected() -> Error {
    numerics("the evidence is of another kind than the sampler wants".into())
}

/// Refuses a scene whose planes, or other slices (`lengths`), are not of one length, or whose rows 32 bits cannot name.
fn check_lengths(scene: &SceneState<'_>, lengths: impl IntoIterator<Item = usize>) -> Result<()> {
    let n = scene.len();
    if u32::try_from(n).is_err() {
        return Err(numerics(format!("{n} Gaussians; fewer than 2^32 expected")));
    }
    let planes = scene
        .positions
        .iter()
        .chain(&scene.log_scales)
        .chain(&scene.rotations);
    match planes.map(|p| p.len()).chain(lengths).find(|l| *l != n) {
        Some(l) => Err(numerics(format!(
            "a parameter or cue has {l} values; {n} expected"
        ))),
        None => Ok(()),
    }
}
