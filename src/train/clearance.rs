//! Radii of the free space about the training cameras.

use crate::base::error::{Error, Result};
use crate::capture::Dataset;
use crate::config::{Sampler, TrainConfig};
use crate::density::clearance::radii;
use crate::train::reasons::{Decided, Why};

/// Radii by the dataset's points, or those that the run began with; empty without points (docs/results/clearance.md).
///
/// # Errors
/// Radii of a run that began with other training views, or none that a ball can have.
pub(super) fn clearance(
    dataset: &Dataset,
    config: &TrainConfig,
    begun: Option<&Vec<f32>>,
) -> Result<Decided<Vec<f32>>> {
    if config.sampler == Sampler::None {
        return Ok(Decided::new(Vec::new(), Why::FixedSet));
    }
    if config.clearance == 0.0 {
        return Ok(Decided::new(Vec::new(), Why::Off("clearance")));
    }
    let views = dataset.train.len();
    let found = || {
        let cameras = dataset.train.iter().map(|view| view.camera.center());
        let cameras: Vec<[f32; 3]> = cameras.map(|c| c.as_vec3().to_array()).collect();
        match dataset.points.positions.as_slice() {
            [] => Vec::new(),
            points => radii(&cameras, points, config.clearance),
        }
    };
    let mut value = begun.cloned().unwrap_or_else(found);
    let sound = value.iter().all(|r| r.is_finite() && *r >= 0.0);
    if !(sound && [0, views].contains(&value.len())) {
        let what = format!(
            "{} radii; one for each of {views} training views, 0 or more, expected",
            value.len()
        );
        return Err(Error::numerics("clearance", what));
    }
    if !value.iter().any(|r| *r > 0.0) {
        value.clear();
    }
    let mut sorted = value.clone();
    sorted.sort_by(f32::total_cmp);
    let why = match (sorted.get(sorted.len() / 2), begun) {
        (Some(median), _) => {
            let median = f64::from(*median) * dataset.frame.scale;
            Why::Free(config.clearance, median)
        }
        (None, None) if dataset.points.positions.is_empty() => {
            Why::Criterion("the dataset has no points")
        }
        (None, None) => Why::Criterion("the cameras stand at points"),
        (None, Some(_)) => Why::Checkpoint,
    };
    Ok(Decided::new(value, why))
}
