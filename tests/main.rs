//! The one integration test binary.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout
)]

mod antialias;
mod arrays;
mod background;
mod bands;
mod batches;
mod bench;
mod budget;
mod cells;
mod clearance;
mod cli;
mod compare;
mod dataset;
mod density;
mod determinism;
mod estimates;
mod experiment;
mod export;
mod exposure;
mod extreme;
#[cfg(target_os = "linux")]
mod faults;
mod flip;
mod formats;
mod fuzz;
mod gpu_report;
mod gpu_tables;
mod gradient;
mod growth;
mod hostile;
mod house;
mod inputs;
mod lag;
mod launches;
mod layout;
mod learning;
mod library;
mod live;
mod masks;
mod needed;
#[cfg(target_os = "linux")]
mod packaging;
mod photos;
mod plan;
mod python;
mod queues;
mod ranks;
mod recovery;
mod reference;
mod report;
mod samplers;
mod sampling_rates;
mod seeds;
mod stage;
mod stiff;
mod stress;
mod surrogate;
mod sweep;
mod synth;
mod terminal;
#[cfg(target_os = "linux")]
mod threads;
mod timing;
mod tiny;
mod trace;
mod tune;
mod viewer;
mod wiring;

use std::sync::LazyLock;

use mhsplat::Device;

/// The device of tests that look at kernels: one for all of them, so that no kernel is built twice. Its times say nothing, because several
/// tests use it at once; who trains, or reads what a device counts, opens one of its own.
fn device() -> Device {
    static DEVICE: LazyLock<Device> = LazyLock::new(|| Device::open(None).unwrap());
    DEVICE.clone()
}
