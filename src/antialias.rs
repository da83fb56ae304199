//! Whether a run trains with Mip-Splatting's filters (Yu et al., CVPR 2024): by the option, or by how much the sampling rates of
//! the training views differ.
//!
//! A view samples a point at f/z pixels per unit of length, f the larger focal length and z the point's depth. Where some
//! views take one pixel for what others take many for, a scene trained without the filters shows in the first too thick, and
//! in views closer than any too thin: the 2D covariance gets the same blur whatever it is the covariance of.

use glam::{DMat3, DVec3};

use crate::config::{AntiAliasing, Init, TrainConfig};
use crate::dataset::{Camera, Dataset, View};
use crate::error::Result;
use crate::export::ply;
use crate::model::{Plane, Splats, filters};

/// `auto` switches the filters on from this spread of the sampling rates on. Of ordinary captures of objects, rooms and
/// façades the spread is 1 to 2.7; of one that stands at a distance and at eight times that, it is 6 to 8.
pub const LEAST_SPREAD: f64 = 4.0;
/// The spread at a point leaves out this share of the views that see it, at either end: a camera that happens to pass close by
/// is no second distance.
const TAIL: f64 = 0.1;
/// Points looked at, evenly taken from the dataset's.
const MOST_POINTS: usize = 4096;
/// Views that must see a point for it to count.
const LEAST_VIEWS: usize = 3;

/// A decision on anti-aliasing.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AntiAlias {
    /// Whether both filters are used.
    pub on: bool,
    /// Why, or why not.
    pub why: String,
}

impl AntiAlias {
    /// Decides for a dataset and a configuration; says the same for the same dataset and configuration.
    #[must_use]
    pub fn decide(dataset: &Dataset, config: &TrainConfig) -> Self {
        let says = |on: bool, why: &str| Self {
            on,
            why: why.into(),
        };
        match (config.anti_aliasing, &config.init) {
            (AntiAliasing::On, _) => says(true, "anti-aliasing is on"),
            (AntiAliasing::Off, _) => says(false, "anti-aliasing is off"),
            (AntiAliasing::Auto, Init::File(path)) if ply::is_anti_aliased(path) => {
                says(true, "the first Gaussians were trained with it")
            }
            (AntiAliasing::Auto, _) => match spread(dataset) {
                None => says(
                    false,
                    "the views share no point to compare their sampling rates at",
                ),
                Some(s) => Self {
                    on: s >= LEAST_SPREAD,
                    why: format!(
                        "the views' sampling rates differ by a factor of {s:.1}; auto asks for {LEAST_SPREAD}"
                    ),
                },
            },
        }
    }
}

/// Spread of the training views' sampling rates: at each sparse point the 90th percentile of f/z over the 10th, over the views
/// whose image has the point (hidden or not); of those the median over the points. Without points that three views see, the
/// same at the point closest to all optical axes. None where not even that is in view.
#[must_use]
pub fn spread(dataset: &Dataset) -> Option<f64> {
    let cameras = cameras(dataset);
    let points = &dataset.points.positions;
    let step = points.len().div_ceil(MOST_POINTS).max(1);
    let sampled = points.iter().step_by(step);
    let sampled = sampled.map(|p| DVec3::from_array(p.map(f64::from)));
    let mut spreads: Vec<f64> = sampled.filter_map(|p| spread_at(p, &cameras)).collect();
    spreads.sort_by(f64::total_cmp);
    match spreads.get(spreads.len() / 2) {
        Some(median) => Some(*median),
        None => spread_at(center_of_attention(&dataset.train)?, &cameras),
    }
}

/// The first Gaussians as the trainer is to take them: `splats` of a PLY file with the 3D filter in it are given back what they
/// were before, by the training views of this dataset. Training filters them itself.
///
/// # Errors
/// A value that is then not finite.
pub fn without_filter(splats: &Splats, dataset: &Dataset) -> Result<Splats> {
    let positions =
        (0..splats.len()).map(|i| splats.gather::<3>(Plane::POSITION, i).map(f64::from));
    let sigma = filters(positions, &cameras(dataset));
    splats.unfiltered(&sigma.iter().map(|s| *s as f32).collect::<Vec<_>>())
}

fn cameras(dataset: &Dataset) -> Vec<Camera> {
    dataset.train.iter().map(|v| v.camera).collect()
}

fn spread_at(point: DVec3, cameras: &[Camera]) -> Option<f64> {
    let rates = cameras.iter().filter_map(|c| c.sampling_rate(point));
    let mut rates: Vec<f64> = rates.collect();
    if rates.len() < LEAST_VIEWS {
        return None;
    }
    rates.sort_by(f64::total_cmp);
    let tail = (TAIL * (rates.len() - 1) as f64).round() as usize;
    Some(rates[rates.len() - 1 - tail] / rates[tail])
}

/// The point with the least sum of squared distances to the optical axes; none where these are parallel.
fn center_of_attention(views: &[View]) -> Option<DVec3> {
    let (mut a, mut b) = (DMat3::ZERO, DVec3::ZERO);
    for view in views {
        let axis = view.camera.rotation.row(2);
        let across =
            DMat3::IDENTITY - DMat3::from_cols(axis * axis.x, axis * axis.y, axis * axis.z);
        a += across;
        b += across * view.camera.center();
    }
    let n = views.len() as f64;
    (a.determinant() > 1e-9 * n * n * n).then(|| a.inverse() * b)
}
