//! [`Part`]: some of the compute units of a device, as a device of its own.

use std::iter::{once, repeat_n};
use std::mem::size_of;

use ocl_core::{self as core, DeviceInfo as Query, ffi};

use crate::base::cores::Cores;
use crate::base::error::{Error, Result};
use crate::device::info::{DeviceInfo, DeviceKind};

/// Advice for a number of cores that a driver does not give.
const FIX: &str = "leave --threads out, or set the driver's own variable to the same number \
                   (POCL_MAX_PTHREAD_COUNT for PoCL)";

/// A sub-device, released with this.
#[derive(Debug)]
pub(super) struct Part {
    pub id: core::DeviceId,
    /// Compute units that it has.
    pub units: u32,
}

impl Part {
    /// The part of a CPU that has so many compute units as there are cores to take; `None` for the whole device: that has no more, or
    /// is no CPU, or its driver divides none.
    ///
    /// # Errors
    /// A number that was asked for and cannot be had.
    pub fn of(info: &DeviceInfo, whole: core::DeviceId, cores: Cores) -> Result<Option<Self>> {
        let (all, count) = (info.compute_units, cores.count());
        if info.kind != DeviceKind::Cpu || count == all as usize {
            return Ok(None);
        }
        let made = match u32::try_from(count) {
            Ok(units) if units < all => Self::create(whole, units, 1),
            _ => Err(format!("has {all} compute units")),
        };
        match made {
            Ok(mut parts) => Ok(parts.pop()),
            Err(_) if !cores.is_asked() => Ok(None),
            Err(why) => {
                let what = format!("{count}; {} {why}", info.name);
                Err(Error::device("--threads", what, FIX))
            }
        }
    }

    /// So many parts of a device that share the cores evenly.
    ///
    /// # Errors
    /// Fewer cores than parts, or a driver that cannot divide the device.
    pub fn even(
        info: &DeviceInfo,
        whole: core::DeviceId,
        cores: Cores,
        parts: usize,
    ) -> Result<Vec<Self>> {
        let all = cores.count().min(info.compute_units as usize);
        let refused = |why: String| {
            let what = format!("{parts} parts of {}, which {why}", info.name);
            Error::device(
                "--device",
                what,
                "ask for fewer parts, or for whole devices",
            )
        };
        match all.checked_div(parts) {
            Some(units @ 1..) => Self::create(whole, units as u32, parts).map_err(refused),
            _ => Err(refused(format!("has {all} compute units to share"))),
        }
    }

    /// Divides a device into parts of so many compute units; an error tells what it lacks.
    fn create(
        whole: core::DeviceId,
        units: u32,
        parts: usize,
    ) -> std::result::Result<Vec<Self>, String> {
        const ASKED: isize = ffi::CL_DEVICE_PARTITION_BY_COUNTS as isize;
        // A driver of OpenCL 1.1 need not know the call.
        let offers = core::get_device_info_raw(whole, Query::PartitionProperties as u32);
        let offered = offers.unwrap_or_default();
        let mut offered = offered.chunks_exact(size_of::<isize>());
        if !offered.any(|one| one == ASKED.to_ne_bytes()) {
            return Err("has a driver that cannot divide it".to_owned());
        }
        let counts = repeat_n(units as isize, parts);
        let properties: Vec<isize> = once(ASKED).chain(counts).chain([0, 0]).collect();
        let mut ids = vec![std::ptr::null_mut(); parts];
        // SAFETY: the properties end with 0, and there is room for the devices that they describe.
        let answer = unsafe {
            ffi::clCreateSubDevices(
                whole.as_raw(),
                properties.as_ptr(),
                parts as u32,
                ids.as_mut_ptr(),
                std::ptr::null_mut(),
            )
        };
        if answer != ffi::CL_SUCCESS || ids.iter().any(|id| id.is_null()) {
            return Err(format!(
                "has a driver that does not divide it (error {answer})"
            ));
        }
        let part = |id| {
            // SAFETY: the driver has just made it.
            let id = unsafe { core::DeviceId::from_raw(id) };
            Self { id, units }
        };
        Ok(ids.into_iter().map(part).collect())
    }
}

impl Drop for Part {
    fn drop(&mut self) {
        // SAFETY: the device was made by this, is released once, and contexts and queues of it keep it alive as long as they need it.
        unsafe { ffi::clReleaseDevice(self.id.as_raw()) };
    }
}
