//! OpenCL errors as the library's own.

use ocl_core::Status;

use crate::base::error::Error;

/// Advice for too little memory.
pub(super) const LOWER: &str = "free memory, lower --image-budget or, in a new run, --max-gaussians or --max-size, \
     or select a device with more memory";
/// Advice for a device that no longer answers.
pub(super) const LOST: &str =
    "the device may be lost; see the system's log, start again, or select another with --device";
/// Advice for a call that the library should not have made.
pub(super) const BUG: &str = "this is a bug; please report it";

/// The error of the library for an OpenCL error in `stage`. The advice is that of the status where it has one, else `fix`.
pub(super) fn device_error(stage: &str, error: &ocl_core::Error, fix: &str) -> Error {
    let text = error.to_string();
    let said: Vec<&str> = text
        .lines()
        .map(str::trim)
        .filter(|l| !l.is_empty() && !l.starts_with('#'))
        .filter(|l| !l.contains("http") && !l.starts_with("Please visit"))
        .collect();
    let first = if said.is_empty() {
        text.clone()
    } else {
        said.join(" ")
    };
    let fix = match error.api_status() {
        Some(Status::CL_DEVICE_NOT_AVAILABLE) => LOST,
        Some(Status::CL_OUT_OF_HOST_MEMORY | Status::CL_MEM_OBJECT_ALLOCATION_FAILURE) => LOWER,
        _ => fix,
    };
    Error::device(stage, first, fix)
}
