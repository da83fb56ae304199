//! Constants of the image formation. Each has its owner here and reaches OpenCL C through the prelude.

/// Edge of a tile, pixels.
pub const TILE: u32 = 16;
/// Cap of alpha (3DGS uses 0.99, \[MH\]'s code base 0.999).
pub const ALPHA_MAX: f64 = 0.999;
/// Contributions below this alpha are dropped (3DGS).
pub const ALPHA_MIN: f64 = 1.0 / 255.0;
/// A pixel takes contributions while its transmittance is at least this (3DGS).
pub const T_MIN: f64 = 1e-4;
/// A colour channel at or above this is taken for broken and its Gaussian is culled: far beyond any photo (1), and its
/// eighth power, which the derivative of SSIM holds, is still finite in f32.
pub const COLOR_MAX: f64 = 1e4;
/// Added to the diagonal of the 2D covariance, pixels²: 3DGS's dilation, 0.3, or with anti-aliasing the variance of
/// Mip-Splatting's 2D filter, 0.1 (§6.1: about one pixel; with the 3D filter's 0.2 they come to 0.3 again).
#[must_use]
pub const fn blur(anti_alias: bool) -> f64 {
    if anti_alias { 0.1 } else { 0.3 }
}
/// Variance of the 3D smoothing filter, in squares of the finest sampling distance (Mip-Splatting, §5).
pub const FILTER_VARIANCE: f64 = 0.2;
/// A view samples what lies in its image widened by this share of its width and height on each side (Mip-Splatting, code).
pub const FILTER_MARGIN: f64 = 0.15;
/// Chunks of Gaussians of which the filter stage takes the largest filter.
pub const FILTER_CHUNKS: u32 = 256;
/// Slack of the tile test in the exponent (base 2), for f32 rounding.
pub const TILE_SLACK: f64 = 1e-3;
/// Log-scales are clamped to this range, in which the covariance stays finite in f32.
pub const LOG_SCALE: [f64; 2] = [-30.0, 15.0];
/// Near plane in units of the scene extent.
pub const NEAR: f64 = 0.04;
/// Sums that splat_grad writes per pair.
pub const SUMS: usize = 9;
/// Records that the splat kernels copy next to the processor at a time (measured: 32 on CPUs).
pub const STAGE: u32 = 32;
/// Rows of the image that one work-item of the loss windows together.
pub const LOSS_ROWS: u32 = 8;
/// Pixels of a row that a work-item of the shrink stage writes.
pub const SHRINK_RUN: u32 = 16;
/// Independent chains of multiply-adds in the peak benchmark: more than the latency (4 cycles) times the units (2) of
/// CPUs, and few enough to stay in 16 registers.
pub const PEAK_CHAINS: u32 = 12;
/// Taps of SSIM's window (Wang et al. 2004).
pub const SSIM_TAPS: usize = 11;
/// Standard deviation of SSIM's window, pixels.
pub const SSIM_SIGMA: f64 = 1.5;
/// Constants C1 and C2 of SSIM for a data range of 1.
pub const SSIM_C: [f64; 2] = [0.01 * 0.01, 0.03 * 0.03];
