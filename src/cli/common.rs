//! Options, outcomes and devices that the commands share.

use mhsplat::base::cores::Cores;
use mhsplat::base::error::Result;
use mhsplat::device::{Device, Helpers};
use mhsplat::lab::selftest::self_test;
use mhsplat::lab::tune::{self, SizeClass};

use crate::cli::output;

/// Options of every command.
pub struct Common {
    /// JSON on stdout.
    pub json: bool,
}

/// Options of the commands that use a device.
#[derive(clap::Args)]
pub struct DeviceOption {
    /// OpenCL device: index, part of its name, or cpu, gpu, accelerator, or local-rank, of those like the default one in turn by this process's
    /// number on its node, as several processes take them unless told otherwise (also MHSPLAT_DEVICE); train takes several, such as 0,1, or parts of a CPU, such as cpu/2.
    #[arg(long, value_name = "SEL", display_order = 901)]
    device: Option<String>,
    /// Cores that are taken, by a device that is a CPU and beside it (default: those that the process may use).
    #[arg(long, value_name = "N", display_order = 902)]
    threads: Option<usize>,
}

impl DeviceOption {
    /// Selector of the option, else of the variable; `None` for the default device.
    pub fn selector(&self) -> Option<String> {
        let variable = || std::env::var("MHSPLAT_DEVICE").ok();
        let asked = self.device.clone().or_else(variable);
        asked.filter(|selector| !selector.is_empty())
    }

    /// Number of cores that was asked for.
    pub fn threads(&self) -> Option<usize> {
        self.threads
    }

    /// Opens the device.
    pub fn open(&self) -> Result<Device> {
        self.open_other(self.selector().as_deref())
    }

    /// Opens the device of one of several processes, without a selector that of its number on its node.
    pub fn open_own(&self) -> Result<Device> {
        let selector = self.selector();
        self.open_other(selector.as_deref().or(Some("local-rank")))
    }

    /// Opens the device, or the several that the selector names.
    pub fn open_all(&self) -> Result<Device> {
        Device::open_all(self.selector().as_deref(), Cores::new(self.threads)?)
    }

    /// Opens the devices of a list that is not the option's.
    pub fn open_list(&self, list: &str) -> Result<Device> {
        Device::open_all(Some(list), Cores::new(self.threads)?)
    }

    /// Opens another device than the selector's, with the same number of cores.
    fn open_other(&self, selector: Option<&str>) -> Result<Device> {
        Device::open_on(selector, Cores::new(self.threads)?)
    }

    /// Opens a device with the tuning that suits it with small scenes, to measure or check it; `selector` goes before the option's.
    pub fn open_tuned(&self, selector: Option<&str>) -> Result<Device> {
        let device = self.open_other(selector)?;
        tune::tuned(device, SizeClass::Small, &mut output::note)
    }

    /// Opens the device, which passes the self-test, with the tuning for small scenes.
    pub fn open_tested(&self) -> Result<Device> {
        tested(self.open()?, SizeClass::Small)
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
            Some(bar) if !psnr.is_some_and(|p| p >= bar) => {
                let had = psnr.map_or("no held-out view".to_owned(), |p| format!("{p:.2} dB"));
                output::note(&format!("--require-psnr {bar}: missed ({had})"));
                Self::Missed
            }
            _ => Self::Done,
        }
    }
}

/// The device with the tuning for scenes of a size, in which it passes the self-test.
pub fn tested(device: Device, size: SizeClass) -> Result<Device> {
    self_tested(tune::tuned(device, size, &mut output::note)?)
}

/// The device, if it passes the self-test with the tuning that it has, as the devices must that help it, with that tuning.
pub fn self_tested(device: Device) -> Result<Device> {
    self_test(&device)?;
    if let Helpers::Devices(others) = device.helpers() {
        let tuning = device.tuning();
        // One that cannot have these kernels is refused with that reason when training begins.
        let able = others.iter().filter(|d| tuning.fault(d.info()).is_none());
        for other in able {
            self_test(&other.clone().with_tuning(tuning))?;
        }
    }
    Ok(device)
}
