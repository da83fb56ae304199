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
    /// True for each pixel that the photo's mask hides, where no surface is trained; empty without masks.
    pub masked: Vec<bool>,
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

    /// Camera z of a point and number of the pixel that shows it; `None` behind the camera and outside of the image.
    #[must_use]
    pub fn project(&self, point: [f64; 3]) -> Option<(f64, usize)> {
        let w = self.rotation.map(f64::from);
        let offset: [f64; 3] = std::array::from_fn(|k| point[k] - f64::from(self.center[k]));
        let [x, y, z] = [0, 1, 2].map(|r| (0..3).map(|k| w[3 * r + k] * offset[k]).sum::<f64>());
        let [fx, fy, cx, cy] = self.intrinsics.map(f64::from);
        let (across, down) = (fx * x / z + cx, fy * y / z + cy);
        let height = self.depth.len() / self.width.max(1);
        let inside =
            (0.0..self.width as f64).contains(&across) && (0.0..height as f64).contains(&down);
        (z > 0.0 && inside).then(|| (z, down as usize * self.width + across as usize))
    }

    /// Width of a pixel across the view at depth `z`: the mean of both axes.
    #[must_use]
    pub fn footprint(&self, z: f64) -> f64 {
        let [fx, fy, ..] = self.intrinsics.map(f64::from);
        0.5 * (z / fx + z / fy)
    }
}
