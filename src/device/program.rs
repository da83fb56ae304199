//! Builds the embedded kernel sources for a device.

use std::ffi::CString;
use std::fmt::Write as _;
use std::hash::{Hash, Hasher};

use ocl::core::{self, ProgramBuildInfo, ProgramBuildInfoResult, ProgramBuildStatus};
use rustc_hash::FxHasher;

use crate::base::constants::blur;
use crate::base::error::{Error, Result};
use crate::capture::Alpha;
use crate::device::context::Device;
use crate::device::launch::Kernel;
use crate::device::layout::Real;
use crate::device::tuning::{Tuning, status};
use crate::device::{device_error, tuning};
use crate::scene::Plane;

const COMMON: &str = include_str!("../../kernels/common.clh");

/// Sources by stage.
const SOURCES: &[(&str, &str)] = &[
    ("project", include_str!("../../kernels/project.cl")),
    ("scan", include_str!("../../kernels/scan.cl")),
    ("bin", include_str!("../../kernels/bin.cl")),
    ("sort", include_str!("../../kernels/sort.cl")),
    ("splat", include_str!("../../kernels/splat.cl")),
    ("loss", include_str!("../../kernels/loss.cl")),
    ("exposure", include_str!("../../kernels/exposure.cl")),
    ("splat_grad", include_str!("../../kernels/splat_grad.cl")),
    (
        "project_grad",
        include_str!("../../kernels/project_grad.cl"),
    ),
    ("adam", include_str!("../../kernels/adam.cl")),
    ("noise", include_str!("../../kernels/noise.cl")),
    ("seen", include_str!("../../kernels/seen.cl")),
    ("screen_grad", include_str!("../../kernels/screen_grad.cl")),
    ("importance", include_str!("../../kernels/importance.cl")),
    ("filter", include_str!("../../kernels/filter.cl")),
    ("shrink", include_str!("../../kernels/shrink.cl")),
    ("metrics", include_str!("../../kernels/metrics.cl")),
    ("live", include_str!("../../kernels/live.cl")),
    ("edit", include_str!("../../kernels/edit.cl")),
    ("peak", include_str!("../../kernels/peak.cl")),
];

/// A number that changes when a kernel does.
#[must_use]
pub fn sources_hash() -> u64 {
    let mut hasher = FxHasher::default();
    (COMMON, SOURCES).hash(&mut hasher);
    hasher.finish()
}

/// What a program is specialised for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Defines {
    /// Sizes for the device.
    pub tuning: Tuning,
    /// Contributions below this alpha are dropped.
    pub alpha_min: f64,
    /// SH degree in use.
    pub sh_degree: u32,
    /// What the photos' alpha plane says.
    pub alpha: Alpha,
    /// Gaussians that cannot be seen are left alone by the VW, before most of the work is done.
    pub cull_chunks: bool,
    /// Where photos have alpha or masks: loss leaves out what is blank in render and photo.
    pub skip_blank: bool,
    /// Mip-Splatting's filters: project and project_grad take the 3D filter of each Gaussian.
    pub anti_alias: bool,
    /// Build the layout probe.
    pub layout_probe: bool,
}

impl Defines {
    /// The trainer's choice for a device.
    #[must_use]
    pub fn new(tuning: Tuning) -> Self {
        Self {
            tuning,
            alpha_min: crate::base::constants::ALPHA_MIN,
            sh_degree: 0,
            alpha: Alpha::None,
            cull_chunks: true,
            skip_blank: true,
            anti_alias: false,
            layout_probe: false,
        }
    }

    /// Planes of the photos that kernels built with these defines read: colour, and alpha if there is any.
    #[must_use]
    pub fn photo_planes(&self) -> usize {
        self.alpha.planes()
    }

    /// Whether the photos have masks.
    #[must_use]
    pub fn masked(&self) -> bool {
        self.alpha == Alpha::Mask
    }

    /// Whether loss is built to leave out what is blank.
    #[must_use]
    pub fn skips_blank(&self) -> bool {
        self.skip_blank && self.alpha != Alpha::None
    }

    fn prelude(&self, is_double: bool) -> String {
        let mut text = String::new();
        let mut int = |name: &str, v: u64| {
            let _ = writeln!(text, "#define {name} {v}");
        };
        int("REAL_IS_DOUBLE", u64::from(is_double));
        int("VW", u64::from(self.tuning.vector_width));
        int("BLOCK_W", u64::from(self.tuning.block_width));
        int("TILE", u64::from(crate::base::constants::TILE));
        int("GROUP_STYLE", u64::from(self.tuning.group_style));
        int("SUMS", crate::base::constants::SUMS as u64);
        int("STAGE", u64::from(crate::base::constants::STAGE));
        int("BATCH", self.tuning.batch() as u64);
        int("TAPS", crate::base::constants::SSIM_TAPS as u64);
        int("LOSS_ROWS", u64::from(crate::base::constants::LOSS_ROWS));
        int("SHRINK_RUN", u64::from(crate::base::constants::SHRINK_RUN));
        int("SKIP_BLANK", u64::from(self.skips_blank()));
        int("CULL_CHUNKS", u64::from(self.cull_chunks));
        int("ANTI_ALIAS", u64::from(self.anti_alias));
        int(
            "FILTER_CHUNKS",
            u64::from(crate::base::constants::FILTER_CHUNKS),
        );
        int("CHAINS", u64::from(crate::base::constants::PEAK_CHAINS));
        int("STRIP", u64::from(self.tuning.strip));
        int("SH_DEGREE", u64::from(self.sh_degree));
        int("HAS_ALPHA", u64::from(self.alpha == Alpha::Transparency));
        int("HAS_MASK", u64::from(self.masked()));
        int("P_POSITION", Plane::POSITION as u64);
        int("P_LOG_SCALE", Plane::LOG_SCALE as u64);
        int("P_ROTATION", Plane::ROTATION as u64);
        int("P_OPACITY", Plane::OPACITY as u64);
        int("P_SH", Plane::SH as u64);
        int("STATUS_SLOTS", status::SLOTS as u64);
        int("S_VISIBLE", u64::from(status::VISIBLE));
        int("S_PAIRS", u64::from(status::PAIRS));
        int("S_OVERFLOW", u64::from(status::OVERFLOW));
        int("S_NON_FINITE", u64::from(status::NON_FINITE));
        if self.layout_probe {
            int("LAYOUT_PROBE", 1);
        }
        let suffix = if is_double { "" } else { "f" };
        let mut real = |name: &str, v: f64| {
            let _ = writeln!(text, "#define {name} ({v:?}{suffix})");
        };
        real("ALPHA_MAX", crate::base::constants::ALPHA_MAX);
        real("LOG2_ALPHA_MIN", self.alpha_min.log2());
        real("T_MIN", crate::base::constants::T_MIN);
        real("SSIM_C1", crate::base::constants::SSIM_C[0]);
        real("SSIM_C2", crate::base::constants::SSIM_C[1]);
        real("COLOR_MAX", crate::base::constants::COLOR_MAX);
        real("BLUR", blur(self.anti_alias));
        real("FILTER_VARIANCE", crate::base::constants::FILTER_VARIANCE);
        real("FILTER_MARGIN", crate::base::constants::FILTER_MARGIN);
        real("TILE_SLACK", crate::base::constants::TILE_SLACK);
        real("LOG_SCALE_MIN", crate::base::constants::LOG_SCALE[0]);
        real("LOG_SCALE_MAX", crate::base::constants::LOG_SCALE[1]);
        let window = ssim_window().map(|w| format!("{w:?}{suffix}"));
        let _ = writeln!(text, "#define SSIM_WINDOW {{{}}}", window.join(", "));
        let _ = writeln!(text, "#define KEY_CULLED {}u", tuning::KEY_CULLED);
        text
    }
}

/// The Gaussian window of SSIM, normalised.
fn ssim_window() -> [f64; crate::base::constants::SSIM_TAPS] {
    let raw: [f64; crate::base::constants::SSIM_TAPS] = std::array::from_fn(|k| {
        let d = (k as f64 - (crate::base::constants::SSIM_TAPS / 2) as f64)
            / crate::base::constants::SSIM_SIGMA;
        (-0.5 * d * d).exp()
    });
    let sum: f64 = raw.iter().sum();
    raw.map(|w| w / sum)
}

/// Kernels of one set of defines, built on demand.
#[derive(Debug, Clone)]
pub struct Kernels {
    device: Device,
    defines: Defines,
}

impl Kernels {
    /// Nothing is built yet.
    #[must_use]
    pub fn new(device: &Device, defines: Defines) -> Self {
        Self {
            device: device.clone(),
            defines,
        }
    }

    /// The device.
    #[must_use]
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// What the kernels are specialised for.
    #[must_use]
    pub fn defines(&self) -> &Defines {
        &self.defines
    }

    /// Builds `kernels/<stage>.cl` and takes kernels out of it by name.
    ///
    /// # Errors
    /// A build failure, with the compiler's log.
    pub fn build<R: Real, const K: usize>(
        &self,
        stage: &'static str,
        names: [&'static str; K],
    ) -> Result<[Kernel; K]> {
        let source = SOURCES
            .iter()
            .find(|(s, _)| *s == stage)
            .map_or("", |(_, t)| t);
        let text = format!(
            "{}#line 1 \"common.clh\"\n{COMMON}\n#line 1 \"{stage}.cl\"\n{source}",
            self.defines.prelude(R::IS_DOUBLE)
        );
        let bug = "update the driver or select another device; the log above names the line";
        let bytes = CString::new(text)
            .map_err(|_| Error::device(stage, "the source holds a NUL byte", bug))?;
        let inner = &self.device.inner;
        let program = core::create_program_with_source(&inner.context, &[bytes])
            .map_err(|e| device_error(stage, &e, bug))?;
        let options = c"-cl-std=CL1.2 -cl-kernel-arg-info".to_owned();
        let built =
            core::build_program(&program, Some(&[inner.device_ptr()]), &options, None, None);
        // A build that fails without a log is no error to `ocl`.
        let status =
            core::get_program_build_info(&program, inner.id, ProgramBuildInfo::BuildStatus);
        let failed = match (built, status) {
            (Err(e), _) => Some(e.to_string()),
            (Ok(()), Ok(ProgramBuildInfoResult::BuildStatus(ProgramBuildStatus::Success))) => None,
            (Ok(()), Ok(status)) => Some(format!("{status}; it gives no reason")),
            (Ok(()), Err(e)) => Some(e.to_string()),
        };
        if let Some(e) = failed {
            let log = core::get_program_build_info(&program, inner.id, ProgramBuildInfo::BuildLog)
                .map_or_else(|_| e.clone(), |l| l.to_string());
            let log = if log.trim().is_empty() { e } else { log };
            return Err(Error::device(
                format!("build {stage}.cl"),
                format!("the device's compiler says:\n{}", log.trim()),
                bug,
            ));
        }
        let mut built = Vec::with_capacity(K);
        for name in names {
            built.push(Kernel::new(&self.device, &program, stage, name)?);
        }
        built
            .try_into()
            .map_err(|_| Error::device(stage, "kernels missing", bug))
    }
}
