//! [`Defines`]: the constants and choices that kernels are compiled with.

use std::fmt::Write as _;

use crate::base::constants::{self, blur};
use crate::capture::Alpha;
use crate::device::tuning::{self, Tuning, status};
use crate::scene::{Plane, morton};

/// Choices that a program is compiled with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Defines {
    /// Sizes for the device.
    pub tuning: Tuning,
    /// Contributions below this alpha are dropped.
    pub alpha_min: f64,
    /// SH degree in use.
    pub sh_degree: u32,
    /// Meaning of the photos' fourth plane.
    pub alpha: Alpha,
    /// Leave vectors of Gaussians that cannot be seen alone before most of the work is done.
    pub cull_chunks: bool,
    /// With photos that have alpha or masks, leave what is blank in render and photo out of the loss.
    pub skip_blank: bool,
    /// Use Mip-Splatting's filters: project and project_grad take the 3D filter of each Gaussian.
    pub anti_alias: bool,
    /// project_grad takes a step of the optimiser in place of writing gradients.
    pub take_step: bool,
    /// Build the layout probe.
    pub layout_probe: bool,
}

impl Defines {
    /// The defaults for a device.
    #[must_use]
    pub fn new(tuning: Tuning) -> Self {
        Self {
            tuning,
            alpha_min: constants::ALPHA_MIN,
            sh_degree: 0,
            alpha: Alpha::None,
            cull_chunks: true,
            skip_blank: true,
            anti_alias: false,
            take_step: false,
            layout_probe: false,
        }
    }

    /// Number of planes of the photos that kernels read: colour, and alpha if there is any.
    #[must_use]
    pub fn photo_planes(&self) -> usize {
        self.alpha.planes()
    }

    /// True if the photos have masks.
    #[must_use]
    pub fn masked(&self) -> bool {
        self.alpha == Alpha::Mask
    }

    /// True if the loss leaves out what is blank.
    #[must_use]
    pub fn skips_blank(&self) -> bool {
        self.skip_blank && self.alpha != Alpha::None
    }

    /// The `#define`s that stand before the source of a kernel.
    pub(super) fn prelude(&self, is_double: bool) -> String {
        let mut text = String::new();
        let mut int = |name: &str, v: u64| {
            let _ = writeln!(text, "#define {name} {v}");
        };
        int("REAL_IS_DOUBLE", u64::from(is_double));
        int("VW", u64::from(self.tuning.vector_width));
        int("BLOCK_W", u64::from(self.tuning.block_width));
        int("TILE", u64::from(self.tuning.tile));
        int("GROUP_STYLE", u64::from(self.tuning.group_style));
        int("SUMS", constants::SUMS as u64);
        let batch = match self.tuning.group_style {
            true => constants::GROUP_BATCH,
            false => constants::SPLAT_BATCH,
        };
        int("SPLAT_BATCH", u64::from(batch));
        int("LARGE_PAIRS", u64::from(constants::LARGE_PAIRS));
        int("SPLAT_GROUP", u64::from(self.tuning.splat_group));
        int("GRAD_GROUP", u64::from(self.tuning.grad_group));
        int("GRAD_SEGMENT", u64::from(self.tuning.grad_segment));
        int("GRAD_SUMS", u64::from(self.tuning.grad_sums));
        int("SPREAD", constants::GROUP_SPREAD as u64);
        int("GROUP_BINS", u64::from(constants::SORT_BINS));
        int("BLOCK_BITS", u64::from(constants::SORT_BLOCK_BITS));
        int("TAPS", constants::SSIM_TAPS as u64);
        int("FLIP_REACH", constants::FLIP_REACH as u64);
        int("LOSS_DERIVATIVES", u64::from(constants::LOSS_DERIVATIVES));
        int("LOSS_ERRORS", u64::from(constants::LOSS_ERRORS));
        int("ERROR_SETS", self.tuning.error_sets() as u64);
        int("LOSS_ROWS", u64::from(constants::LOSS_ROWS));
        int("SHRINK_RUN", u64::from(constants::SHRINK_RUN));
        int("SKIP_BLANK", u64::from(self.skips_blank()));
        int("CULL_CHUNKS", u64::from(self.cull_chunks));
        int("ANTI_ALIAS", u64::from(self.anti_alias));
        int("TAKE_STEP", u64::from(self.take_step));
        int("UPDATE_RUN", self.tuning.update_run() as u64);
        int("FILTER_CHUNKS", u64::from(constants::FILTER_CHUNKS));
        int("CHAINS", u64::from(constants::PEAK_CHAINS));
        int("STRIP", u64::from(self.tuning.strip));
        int("SH_DEGREE", u64::from(self.sh_degree));
        int("HAS_ALPHA", u64::from(self.alpha == Alpha::Transparency));
        int("HAS_MASK", u64::from(self.masked()));
        int("P_POSITION", Plane::POSITION as u64);
        int("P_LOG_SCALE", Plane::LOG_SCALE as u64);
        int("P_ROTATION", Plane::ROTATION as u64);
        int("P_OPACITY", Plane::OPACITY as u64);
        int("P_SH", Plane::SH as u64);
        int("MORTON_BITS", u64::from(morton::BITS));
        int("LAYER_BITS", u64::from(morton::LAYER_BITS));
        int("OCTAVE_BITS", u64::from(morton::OCTAVE_BITS));
        int("MORTON_GRID", constants::MORTON_GRID as u64);
        int("STATUS_SLOTS", status::SLOTS as u64);
        int("S_VISIBLE", u64::from(status::VISIBLE));
        int("S_INTERSECTIONS", u64::from(status::INTERSECTIONS));
        int("S_OVERFLOW", u64::from(status::OVERFLOW));
        int("S_NON_FINITE", u64::from(status::NON_FINITE));
        if self.layout_probe {
            int("LAYOUT_PROBE", 1);
        }
        let suffix = if is_double { "" } else { "f" };
        let mut real = |name: &str, v: f64| {
            let _ = writeln!(text, "#define {name} ({v:?}{suffix})");
        };
        real("ALPHA_MAX", constants::ALPHA_MAX);
        real("LOG2_ALPHA_MIN", self.alpha_min.log2());
        real("T_MIN", constants::T_MIN);
        real("SSIM_C1", constants::SSIM_C[0]);
        real("SSIM_C2", constants::SSIM_C[1]);
        real("FLIP_POWER", constants::FLIP_POWER);
        real("FLIP_KNEE_AT", constants::FLIP_KNEE[0]);
        real("FLIP_KNEE_TO", constants::FLIP_KNEE[1]);
        real("COLOR_MAX", constants::COLOR_MAX);
        real("BLUR", blur(self.anti_alias));
        real("FILTER_VARIANCE", constants::FILTER_VARIANCE);
        real("FILTER_MARGIN", constants::FILTER_MARGIN);
        real("TILE_SLACK", constants::TILE_SLACK);
        real("LOG_SCALE_MIN", constants::LOG_SCALE[0]);
        real("LOG_SCALE_MAX", constants::LOG_SCALE[1]);
        let window = ssim_window().map(|w| format!("{w:?}{suffix}"));
        let _ = writeln!(text, "#define SSIM_WINDOW {{{}}}", window.join(", "));
        let _ = writeln!(text, "#define KEY_CULLED {}u", tuning::KEY_CULLED);
        text
    }
}

/// The Gaussian window of SSIM, normalised.
fn ssim_window() -> [f64; constants::SSIM_TAPS] {
    let raw: [f64; constants::SSIM_TAPS] = std::array::from_fn(|k| {
        let d = (k as f64 - (constants::SSIM_TAPS / 2) as f64) / constants::SSIM_SIGMA;
        (-0.5 * d * d).exp()
    });
    let sum: f64 = raw.iter().sum();
    raw.map(|w| w / sum)
}
