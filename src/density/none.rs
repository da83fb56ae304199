//! A fixed set of Gaussians.

use crate::base::error::Result;
use crate::density::control::{DensityControl, StepContext};
use crate::density::outcome::Outcome;
use crate::density::state::SceneState;
use crate::density::statistics::{Evidence, Wanted};

/// Density control that never changes the set.
#[derive(Debug, Clone, Copy, Default)]
pub struct Fixed;

impl DensityControl for Fixed {
    fn wanted(&self, _views: usize, _progress: f64) -> Wanted {
        Wanted::Nothing
    }

    fn step(
        &self,
        _context: &StepContext<'_>,
        scene: &SceneState<'_>,
        _evidence: &Evidence<'_>,
    ) -> Result<Outcome> {
        Ok(Outcome::unchanged(scene.len()))
    }
}
