//! A training view for density control: pixels and the camera.

use std::borrow::Cow;
use std::fmt::Debug;
use std::sync::Arc;

/// Pixels of a photo.
pub trait Colors: Debug + Send + Sync {
    /// Red, green, blue of a pixel, row by row, in the scene's colours: without a mask or a background, and without the view's
    /// exposure if that is compensated.
    fn at(&self, pixel: usize) -> [f32; 3];

    /// True if the photo's mask hides a pixel: no surface is trained there.
    fn is_masked(&self, _pixel: usize) -> bool {
        false
    }
}

/// Planes \[3\]\[height · width\].
impl Colors for [Vec<f32>; 3] {
    fn at(&self, pixel: usize) -> [f32; 3] {
        self.each_ref().map(|plane| plane[pixel])
    }
}

/// A current render of a view, and its photo, few of whose pixels are asked for.
#[derive(Debug, Clone)]
pub struct Picture<'a> {
    /// Width and height, pixels.
    pub size: [usize; 2],
    /// Values from one row of `error`, `depth` and `transmittance` to the next.
    pub stride: usize,
    /// fx, fy, cx, cy, pixels.
    pub intrinsics: [f32; 4],
    /// Rotation scene → camera, row major.
    pub rotation: [f32; 9],
    /// Centre of projection, local units.
    pub center: [f32; 3],
    /// The photo.
    pub photo: Arc<dyn Colors + 'a>,
    /// Mean over the channels of |render − photo|, times the photo's mask and opacity \[height, stride\].
    pub error: Cow<'a, [f32]>,
    /// Depth (camera z) of the render, weighted by opacity, local units \[height, stride\].
    pub depth: Cow<'a, [f32]>,
    /// Remaining transmittance \[height, stride\].
    pub transmittance: Cow<'a, [f32]>,
}

impl Picture<'_> {
    /// Place of a pixel in the planes of the render.
    #[must_use]
    pub fn at(&self, pixel: usize) -> usize {
        pixel / self.size[0] * self.stride + pixel % self.size[0]
    }

    /// Remaining transmittance and mean depth at a pixel; the depth is not finite at an empty one. `None` beyond the last pixel.
    #[must_use]
    pub fn surface(&self, pixel: usize) -> Option<[f32; 2]> {
        let at = self.at(pixel);
        let left = *self.transmittance.get(at)?;
        Some([left, *self.depth.get(at)? / (1.0 - left)])
    }

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
        let [width, height] = self.size;
        let inside = (0.0..width as f64).contains(&across) && (0.0..height as f64).contains(&down);
        (z > 0.0 && inside).then(|| (z, down as usize * width + across as usize))
    }

    /// Width of a pixel across the view at depth `z`: the mean of both axes.
    #[must_use]
    pub fn footprint(&self, z: f64) -> f64 {
        let [fx, fy, ..] = self.intrinsics.map(f64::from);
        0.5 * (z / fx + z / fy)
    }
}
