//! The similarity between the dataset's own frame and the local frame.

use glam::DVec3;

use crate::base::math::upper_median;

/// `dataset = local · scale + center`; no rotation, so that orientations and SH coefficients need no change.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Frame {
    /// Origin of the local frame, in the dataset's units.
    pub center: DVec3,
    /// Dataset units per local unit (the scene extent), > 0.
    pub scale: f64,
}

impl Frame {
    /// The identity.
    pub const IDENTITY: Self = Self {
        center: DVec3::ZERO,
        scale: 1.0,
    };

    /// The frame whose origin is the mean camera centre and whose unit is 1.1 × the largest distance from it (3DGS).
    ///
    /// Cameras that share one centre say nothing about scale: then the median distance of the points serves, or 1 without
    /// points. "One centre" means within 1e-9 of the coordinates' size, about what f64 poses at UTM offsets resolve. Neither
    /// number need be finite for centres that are not.
    #[must_use]
    pub fn fit(centers: &[DVec3], points: &[DVec3]) -> Self {
        let center = centers.iter().sum::<DVec3>() / centers.len().max(1) as f64;
        let largest = centers
            .iter()
            .map(|c| c.distance(center))
            .fold(0.0, f64::max);
        let scale = if largest > 1e-9 * (center.length() + 1e-9) {
            1.1 * largest
        } else {
            let median = upper_median(points.iter().map(|p| p.distance(center)));
            median.filter(|m| *m > 0.0).unwrap_or(1.0)
        };
        Self { center, scale }
    }

    /// A point of the dataset's frame in local units.
    #[must_use]
    pub fn to_local(&self, p: DVec3) -> DVec3 {
        (p - self.center) / self.scale
    }

    /// A local point in the dataset's frame.
    #[must_use]
    pub fn to_dataset(&self, p: DVec3) -> DVec3 {
        p * self.scale + self.center
    }
}
