//! Sampling rates of the training views: the measure that decides on Mip-Splatting's filters (Yu et al., CVPR 2024).
//!
//! A view samples a point at f/z pixels per unit of length, f the larger focal length and z the point's depth. Where some
//! views take one pixel for what others take many for, a scene trained without the filters shows in the first too thick, and
//! in views closer than any too thin: the 2D covariance gets the same blur whatever it is the covariance of. So it is for a
//! camera that moves among things near and far: few views come close to any one of them (a fence, the legs of a chair), so
//! that the rates at most points hardly differ from view to view, but those within each view do.

use glam::{DMat3, DVec3};

use crate::base::math::{sorted, upper_median};
use crate::capture::{Camera, Dataset, View};

/// Spread of the sampling rates from view to view from which `auto` switches the filters on. Of ordinary captures of objects,
/// rooms and façades the spread is 1 to 2.7; of one that stands at a distance and at eight times that, it is 6 to 8.
pub const MIN_SPREAD: f64 = 4.0;
/// The same within views. Around an object, in a room and along a façade it is 1.6 to 2.5; close to a floor or a table top with
/// the room behind, or among fences with mountains behind, it is 3.7 to 8.1, and there the filters are worth 0.4 to 1.2 dB
/// (docs/results/anti-aliasing.md). Points that something hides count, too: rooms seen through walls would make it larger than it is.
pub const MIN_SPREAD_WITHIN: f64 = 3.0;
/// Spreads leave out this share of the rates at either end: a camera that happens to pass close by is no second distance, nor
/// is a point that was triangulated badly.
const TAIL: f64 = 0.1;
/// Points looked at, evenly taken from the dataset's.
const MAX_POINTS: usize = 4096;
/// Views that must see a point for it to count.
const MIN_VIEWS: usize = 3;
/// Points, of those looked at, that a view must see for it to count.
const MIN_POINTS: usize = 20;

/// Spreads of the sampling rates of the training views, at the points in their images (hidden or not).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spreads {
    /// From view to view: at each point the 90th percentile of f/z over the 10th; of those the median over the points that
    /// three views see. Without such a point, the same at the point closest to all optical axes; none where not even that is
    /// in view.
    pub across: Option<f64>,
    /// Within views: in each the 90th percentile of the points' f/z over the 10th; of those the median over the views that see
    /// 20 of the points looked at (4096 at most). None where fewer than half of the views do.
    pub within: Option<f64>,
}

impl Spreads {
    /// True if either spread reaches its bar.
    #[must_use]
    pub fn ask_for_filters(&self) -> bool {
        let reaches = |spread: Option<f64>, bar| spread.is_some_and(|s| s >= bar);
        reaches(self.across, MIN_SPREAD) || reaches(self.within, MIN_SPREAD_WITHIN)
    }

    /// Spreads of a dataset's training views.
    #[must_use]
    pub fn of(dataset: &Dataset) -> Self {
        let cameras = cameras(dataset);
        let points = &dataset.points.positions;
        let step = points.len().div_ceil(MAX_POINTS).max(1);
        let sampled = points.iter().step_by(step);
        let sampled: Vec<DVec3> = sampled
            .map(|p| DVec3::from_array(p.map(f64::from)))
            .collect();
        let at = |p: &DVec3| ratio(cameras.iter().map(|c| c.sampling_rate(*p)), MIN_VIEWS);
        let of = |c: &Camera| ratio(sampled.iter().map(|p| c.sampling_rate(*p)), MIN_POINTS);
        let center = || at(&center_of_attention(&dataset.train)?);
        let each: Vec<f64> = cameras.iter().filter_map(of).collect();
        let most = 2 * each.len() >= cameras.len();
        Self {
            across: upper_median(sampled.iter().filter_map(at)).or_else(center),
            within: upper_median(each.into_iter()).filter(|_| most),
        }
    }
}

fn cameras(dataset: &Dataset) -> Vec<Camera> {
    dataset.train.iter().map(|v| v.camera).collect()
}

/// The 90th percentile of the rates that there are over the 10th, if they are so many.
fn ratio(rates: impl Iterator<Item = Option<f64>>, least: usize) -> Option<f64> {
    let rates = sorted(rates.flatten());
    if rates.len() < least {
        return None;
    }
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
