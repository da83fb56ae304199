//! The only room that names OpenCL, and the only one with `unsafe`: devices, programs, typed arrays, launches.
#![allow(unsafe_code)]

mod array;
mod compiled;
mod context;
mod defines;
mod error;
mod info;
mod launch;
pub mod layout;
pub mod libraries;
mod part;
mod program;
mod queues;
mod read;
mod seat;
mod section;
mod staging;
pub mod tuning;

pub use crate::device::array::Array;
pub use crate::device::context::{Device, Helpers, StageTime, StageTimes};
pub use crate::device::defines::Defines;
pub use crate::device::info::{DeviceInfo, DeviceKind};
pub use crate::device::launch::{Launch, Program};
pub use crate::device::layout::{CameraArg, Element, ImageSize, PhotoScale, Projected, Real};
pub use crate::device::program::{Kernels, source, sources_hash, stages};
pub use crate::device::read::{Arrived, PendingRead};
pub use crate::device::section::{Section, read_sections, write_sections};
