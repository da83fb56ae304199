//! Builds the embedded kernel sources for a device.

use std::ffi::CString;
use std::hash::{Hash, Hasher};
use std::sync::PoisonError;

use ocl_core::{
    self as core, ProgramBuildInfo, ProgramBuildInfoResult, ProgramBuildStatus, ProgramInfo,
};
use rustc_hash::FxHasher;

use crate::base::error::{Error, Result};
use crate::device::context::{Device, Inner};
use crate::device::defines::Defines;
use crate::device::error::device_error;
use crate::device::launch::{Kernel, Program};
use crate::device::layout::Real;
use crate::device::seat::Seat;

const COMMON: &str = include_str!("../../kernels/common.clh");

/// Sources by stage.
const SOURCES: &[(&str, &str)] = &[
    ("project", include_str!("../../kernels/project.cl")),
    ("scan", include_str!("../../kernels/scan.cl")),
    ("bin", include_str!("../../kernels/bin.cl")),
    ("sort", include_str!("../../kernels/sort.cl")),
    ("route", include_str!("../../kernels/route.cl")),
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
    ("photo_error", include_str!("../../kernels/photo_error.cl")),
    ("filter", include_str!("../../kernels/filter.cl")),
    ("shrink", include_str!("../../kernels/shrink.cl")),
    ("metrics", include_str!("../../kernels/metrics.cl")),
    ("flip", include_str!("../../kernels/flip.cl")),
    (
        "active_tiles",
        include_str!("../../kernels/active_tiles.cl"),
    ),
    ("edit", include_str!("../../kernels/edit.cl")),
    ("morton", include_str!("../../kernels/morton.cl")),
    ("peak", include_str!("../../kernels/peak.cl")),
];

/// Names of the stages, in the order of an iteration as far as they are part of one.
pub fn stages() -> impl Iterator<Item = &'static str> {
    SOURCES.iter().map(|(stage, _)| *stage)
}

/// The text of a stage's kernels that drivers compile, in double or in single precision; an unknown stage has none of its own.
#[must_use]
pub fn source(stage: &str, defines: &Defines, is_double: bool) -> String {
    let (prelude, own) = (used(stage, defines, is_double), own_source(stage));
    format!("{prelude}#line 1 \"common.clh\"\n{COMMON}\n#line 1 \"{stage}.cl\"\n{own}")
}

fn own_source(stage: &str) -> &'static str {
    let own = SOURCES.iter().find(|(name, _)| *name == stage);
    own.map_or("", |(_, text)| text)
}

/// The `#define`s of a stage that it uses: without the others a kernel stays what it is when something else changes, and drivers keep what
/// they have compiled.
fn used(stage: &str, defines: &Defines, is_double: bool) -> String {
    let own = own_source(stage);
    let used = |line: &&str| {
        let name = line.split(' ').nth(1).unwrap_or_default();
        COMMON.contains(name) || own.contains(name)
    };
    let prelude = defines.prelude(is_double);
    prelude.split_inclusive('\n').filter(used).collect()
}

/// Hash of the sources of all kernels.
#[must_use]
pub fn sources_hash() -> u64 {
    let mut hasher = FxHasher::default();
    (COMMON, SOURCES).hash(&mut hasher);
    hasher.finish()
}

/// Kernels of one set of defines, built on demand.
#[derive(Debug, Clone)]
pub struct Kernels {
    device: Device,
    defines: Defines,
}

impl Kernels {
    /// Kernels of which none is built yet.
    #[must_use]
    pub fn new(device: &Device, defines: Defines) -> Self {
        Self {
            device: device.clone(),
            defines,
        }
    }

    /// The same for another SH degree.
    #[must_use]
    pub fn of_degree(&self, sh_degree: u32) -> Self {
        let mut kernels = self.clone();
        kernels.defines.sh_degree = sh_degree;
        kernels
    }

    /// The same with project_grad taking a step of the optimiser.
    #[must_use]
    pub fn taking_steps(&self) -> Self {
        let mut kernels = self.clone();
        kernels.defines.take_step = true;
        kernels
    }

    /// The device.
    #[must_use]
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Choices that the kernels are compiled with.
    #[must_use]
    pub fn defines(&self) -> &Defines {
        &self.defines
    }

    /// Builds `kernels/<stage>.cl`, unless this device has done so already: each [`Program`] has kernels of its own.
    ///
    /// # Errors
    /// A build failure, with the compiler's log.
    pub fn build<R: Real>(&self, stage: &'static str) -> Result<Program> {
        let inner = &self.device.inner;
        let of = (stage, used(stage, &self.defines, R::IS_DOUBLE));
        let built = || {
            inner
                .programs
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
        };
        let found = built().get(&of).cloned();
        let program = match found {
            Some(program) => program,
            None => {
                let text = source(stage, &self.defines, R::IS_DOUBLE);
                let program = compile(inner, stage, &text)?;
                built().insert(of, program.clone());
                program
            }
        };
        let names = core::get_program_info(&program, ProgramInfo::KernelNames)
            .map_err(|e| device_error(stage, &e, COMPILER))?
            .to_string();
        let names = names.trim_end_matches('\0').split(';');
        Ok(Program {
            device: inner.clone(),
            defines: self.defines,
            stage,
            kernels: names
                .map(|name| Kernel::new(inner, &program, name.trim()))
                .collect::<Result<_>>()?,
        })
    }
}

/// Advice where a kernel cannot be built.
const COMPILER: &str = "if the log names no line, memory may have run out for the compiler (ulimit -v, a container's limit): allow more; \
                   else update the driver or select another device";

/// The driver's build of a source.
fn compile(inner: &Inner, stage: &'static str, text: &str) -> Result<core::Program> {
    let bytes = CString::new(text)
        .map_err(|_| Error::device(stage, "the source holds a NUL byte", COMPILER))?;
    let program = core::create_program_with_source(&inner.context, &[bytes])
        .map_err(|e| device_error(stage, &e, COMPILER))?;
    let apart = inner.seat.as_ref().map(Seat::options).unwrap_or_default();
    let options = format!("-cl-std=CL1.2 -cl-kernel-arg-info{apart}");
    let options = CString::new(options)
        .map_err(|_| Error::device(stage, "the options hold a NUL byte", COMPILER))?;
    let built = core::build_program(&program, Some(&[inner.id]), &options, None, None);
    // A build that fails without a log is no error to `ocl_core`.
    let status = core::get_program_build_info(&program, inner.id, ProgramBuildInfo::BuildStatus);
    let failed = match (built, status) {
        (Err(e), _) => Some(e.to_string()),
        (Ok(()), Ok(ProgramBuildInfoResult::BuildStatus(ProgramBuildStatus::Success))) => None,
        (Ok(()), Ok(status)) => Some(format!("{status}; it gives no reason")),
        (Ok(()), Err(e)) => Some(e.to_string()),
    };
    let Some(e) = failed else {
        return Ok(program);
    };
    let log = core::get_program_build_info(&program, inner.id, ProgramBuildInfo::BuildLog)
        .map_or_else(|_| e.clone(), |l| l.to_string());
    let log = if log.trim().is_empty() { e } else { log };
    Err(Error::device(
        format!("build {stage}.cl"),
        format!("the device's compiler says:\n{}", log.trim()),
        COMPILER,
    ))
}
