//! Builds the embedded kernel sources for a device.

use std::collections::BTreeSet;
use std::ffi::CString;
use std::fmt::Write as _;
use std::hash::{Hash, Hasher};
use std::sync::PoisonError;

use ocl_core::{
    self as core, ProgramBuildInfo, ProgramBuildInfoResult, ProgramBuildStatus, ProgramInfo,
};
use rustc_hash::FxHasher;

use crate::base::error::{Error, Result};
use crate::device::compiled::Built;
use crate::device::context::{Device, Inner};
use crate::device::defines::Defines;
use crate::device::error::device_error;
use crate::device::launch::{Kernel, Program};
use crate::device::layout::Real;
use crate::device::seat::Seat;

/// Headers by name; the first is a part of every stage, the others are where a stage or a header includes them.
const HEADERS: &[(&str, &str)] = &[
    ("common.clh", include_str!("../../kernels/common.clh")),
    ("ahead.clh", include_str!("../../kernels/ahead.clh")),
    ("lanes.clh", include_str!("../../kernels/lanes.clh")),
    ("chunks.clh", include_str!("../../kernels/chunks.clh")),
    ("gaussians.clh", include_str!("../../kernels/gaussians.clh")),
    (
        "projection.clh",
        include_str!("../../kernels/projection.clh"),
    ),
    ("pixels.clh", include_str!("../../kernels/pixels.clh")),
    ("adam.clh", include_str!("../../kernels/adam.clh")),
];

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
    let text = with_headers(stage);
    used(&text, defines, is_double) + &text
}

/// A stage's kernels after the headers that they need.
fn with_headers(stage: &str) -> String {
    let own = SOURCES.iter().find(|(name, _)| *name == stage);
    let (mut text, mut included) = (String::new(), BTreeSet::new());
    include(HEADERS[0].0, HEADERS[0].1, &mut included, &mut text);
    let own = own.map_or("", |(_, text)| text);
    include(&format!("{stage}.cl"), own, &mut included, &mut text);
    text
}

/// Adds a file to `text`, with headers in the places where they are included for the first time.
fn include(
    name: &str,
    file: &'static str,
    included: &mut BTreeSet<&'static str>,
    text: &mut String,
) {
    let begin = |line: usize, text: &mut String| {
        let _ = writeln!(text, "#line {line} \"{name}\"");
    };
    begin(1, text);
    for (number, line) in file.lines().enumerate() {
        let header = line.strip_prefix("#include \"");
        match header.and_then(|rest| HEADERS.iter().find(|(name, _)| rest == format!("{name}\""))) {
            Some((header, content)) => {
                if included.insert(header) {
                    include(header, content, included, text);
                }
                begin(number + 2, text);
            }
            None => {
                text.push_str(line);
                text.push('\n');
            }
        }
    }
}

/// The `#define`s that a text uses: without the others a kernel stays what it is when something else changes, and drivers keep what
/// they have compiled. Their names are never pasted together, and stand behind no `//` of a string.
fn used(text: &str, defines: &Defines, is_double: bool) -> String {
    let code = text.lines().filter_map(|line| line.split("//").next());
    let apart = |c: char| !(c.is_ascii_alphanumeric() || c == '_');
    let words: BTreeSet<&str> = code.flat_map(|code| code.split(apart)).collect();
    let used = |line: &&str| {
        line.split(' ')
            .nth(1)
            .is_some_and(|name| words.contains(name))
    };
    let prelude = defines.prelude(is_double);
    prelude.split_inclusive('\n').filter(used).collect()
}

/// Options of every build. Without warnings: PoCL would tell on stderr how many there were, on processors without AVX-512 dozens about vectors
/// of 16 lanes.
const OPTIONS: &str = "-cl-std=CL1.2 -cl-kernel-arg-info -w";

/// Hash of the sources of all kernels and of the options of their builds.
#[must_use]
pub fn sources_hash() -> u64 {
    let mut hasher = FxHasher::default();
    (HEADERS, SOURCES, OPTIONS).hash(&mut hasher);
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

    /// Builds `kernels/<stage>.cl`, unless that has been done in its context already: each [`Program`] has kernels of its own.
    ///
    /// # Errors
    /// A build failure, with the compiler's log.
    pub fn build<R: Real>(&self, stage: &'static str) -> Result<Program> {
        let inner = &self.device.inner;
        let text = source(stage, &self.defines, R::IS_DOUBLE);
        let built = || {
            inner
                .compiled
                .programs
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
        };
        let found = built().get(&text).map(|built| built.program.clone());
        let program = match found {
            Some(program) => program,
            None => {
                let own = compile(inner, stage, &text)?;
                // Another thread may have been faster: then the number of this one is free again, and nobody is to have its program.
                built().entry(text).or_insert(own).program.clone()
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
fn compile(inner: &Inner, stage: &'static str, text: &str) -> Result<Built> {
    let bytes = CString::new(text)
        .map_err(|_| Error::device(stage, "the source holds a NUL byte", COMPILER))?;
    let program = core::create_program_with_source(&inner.compiled.context, &[bytes])
        .map_err(|e| device_error(stage, &e, COMPILER))?;
    let seat = Seat::of(&inner.info, text);
    let apart = seat.as_ref().map(Seat::options).unwrap_or_default();
    let options = format!("{OPTIONS}{apart}");
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
        return Ok(Built {
            program,
            _seat: seat,
        });
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

#[cfg(test)]
mod tests {
    use super::{HEADERS, SOURCES, source, stages, with_headers};
    use crate::device::defines::Defines;
    use crate::device::tuning::Tuning;

    /// Settings that differ from run to run, or change within one, compile few stages anew.
    #[test]
    fn stages_depend_on_the_symbols_that_they_use_alone() {
        let plain = Defines::new(Tuning::CPU);
        let other = |defines: Defines| -> Vec<&str> {
            let differs = |s: &&str| source(s, &plain, false) != source(s, &defines, false);
            stages().filter(differs).collect()
        };
        let sh_degree = Defines {
            sh_degree: 3,
            ..plain
        };
        assert_eq!(other(sh_degree), ["project", "project_grad"]);
        let anti_alias = Defines {
            anti_alias: true,
            ..plain
        };
        assert_eq!(other(anti_alias), ["project", "project_grad"]);
        let lanes = Defines::new(Tuning {
            vector_width: 4,
            ..plain.tuning
        });
        let unlike = other(lanes);
        assert!(unlike.contains(&"splat"), "{unlike:?}");
        for alike in ["scan", "sort", "bin", "route", "edit", "morton", "metrics"] {
            assert!(!unlike.contains(&alike), "{alike}");
        }
    }

    #[test]
    fn headers_come_once() {
        for (stage, own) in SOURCES {
            let text = with_headers(stage);
            assert!(!text.contains("#include"), "{stage}: no such header");
            let places: Vec<Vec<usize>> = HEADERS
                .iter()
                .map(|(name, _)| format!("#line 1 \"{name}\""))
                .map(|begin| text.match_indices(&begin).map(|found| found.0).collect())
                .collect();
            assert_eq!(places[0], [0], "{stage}");
            assert!(places.iter().all(|found| found.len() < 2), "{stage}");
            let included = HEADERS.iter().zip(&places).filter(|h| own.contains(h.0.0));
            for ((name, _), found) in included {
                assert_eq!(found.len(), 1, "{stage}: {name}");
            }
            // A message of the compiler names the line in its file.
            let last = own.lines().last().unwrap_or_default();
            let begun = text.rfind("#line ").unwrap();
            let (line, rest) = text[begun + 6..]
                .split_once(&format!(" \"{stage}.cl\"\n"))
                .unwrap();
            let number = line.parse::<usize>().unwrap() + rest.lines().count() - 1;
            assert_eq!(
                (number, rest.lines().last().unwrap()),
                (own.lines().count(), last)
            );
        }
    }
}
