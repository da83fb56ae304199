//! Whether a run trains with Mip-Splatting's filters (Yu et al., CVPR 2024): by the option, or by how much the sampling rates of
//! the training views differ, from view to view or within each.
//!
//! A view samples a point at f/z pixels per unit of length, f the larger focal length and z the point's depth. Where some
//! views take one pixel for what others take many for, a scene trained without the filters shows in the first too thick, and
//! in views closer than any too thin: the 2D covariance gets the same blur whatever it is the covariance of. So it is for a
//! camera that moves among things near and far: few views come close to any one of them (a fence, the legs of a chair), so
//! that the rates at most points hardly differ from view to view, but those within each view do.

use glam::{DMat3, DVec3};

use crate::base::math::{sorted, upper_median};
use crate::capture::{Camera, Dataset, View};
use crate::config::{AntiAliasing, Init, TrainConfig};
use crate::scene::ply;

/// `auto` switches the filters on from this spread of the sampling rates from view to view on. Of ordinary captures of objects,
/// rooms and façades the spread is 1 to 2.7; of one that stands at a distance and at eight times that, it is 6 to 8.
pub const LEAST_SPREAD: f64 = 4.0;
/// Likewise within views. Around an object, in a room and along a façade it is 1.6 to 2.5; close to a floor or a table top with
/// the room behind, or among fences with mountains behind, it is 3.7 to 8.1, and there the filters are worth 0.4 to 1.2 dB
/// (README). Points that something hides count, too: rooms seen through walls would make it larger than it is.
pub const LEAST_SPREAD_WITHIN: f64 = 3.0;
/// Spreads leave out this share of the rates at either end: a camera that happens to pass close by is no second distance, nor
/// is a point that was triangulated badly.
const TAIL: f64 = 0.1;
/// Points looked at, evenly taken from the dataset's.
const MOST_POINTS: usize = 4096;
/// Views that must see a point for it to count.
const LEAST_VIEWS: usize = 3;
/// Points, of those looked at, that a view must see for it to count.
const LEAST_POINTS: usize = 20;

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
            (AntiAliasing::Auto, _) => Self::by_rates(Spreads::of(dataset)),
        }
    }

    fn by_rates(spreads: Spreads) -> Self {
        let measures = [
            (spreads.across, LEAST_SPREAD, "from view to view"),
            (spreads.within, LEAST_SPREAD_WITHIN, "within views"),
        ];
        let told = measures.map(|(spread, least, place)| {
            let spread = spread?;
            let says =
                format!("by a factor of {spread:.1} {place} (auto asks for {least} or more)");
            Some((spread >= least, says))
        });
        let told: Vec<(bool, String)> = told.into_iter().flatten().collect();
        let on = told.iter().any(|(met, _)| *met);
        // Switched on by what meets its bar; left out because neither does.
        let says = told.iter().filter(|(met, _)| *met == on);
        let says: Vec<&str> = says.map(|(_, says)| says.as_str()).collect();
        let why = match says.is_empty() {
            true => "the views share no point to compare their sampling rates at".into(),
            false => format!("sampling rates differ {}", says.join(" and ")),
        };
        Self { on, why }
    }
}

/// How much the sampling rates of the training views differ, at the sparse points in their images (hidden or not).
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
    /// Of a dataset's training views.
    #[must_use]
    pub fn of(dataset: &Dataset) -> Self {
        let cameras = cameras(dataset);
        let points = &dataset.points.positions;
        let step = points.len().div_ceil(MOST_POINTS).max(1);
        let sampled = points.iter().step_by(step);
        let sampled: Vec<DVec3> = sampled
            .map(|p| DVec3::from_array(p.map(f64::from)))
            .collect();
        let at = |p: &DVec3| ratio(cameras.iter().map(|c| c.sampling_rate(*p)), LEAST_VIEWS);
        let of = |c: &Camera| ratio(sampled.iter().map(|p| c.sampling_rate(*p)), LEAST_POINTS);
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
