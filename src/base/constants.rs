//! Constants of the image formation. Each has its owner here and reaches OpenCL C through the prelude.

/// Cap of alpha (3DGS uses 0.99, \[MH\]'s code base 0.999).
pub const ALPHA_MAX: f64 = 0.999;
/// Contributions below this alpha are dropped (3DGS).
pub const ALPHA_MIN: f64 = 1.0 / 255.0;
/// Transmittance below which a pixel takes no more contributions (3DGS).
pub const T_MIN: f64 = 1e-4;
/// Colour channel at or above which a Gaussian is culled as invalid: far beyond any photo (1), and its eighth power, which
/// occurs in the derivative of SSIM, is still finite in f32.
pub const COLOR_MAX: f64 = 1e4;
/// Variance added to the diagonal of the 2D covariance, pixels²: 3DGS's dilation, 0.3, or with anti-aliasing the variance of
/// Mip-Splatting's 2D filter, 0.1 (§6.1: about one pixel; with the 3D filter's 0.2 they come to 0.3 again).
#[must_use]
pub const fn blur(anti_alias: bool) -> f64 {
    if anti_alias { 0.1 } else { 0.3 }
}
/// Variance of the 3D smoothing filter, in squares of the finest sampling distance (Mip-Splatting, §5).
pub const FILTER_VARIANCE: f64 = 0.2;
/// Share of its width and height by which an image is widened on each side when sampling rates are taken (Mip-Splatting, code).
pub const FILTER_MARGIN: f64 = 0.15;
/// Number of chunks in which the filter stage finds the largest filter.
pub const FILTER_CHUNKS: u32 = 256;
/// Slack of the tile test in the exponent (base 2), for f32 rounding.
pub const TILE_SLACK: f64 = 1e-3;
/// Range to which log-scales are clamped, so that the covariance stays finite in f32.
pub const LOG_SCALE: [f64; 2] = [-30.0, 15.0];
/// Near plane in units of the scene extent; exact in f32, so that both precisions cull the same Gaussians.
pub const NEAR: f64 = 1.0 / 256.0;
/// Sums that splat_grad writes per pair.
pub const SUMS: usize = 9;
/// Bytes of a projected Gaussian in f32.
pub const RECORD_BYTES: usize = 48;
/// Pairs of a Gaussian beyond which a work-group adds their sums in the group style, so that none has to wait for one work-item.
pub const LARGE_PAIRS: u32 = 64;
/// Projected Gaussians that the splat kernels copy at a time where a work-item is a whole core (measured: 32 on CPUs).
pub const SPLAT_BATCH: u32 = 32;
/// The same in the group style, to local memory (docs/results/gpu-measured.md).
pub const GROUP_BATCH: u32 = 64;
/// Consecutive Gaussians that groups take in turns in the group style, where those of a group take large ones together.
pub const GROUP_SPREAD: usize = 8;
/// Number of work-groups, enough for a large GPU, that Gaussians are shared out over before a group gets more than [`GROUP_SPREAD`] of them,
/// where groups take large ones together (docs/results/gpu-measured.md).
pub const SHARING_GROUPS: usize = 1024;
/// Bins whose chunks a work-group of sort_totals sums up.
pub const SORT_BINS: u32 = 8;
/// Bits of the number of elements that a work-group of sort_scatter sorts at a time.
pub const SORT_BLOCK_BITS: u32 = 10;
/// Maps that a sweep of the loss writes in the group style, as bits: derivatives of SSIM, errors.
pub const LOSS_DERIVATIVES: u32 = 1;
/// See [`LOSS_DERIVATIVES`].
pub const LOSS_ERRORS: u32 = 2;
/// Image rows per work-item of the loss.
pub const LOSS_ROWS: u32 = 8;
/// Pixels of a row per work-item of the shrink stage.
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
/// Pixels per degree of the visual field at which ꟻLIP is given: a screen 0.7 m away, 0.7 m wide, of 3840 pixels.
pub const FLIP_PIXELS_PER_DEGREE: f64 = 67.0;
/// Radius of ꟻLIP's filters there, pixels: three standard deviations of the widest.
pub const FLIP_REACH: usize = 10;
/// Exponent of ꟻLIP's colour difference (Andersson et al. 2020, §4.1.3).
pub const FLIP_POWER: f64 = 0.7;
/// Point (share of the largest difference, error) at which the compression of ꟻLIP's colour differences becomes a straight line (§4.1.3).
pub const FLIP_KNEE: [f64; 2] = [0.4, 0.95];

/// Numbers per axis of the grid of Morton cells on the device.
pub const MORTON_GRID: usize = 4;
