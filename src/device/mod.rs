//! The only place that names `ocl`, and the only `unsafe`: devices, programs, typed arrays, launches.
#![allow(unsafe_code)]

mod array;
mod context;
mod launch;
pub mod layout;
mod program;
pub mod tuning;

pub use crate::device::array::{Array, PendingRead};
pub use crate::device::context::{Device, DeviceInfo, DeviceKind};
pub use crate::device::launch::{Kernel, Launch, StageTime};
pub use crate::device::layout::{CameraArg, EditRow, Element, Real, Record};
pub use crate::device::program::{Defines, Kernels, sources_hash};

use ocl::core::Status;

use crate::base::error::Error;

/// What to do where memory does not suffice.
const LOWER: &str = "free memory, lower --image-budget or, in a new run, --max-gaussians or --max-size, \
     or select a device with more memory";
/// What to do where nothing answers any more.
const LOST: &str =
    "the device may be lost; see the system's log, start again, or select another with --device";

/// An OpenCL error as the library's own, with what was being done and what to do about it: by the error where it says so
/// itself, else `fix`.
fn device_error(stage: &str, error: &ocl::core::Error, fix: &str) -> Error {
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
