//! The only place that names `ocl`, and the only `unsafe`: devices, programs, typed arrays, launches.
#![allow(unsafe_code)]

mod array;
mod device;
mod launch;
pub mod layout;
mod program;
pub mod tuning;

pub use array::{Array, PendingRead};
pub use device::{Device, DeviceInfo, DeviceKind};
pub use launch::{Kernel, Launch, StageTime};
pub use layout::{CameraArg, EditRow, Element, Real, Record};
pub use program::{Defines, Kernels, sources_hash};

use crate::error::Error;

/// An OpenCL error as the library's own, with what was being done and what to lower.
fn device_error(stage: &str, error: &ocl::core::Error, fix: &str) -> Error {
    let text = error.to_string();
    let said: Vec<&str> = text
        .lines()
        .map(str::trim)
        .filter(|l| !l.is_empty() && !l.starts_with('#') && !l.contains("http"))
        .collect();
    let first = if said.is_empty() {
        text.clone()
    } else {
        said.join(" ")
    };
    Error::device(stage, first, fix)
}
