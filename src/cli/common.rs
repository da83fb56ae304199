//! Options, outcomes and devices that the commands share.

use mhsplat::base::error::Result;
use mhsplat::device::Device;
use mhsplat::lab::selftest::self_test;
use mhsplat::lab::tune::{self, SizeClass};

use crate::cli::output;

/// Options of every command.
pub struct Common {
    /// JSON on stdout.
    pub json: bool,
}

/// Option of the commands that use a device.
#[derive(clap::Args)]
pub struct DeviceOption {
    /// OpenCL device: index, part of its name, or cpu, gpu, accelerator (also MHSPLAT_DEVICE).
    #[arg(long, value_name = "SEL", display_order = 901)]
    device: Option<String>,
}

impl DeviceOption {
    /// Selector of the option, else of the variable; `None` for the default device.
    pub fn selector(&self) -> Option<String> {
        let variable = || std::env::var("MHSPLAT_DEVICE").ok();
        let asked = self.device.clone().or_else(variable);
        asked.filter(|selector| !selector.is_empty())
    }
}

/// Result of a command that ran to its end.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// Everything asked for.
    Done,
    /// It ran, but missed a bar that was asked for.
    Missed,
}

impl Outcome {
    /// [`Outcome::Missed`] if a bar is set and `psnr` does not reach it.
    pub fn of(bar: Option<f64>, psnr: Option<f64>) -> Self {
        match bar {
            Some(bar) if !psnr.is_some_and(|p| p >= bar) => Self::Missed,
            _ => Self::Done,
        }
    }
}

/// Opens a device with the tuning that suits it with small scenes, to measure or check it.
pub fn open_device(selector: Option<&str>) -> Result<Device> {
    tune::tuned(Device::open(selector)?, SizeClass::Small, &mut output::note)
}

/// Opens a device that passes the self-test, with the tuning for small scenes.
pub fn open_tested(selector: Option<&str>) -> Result<Device> {
    tested(Device::open(selector)?, SizeClass::Small)
}

/// The device with the tuning for scenes of a size, in which it passes the self-test.
pub fn tested(device: Device, size: SizeClass) -> Result<Device> {
    self_tested(tune::tuned(device, size, &mut output::note)?)
}

/// The device, if it passes the self-test with the tuning that it has.
pub fn self_tested(device: Device) -> Result<Device> {
    self_test(&device)?;
    Ok(device)
}
