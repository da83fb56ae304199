//! Twin of `kernels/loss.cl`: L1 + SSIM, window by window.

use crate::constants::{SSIM_C, SSIM_SIGMA, SSIM_TAPS};

/// The 11-tap Gaussian window, σ = 1.5, normalised.
fn window() -> [f64; SSIM_TAPS] {
    let raw = std::array::from_fn(|k| {
        (-(k as f64 - 5.0).powi(2) / (2.0 * SSIM_SIGMA * SSIM_SIGMA)).exp()
    });
    let sum: f64 = raw.iter().sum();
    raw.map(|v| v / sum)
}

/// What the loss stage gives.
#[derive(Debug, Clone, Default)]
pub struct Loss64 {
    /// Mean |x − y|.
    pub l1: f64,
    /// Mean SSIM.
    pub ssim: f64,
    /// dL/dx \[3, height, width\].
    pub gradient: Vec<f64>,
    /// Channel means of 1 − SSIM \[height, width\].
    pub ssim_error: Vec<f64>,
    /// Channel means of |x − y| \[height, width\].
    pub l1_error: Vec<f64>,
}

/// L = (1 − λ)·mean|x − y| + λ·(1 − mean SSIM) of planar images \[3, height, width\]; zero padding.
#[must_use]
pub fn loss(x: &[f64], y: &[f64], size: [usize; 2], lambda: f64) -> Loss64 {
    let [w, h] = size;
    let n = w * h;
    let total = (3 * n) as f64;
    let taps = window();
    let mut out = Loss64 {
        gradient: vec![0.0; 3 * n],
        ssim_error: vec![0.0; n],
        l1_error: vec![0.0; n],
        ..Loss64::default()
    };
    for c in 0..3 {
        let (a, b) = (&x[c * n..(c + 1) * n], &y[c * n..(c + 1) * n]);
        for at in 0..n {
            let d = a[at] - b[at];
            out.l1 += d.abs() / total;
            out.l1_error[at] += d.abs() / 3.0;
            if d != 0.0 {
                out.gradient[c * n + at] += (1.0 - lambda) * d.signum() / total;
            }
            let inside = |(i, j): (usize, usize)| -> Option<(usize, f64)> {
                let (px, py) = ((at % w + j).checked_sub(5)?, (at / w + i).checked_sub(5)?);
                (px < w && py < h).then_some((py * w + px, taps[i] * taps[j]))
            };
            let cells: Vec<(usize, f64)> =
                (0..121).filter_map(|k| inside((k / 11, k % 11))).collect();
            let (ssim, [dm, dxx, dxy]) = ssim_at(a, b, &cells);
            out.ssim += ssim / total;
            out.ssim_error[at] += (1.0 - ssim) / 3.0;
            for (p, weight) in &cells {
                let d = weight * (dm + 2.0 * a[*p] * dxx + b[*p] * dxy);
                out.gradient[c * n + p] -= lambda * d / total;
            }
        }
    }
    out
}

/// SSIM of one window and its derivatives with respect to E[x], E[x²] and E[xy]. Variances are sums of squared
/// differences to the mean; what the window has outside of the image is 0 there.
fn ssim_at(a: &[f64], b: &[f64], cells: &[(usize, f64)]) -> (f64, [f64; 3]) {
    let [c1, c2] = SSIM_C;
    let mean = |v: &[f64]| cells.iter().map(|(p, w)| w * v[*p]).sum::<f64>();
    let (mx, my) = (mean(a), mean(b));
    let outside = 1.0 - cells.iter().map(|(_, w)| w).sum::<f64>();
    let moment = |u: &[f64], mu: f64, v: &[f64], mv: f64| {
        cells
            .iter()
            .map(|(p, w)| w * (u[*p] - mu) * (v[*p] - mv))
            .sum::<f64>()
            + outside * mu * mv
    };
    let (vx, vy, cov) = (
        moment(a, mx, a, mx),
        moment(b, my, b, my),
        moment(a, mx, b, my),
    );
    let (a1, a2) = (2.0 * mx * my + c1, 2.0 * cov + c2);
    let (b1, b2) = (mx * mx + my * my + c1, vx + vy + c2);
    let ssim = a1 * a2 / (b1 * b2);
    let dxx = -ssim / b2;
    let dxy = 2.0 * a1 / (b1 * b2);
    let dm = 2.0 * my * a2 / (b1 * b2) - 2.0 * mx * ssim / b1 - 2.0 * mx * dxx - my * dxy;
    (ssim, [dm, dxx, dxy])
}
