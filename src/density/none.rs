//! A fixed set of Gaussians.

use crate::base::error::Result;
use crate::density::{DensityControl, Evidence, Outcome, SceneState, StepContext, Wanted};

/// Density control that never changes the set.
#[derive(Debug, Clone, Copy, Default)]
pub struct Fixed;

impl DensityControl for Fixed {
    fn wanted(&self, _views: usize, _progress: f64) -> Wanted {
        Wanted::Nothing
    }

    fn step(
        &mut self,
        _context: &StepContext<'_>,
        scene: &SceneState<'_>,
        _evidence: &Evidence<'_>,
    ) -> Result<Outcome> {
        Ok(Outcome::unchanged(scene.len()))
    }
}
