//! Pinhole camera in OpenCV axes.

use glam::{DMat3, DVec3};

use crate::base::constants::{FILTER_MARGIN, NEAR};

/// A pinhole camera: x right, y down, z forward; pixel centres at +0.5.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Rotation W from the (local) scene frame to the camera frame.
    pub rotation: DMat3,
    /// Translation t₀: a point x of the scene lies at `rotation·x + translation` in the camera frame, local units.
    pub translation: DVec3,
    /// Focal length in x, pixels.
    pub fx: f64,
    /// Focal length in y, pixels.
    pub fy: f64,
    /// Principal point x, pixels from the left edge of the image.
    pub cx: f64,
    /// Principal point y, pixels from the upper edge of the image.
    pub cy: f64,
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
}

/// World-to-camera rotation of a camera whose axes have these directions in the world. They are normalised, which undoes the scale of a
/// scaled camera object; `None` for axes that are no rotation within 1 %.
pub(super) fn camera_axes(axes: [DVec3; 3]) -> Option<DMat3> {
    let [x, y, z] = axes.map(DVec3::normalize_or_zero);
    // NaN is near nothing.
    let rigid = (DMat3::from_cols(x, y, z).determinant() - 1.0).abs() < 0.01;
    // Gram–Schmidt from the viewing axis; files with few digits are off by their rounding.
    let x = (x - z * x.dot(z)).normalize();
    let y = z.cross(x);
    rigid.then(|| DMat3::from_cols(x, y, z).transpose())
}

impl Camera {
    /// The camera of intrinsics (fx, fy, cx, cy) and a size (width, height), pixels, at a pose from the scene to the camera frame.
    #[must_use]
    pub fn new([fx, fy, cx, cy]: [f64; 4], size: [u32; 2], pose: (DMat3, DVec3)) -> Self {
        Self {
            rotation: pose.0,
            translation: pose.1,
            fx,
            fy,
            cx,
            cy,
            width: size[0],
            height: size[1],
        }
    }

    /// Centre of projection in the scene frame: −Wᵀ t₀.
    #[must_use]
    pub fn center(&self) -> DVec3 {
        -(self.rotation.transpose() * self.translation)
    }

    /// Sampling rate at a point in pixels per local unit, f/z with the larger focal length; `None` outside of the image widened by
    /// [`FILTER_MARGIN`] on each side (Mip-Splatting, Yu et al. 2024, Eq. 6).
    #[must_use]
    pub fn sampling_rate(&self, x: DVec3) -> Option<f64> {
        let t = self.rotation * x + self.translation;
        let inside = |p: f64, size: u32| {
            let size = f64::from(size);
            p >= -FILTER_MARGIN * size && p <= (1.0 + FILTER_MARGIN) * size
        };
        let seen = t.z > NEAR
            && inside(self.fx * t.x / t.z + self.cx, self.width)
            && inside(self.fy * t.y / t.z + self.cy, self.height);
        seen.then(|| self.fx.max(self.fy) / t.z)
    }

    /// The same camera for a photo resampled to `width` × `height` pixels. Focal lengths and principal point scale per
    /// axis: with pixel centres at +0.5, pixel coordinates are continuous lengths from the image's corner and a plain
    /// factor is exact.
    #[must_use]
    pub fn scaled_to(&self, width: u32, height: u32) -> Self {
        let sx = f64::from(width) / f64::from(self.width);
        let sy = f64::from(height) / f64::from(self.height);
        Self {
            fx: self.fx * sx,
            fy: self.fy * sy,
            cx: self.cx * sx,
            cy: self.cy * sy,
            width,
            height,
            ..*self
        }
    }
}
