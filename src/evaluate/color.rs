//! Colour-corrected scores: those of the render under the affine transform that fits it best to the photo. A held-out view has
//! no transform of its own, and if training compensates exposure, plain scores also measure its photo's exposure. gsplat
//! calls the PSNR after such a fit `cc_psnr`.

use crate::base::error::Result;
use crate::device::Array;
use crate::evaluate::{Evaluator, ViewScore, psnr_and_ssim};
use crate::pipeline::forward::Renders;
use crate::pipeline::stage::exposure::exposed;
use crate::pipeline::stage::loss::ImagePair;

/// Weight of the identity per pixel, which decides if the pixels do not, say in a picture of one colour.
const RIDGE: f64 = 1e-6;

/// The affine transform, row-major \[A | b\], that takes `render` to `photo` with the least squared error. Both planar
/// \[3, pixels\].
#[must_use]
pub fn fit(render: &[f32], photo: &[f32], mask: &[f32]) -> [f64; 12] {
    let n = render.len() / 3;
    let ridge = RIDGE * n as f64;
    let mut rows = [[0.0; 7]; 4];
    for i in 0..n {
        let of = |v: &[f32], c: usize| f64::from(v[c * n + i]);
        let m = mask.get(i).map_or(1.0, |m| f64::from(*m));
        let x = [of(render, 0), of(render, 1), of(render, 2), 1.0].map(|v| m * v);
        for (row, a) in rows.iter_mut().zip(x) {
            for (sum, b) in row.iter_mut().zip(x) {
                *sum += a * b;
            }
            for c in 0..3 {
                row[4 + c] += a * of(photo, c);
            }
        }
    }
    for (k, row) in rows.iter_mut().enumerate() {
        row[k] += ridge;
        if k < 3 {
            row[4 + k] += ridge;
        }
    }
    // Gauss-Jordan; the ridge keeps every pivot of this positive definite matrix away from zero.
    for k in 0..4 {
        let pivot = rows[k];
        for (r, row) in rows.iter_mut().enumerate() {
            let factor = if r == k {
                1.0 - 1.0 / pivot[k]
            } else {
                row[k] / pivot[k]
            };
            for (v, p) in row.iter_mut().zip(pivot) {
                *v -= factor * p;
            }
        }
    }
    std::array::from_fn(|k| rows[k % 4][4 + k / 4])
}

/// A x + b of a planar image \[3, pixels\].
#[must_use]
pub fn corrected(render: &[f32], e: &[f64; 12]) -> Vec<f32> {
    let e = e.map(|v| v as f32);
    let n = render.len() / 3;
    let mut out = vec![0.0; 3 * n];
    for i in 0..n {
        let color = exposed(&e, [0, 1, 2].map(|c| render[c * n + i]));
        for (c, v) in color.into_iter().enumerate() {
            out[c * n + i] = v;
        }
    }
    out
}

impl Evaluator {
    /// Adds the colour-corrected PSNR and SSIM to the scores of all views, in their order.
    ///
    /// # Errors
    /// Those of [`Evaluator::score_all`].
    pub fn add_color_corrected(
        &self,
        scores: &mut [ViewScore],
        scene: &mut dyn Renders,
        background: [f32; 3],
    ) -> Result<()> {
        for score in scores {
            let Some(view) = self.views.names.iter().position(|n| *n == score.view) else {
                continue;
            };
            // Leaves the clamped image in the renderer.
            self.score(view, &[], scene, background)?;
            let renderer = scene.renderer();
            let camera = &self.views.cameras[view];
            let image = renderer.read_image()?;
            let (photo, mask) = self.compared(view, background)?;
            let values = corrected(&image.rgb, &fit(&image.rgb, &photo, &mask));
            let ([w, h], [stride, rows]) = (camera.image().pixels, camera.image().padded());
            let mut padded = vec![0.0; 3 * stride * rows];
            for (k, row) in values.chunks_exact(w).enumerate() {
                let at = (k / h * rows + k % h) * stride;
                padded[at..at + w].copy_from_slice(row);
            }
            let image = Array::from_slice(renderer.device(), "corrected", &padded)?;
            let photo = self.views.photo(view, &[])?;
            let pair = ImagePair {
                image: &image,
                ..ImagePair::new(&renderer.frame, &photo, background)
            };
            let [psnr, ssim] = psnr_and_ssim(&self.scoring.errors(&pair)?);
            (score.scores.cc_psnr, score.scores.cc_ssim) = (Some(psnr), Some(ssim));
        }
        Ok(())
    }
}
