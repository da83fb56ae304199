//! A training view for density control: pixels and the camera.

/// A current render of a view, and its photo. Planes are row by row \[height · width\].
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Width, pixels.
    pub width: usize,
    /// fx, fy, cx, cy, pixels.
    pub intrinsics: [f32; 4],
    /// Rotation scene → camera, row major.
    pub rotation: [f32; 9],
    /// Centre of projection, local units.
    pub center: [f32; 3],
    /// The photo's red, green, blue in the scene's colours: without a mask or a background, and without the view's exposure if
    /// that is compensated.
    pub photo: [Vec<f32>; 3],
    /// Mean over the channels of |render − photo|, times the photo's mask and opacity.
    pub error: Vec<f32>,
    /// Mean depth (camera z) of the render, local units; not finite at empty pixels.
    pub depth: Vec<f32>,
    /// Remaining transmittance.
    pub transmittance: Vec<f32>,
}

impl Picture {
    /// The point at depth `z` that is seen at `at` pixels from the image's upper left corner.
    #[must_use]
    pub fn point(&self, at: [f64; 2], z: f64) -> [f64; 3] {
        let [fx, fy, cx, cy] = self.intrinsics.map(f64::from);
        let seen = [z * (at[0] - cx) / fx, z * (at[1] - cy) / fy, z];
        let w = self.rotation.map(f64::from);
        // Wᵀ takes camera axes to the scene's.
        std::array::from_fn(|k| {
            f64::from(self.center[k]) + (0..3).map(|r| w[3 * r + k] * seen[r]).sum::<f64>()
        })
    }

    /// Width of a pixel across the view at depth `z`: the mean of both axes.
    #[must_use]
    pub fn footprint(&self, z: f64) -> f64 {
        let [fx, fy, ..] = self.intrinsics.map(f64::from);
        0.5 * (z / fx + z / fy)
    }
}
