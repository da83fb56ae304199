//! A fixed set of Gaussians.

use crate::base::error::Result;
use crate::density::control::{DensityControl, StepContext};
use crate::density::outcome::Outcome;
use crate::density::state::SceneState;
use crate::density::statistics::{Statistics, StatisticsKind};

/// Density control that never changes the set.
#[derive(Debug, Clone, Copy, Default)]
pub struct Fixed;

impl DensityControl for Fixed {
    fn wanted(&self, _views: usize, _progress: f64) -> StatisticsKind {
        StatisticsKind::Nothing
    }

    fn step(
        &self,
        _context: &StepContext<'_>,
        scene: &SceneState<'_>,
        _evidence: &Statistics<'_>,
    ) -> Result<Outcome> {
        Ok(Outcome::unchanged(scene.len()))
    }
}
