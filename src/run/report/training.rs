//! Some training views at the end of a session: beside held-out ones their scores tell what was learnt by heart, and their pictures what
//! was not learnt at all.

use crate::base::error::Result;
use crate::device::Defines;
use crate::evaluate::Evaluator;
use crate::run::record::{FinalRecord, TrainingScores};
use crate::run::report::gallery::{GalleryItem, items};
use crate::train::Trainer;

/// Largest number of training views that are scored.
pub(crate) const VIEWS: usize = 8;

/// Largest number of training views that are shown.
pub(crate) const SHOWN: usize = 3;

/// Mean scores of at most [`VIEWS`] training views, evenly spread, and pictures of the worst of them; nothing where exposure is
/// compensated, which gives each of them a colour of its own.
///
/// # Errors
/// See [`Evaluator::score_all`].
pub(crate) fn training_views(
    trainer: &mut Trainer,
) -> Result<(Option<TrainingScores>, Vec<GalleryItem>)> {
    if trainer.compensates_exposure() {
        return Ok((None, Vec::new()));
    }
    let background = trainer.schedule().fixed_background();
    let views = trainer.training_views(VIEWS);
    let device = views.photos().device().clone();
    let evaluator = Evaluator::new(&device, Defines::new(device.tuning()), views)?;
    let mut scores = evaluator.score_all(trainer, background, false)?;
    scores.sort_by(|a, b| a.scores.psnr.total_cmp(&b.scores.psnr));
    let names = &evaluator.views().names;
    let place = |view: &String| names.iter().position(|name| name == view);
    let worst = scores.iter().take(SHOWN).filter_map(|s| place(&s.view));
    let worst: Vec<usize> = worst.collect();
    let mut shown = items(&evaluator, &worst, trainer, background)?;
    shown.iter_mut().for_each(|item| item.training = true);
    let views = scores.len();
    let mean = FinalRecord::of(scores).map(|scores| TrainingScores {
        views,
        psnr: scores.mean.psnr,
        ssim: scores.mean.ssim,
    });
    Ok((mean, shown))
}
