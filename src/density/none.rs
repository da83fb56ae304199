//! A fixed set of Gaussians.

use super::{Cues, DensityControl, Outcome, SceneState, StepContext};
use crate::error::Result;

/// Density control that never changes the set.
#[derive(Debug, Clone, Copy, Default)]
pub struct Fixed;

impl DensityControl for Fixed {
    fn views_wanted(&self, _views: usize, _progress: f64) -> usize {
        0
    }

    fn step(
        &mut self,
        _context: &StepContext,
        scene: &SceneState<'_>,
        _cues: &Cues<'_>,
    ) -> Result<Outcome> {
        Ok(Outcome {
            len: scene.len(),
            ..Outcome::default()
        })
    }
}
