//! Scores of the held-out views, as the record has them.

use crate::base::error::Result;
use crate::evaluate::color::mean_corrected;
use crate::evaluate::{mean, mean_flip};
use crate::run::Run;
use crate::run::record::FinalRecord;

impl Run {
    /// Scores the held-out views as they are rendered; `last` takes FLIP, too, and, where exposure is compensated, colour-corrected
    /// scores. None without held-out views.
    pub(super) fn scores(&mut self, last: bool) -> Result<Option<FinalRecord>> {
        let background = self.trainer.schedule().fixed_background();
        let compensates = self.trainer.compensates_exposure();
        let (scene, renderer) = self.trainer.scene_and_renderer();
        let Some(evaluator) = &self.evaluator else {
            return Ok(None);
        };
        let mut scores = evaluator.score_all(scene, renderer, background, last)?;
        if last && compensates {
            evaluator.add_color_corrected(&mut scores, scene, renderer, background)?;
        }
        let corrected = mean_corrected(&scores);
        Ok(mean(&scores).map(|(psnr, ssim)| FinalRecord {
            psnr,
            ssim,
            flip: mean_flip(&scores),
            cc_psnr: corrected.map(|c| c.0),
            cc_ssim: corrected.map(|c| c.1),
            per_view: scores,
        }))
    }
}
