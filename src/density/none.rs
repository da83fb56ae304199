//! A fixed set of Gaussians.

use super::{Cues, DensityControl, Outcome, SceneState, StepContext};
use crate::error::{Error, Result};

/// Density control that never changes the set.
#[derive(Debug, Clone, Copy, Default)]
pub struct Fixed;

impl DensityControl for Fixed {
    fn view_subset(&mut self, _views: usize, _progress: f64) -> Vec<usize> {
        Vec::new()
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

    fn save(&self) -> serde_json::Value {
        serde_json::Value::Null
    }

    fn load(&mut self, state: &serde_json::Value) -> Result<()> {
        if state.is_null() {
            return Ok(());
        }
        Err(Error::config(
            "sampler",
            format!(
                "the checkpoint holds density state {state}; a fixed set has none (was it trained with another sampler?)"
            ),
        ))
    }
}
