//! The similarity between the dataset's own frame and the local frame.

use glam::DVec3;

/// `dataset = local · scale + center`; no rotation, so that orientations and SH coefficients need no change.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Frame {
    /// Origin of the local frame, in the dataset's units.
    pub center: DVec3,
    /// Dataset units per local unit (the scene extent), > 0.
    pub scale: f64,
}

impl Frame {
    /// The frame in which nothing changes.
    pub const IDENTITY: Self = Self {
        center: DVec3::ZERO,
        scale: 1.0,
    };

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
