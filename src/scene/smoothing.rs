//! Mip-Splatting's 3D smoothing filter (Yu et al., CVPR 2024): its size (Eq. 6 to 8), its application to scales and opacities
//! (Eq. 9), and its removal.

use crate::base::constants::{FILTER_VARIANCE, LOG_SCALE};
use crate::base::error::{Error, Result};
use crate::base::math::ln_sigmoid;
use crate::capture::{Camera, Dataset};
use crate::scene::gaussians::{Gaussians, Plane};

/// The Gaussians of a PLY file without the 3D filter that it includes, computed from the training views of this dataset; training
/// filters them itself.
///
/// # Errors
/// A value that is then not finite.
pub fn without_filter(splats: &Gaussians, dataset: &Dataset) -> Result<Gaussians> {
    let position = |i: usize| splats.gather::<3>(Plane::POSITION, i).map(f64::from);
    let cameras: Vec<Camera> = dataset.train.iter().map(|v| v.camera).collect();
    let sigma = filters((0..splats.len()).map(position), &cameras);
    splats.unfiltered(&sigma.iter().map(|s| *s as f32).collect::<Vec<_>>())
}

/// Smallest share of a squared scale that remains when the filter is removed: f32 does not resolve less.
const MIN_OWN: f64 = 1e-4;
/// Largest opacity after the removal of a filter.
const MAX_OPACITY: f64 = 0.999;

/// The logit of an opacity's logarithm, 1 − o without cancellation.
fn logit_of(ln_o: f64) -> f64 {
    ln_o - (-ln_o.exp_m1()).ln()
}

/// Standard deviation of the 3D filter of a Gaussian at every position, local units \[N\]: √0.2 over the highest sampling rate of the
/// views that see its centre ([`Camera::sampling_rate`]); the largest of the others for a Gaussian that no view sees, 0 for all
/// if none is seen.
#[must_use]
pub fn filters(positions: impl Iterator<Item = [f64; 3]>, cameras: &[Camera]) -> Vec<f64> {
    let of_one = |x: [f64; 3]| {
        let rates = cameras.iter().filter_map(|c| c.sampling_rate(x.into()));
        let highest = rates.reduce(f64::max);
        highest.map(|rate| FILTER_VARIANCE.sqrt() / rate)
    };
    let own: Vec<Option<f64>> = positions.map(of_one).collect();
    let largest = own.iter().flatten().copied().fold(0.0, f64::max);
    own.into_iter().map(|v| v.unwrap_or(largest)).collect()
}

impl Gaussians {
    /// The same Gaussians after a 3D filter of standard deviations `sigma` \[N\], of the scales' unit: scales √(s² + σ²), opacities
    /// times √(Π s² / Π (s² + σ²)). A Gaussian whose σ is 0 keeps its bits.
    ///
    /// # Errors
    /// Another number of standard deviations than of Gaussians, or a value that is then not finite.
    pub fn filtered(&self, sigma: &[f32]) -> Result<Self> {
        self.changed(sigma, |own, sigma| {
            let own = own.clamp(LOG_SCALE[0], LOG_SCALE[1]);
            own + 0.5 * (sigma * (-own).exp()).powi(2).ln_1p()
        })
    }

    /// The approximate inverse of [`Gaussians::filtered`]: a squared scale keeps at least 1e-4 of its value, and no opacity is raised
    /// above 0.999. Training on from a filtered scene, which filters it again, starts here.
    ///
    /// # Errors
    /// Those of [`Gaussians::filtered`].
    pub fn unfiltered(&self, sigma: &[f32]) -> Result<Self> {
        self.changed(sigma, |wide, sigma| {
            let own = 1.0 - (sigma * (-wide).exp()).powi(2);
            wide + 0.5 * own.max(MIN_OWN).ln()
        })
    }

    /// New log-scales from the old ones and σ, and opacities so that their product with the three scales stays.
    fn changed(&self, sigma: &[f32], scale: impl Fn(f64, f64) -> f64) -> Result<Self> {
        if sigma.len() != self.len() {
            let what = format!("{} values; {} expected", sigma.len(), self.len());
            return Err(Error::numerics("filter", what));
        }
        let mut planes = self.planes().to_vec();
        for (i, sigma) in sigma.iter().enumerate().filter(|(_, s)| **s != 0.0) {
            let mut ln_left = 0.0;
            for plane in &mut planes[Plane::LOG_SCALE..Plane::ROTATION] {
                let old = f64::from(plane[i]);
                let new = scale(old, f64::from(*sigma));
                plane[i] = new as f32;
                ln_left += old.clamp(LOG_SCALE[0], LOG_SCALE[1]) - new;
            }
            let ln_o = ln_sigmoid(f64::from(planes[Plane::OPACITY][i]));
            let most = ln_o.max(MAX_OPACITY.ln());
            planes[Plane::OPACITY][i] = logit_of((ln_o + ln_left).min(most)) as f32;
        }
        Self::new(self.sh_degree(), planes)
    }
}
