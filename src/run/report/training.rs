//! Scores of some training views at the end of a run: beside those of held-out ones they tell what was learnt by heart.

use crate::base::error::Result;
use crate::device::Defines;
use crate::evaluate::Evaluator;
use crate::run::record::{FinalRecord, TrainingScores};
use crate::train::Trainer;

/// Largest number of training views that are scored.
pub(crate) const VIEWS: usize = 8;

/// Mean scores of at most [`VIEWS`] training views, evenly spread; `None` where exposure is compensated, which gives each of them a
/// colour of its own.
///
/// # Errors
/// See [`Evaluator::score_all`].
pub(crate) fn training_scores(trainer: &mut Trainer) -> Result<Option<TrainingScores>> {
    if trainer.compensates_exposure() {
        return Ok(None);
    }
    let background = trainer.schedule().fixed_background();
    let views = trainer.training_views(VIEWS);
    let device = views.photos().device().clone();
    let evaluator = Evaluator::new(&device, Defines::new(device.tuning()), views)?;
    let (scene, renderer) = trainer.scene_and_renderer();
    let scores = evaluator.score_all(scene, renderer, background, false)?;
    let views = scores.len();
    Ok(FinalRecord::of(scores).map(|scores| TrainingScores {
        views,
        psnr: scores.mean.psnr,
        ssim: scores.mean.ssim,
    }))
}
