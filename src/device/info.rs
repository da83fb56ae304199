//! Descriptions of the devices that there are.

use std::sync::{Mutex, PoisonError};

use ocl_core::{
    self as core, DeviceInfo as Query, DeviceInfoResult, DeviceType, PlatformInfo, Status,
};
use serde::{Deserialize, Serialize};

use crate::base::error::{Error, Result};
use crate::device::error::device_error;

/// Kind of a device, as OpenCL classes it, the preferred one first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DeviceKind {
    /// A GPU.
    Gpu,
    /// Any other accelerator.
    Accelerator,
    /// A CPU.
    Cpu,
}

/// Properties that a device reports.
#[derive(Debug, Clone, Serialize)]
pub struct DeviceInfo {
    /// Position in the list of all devices of all platforms.
    pub index: usize,
    /// Device name.
    pub name: String,
    /// Device vendor.
    pub vendor: String,
    /// Platform name.
    pub platform: String,
    /// Driver version.
    pub driver: String,
    /// CPU, GPU or accelerator.
    pub kind: DeviceKind,
    /// Compute units.
    pub compute_units: u32,
    /// Compute units that are taken: fewer of a CPU if the process may use fewer cores.
    pub cores: u32,
    /// True if double precision is available (`verify` needs it, training does not).
    pub fp64: bool,
    /// Preferred native vector width for f32.
    pub vector_width: u32,
    /// Size of the largest buffer, bytes.
    pub max_alloc: u64,
    /// Device memory, bytes.
    pub global_memory: u64,
    /// Local memory of a work-group, bytes.
    pub local_memory: u64,
    /// Work-items of the largest work-group.
    pub max_work_group: usize,
}

impl DeviceInfo {
    /// The compute units in words: how many, and of how many if not all are taken.
    #[must_use]
    pub fn units(&self) -> String {
        match (self.cores, self.compute_units) {
            (cores, all) if cores < all => format!("{cores} of {all} compute units"),
            (_, all) => format!("{all} compute units"),
        }
    }
}

/// Advice for a system without a device.
const INSTALL: &str = "install an OpenCL driver (on Debian/Ubuntu: `apt-get install ocl-icd-libopencl1 pocl-opencl-icd`) \
     or point OCL_ICD_VENDORS at one; `mhsplat doctor` says more";

/// Advice where there is a driver without a device.
const NO_DEVICE: &str = "`mhsplat doctor` says more; PoCL has none if it may not write its cache: set POCL_CACHE_DIR to a folder of \
     yours that can be written";

/// The device named by an index, a part of its name or platform, or a kind; `None` if nothing matches.
pub(super) fn select<'a>(list: &'a [DeviceInfo], selector: &str) -> Option<&'a DeviceInfo> {
    let s = selector.to_lowercase();
    let of_kind = |kind: DeviceKind| list.iter().find(|d| d.kind == kind);
    match s.as_str() {
        "cpu" => return of_kind(DeviceKind::Cpu),
        "gpu" => return of_kind(DeviceKind::Gpu),
        "accelerator" => return of_kind(DeviceKind::Accelerator),
        _ => {}
    }
    if let Ok(index) = s.parse::<usize>() {
        return list.get(index);
    }
    list.iter()
        .find(|d| d.name.to_lowercase().contains(&s) || d.platform.to_lowercase().contains(&s))
}

/// The devices, enumerated once: some drivers answer wrongly when several threads ask for the first time.
static DEVICES: Mutex<Vec<(DeviceInfo, core::DeviceId)>> = Mutex::new(Vec::new());

/// Every device of every platform, with its handle.
pub(super) fn enumerate() -> Result<Vec<(DeviceInfo, core::DeviceId)>> {
    let mut known = DEVICES.lock().unwrap_or_else(PoisonError::into_inner);
    if known.is_empty() {
        *known = ask_platforms()?;
    }
    Ok(known.clone())
}

/// True if the loader answers that there is no driver.
fn no_platform() -> bool {
    let mut platforms = 0;
    // SAFETY: no array is asked for, and the number is written to a variable that outlives the call.
    let answer =
        unsafe { core::ffi::clGetPlatformIDs(0, std::ptr::null_mut(), &raw mut platforms) };
    answer == Status::CL_PLATFORM_NOT_FOUND_KHR as i32
}

fn ask_platforms() -> Result<Vec<(DeviceInfo, core::DeviceId)>> {
    // The crate would ask again for ten seconds, against a race of threads that the lock rules out.
    if no_platform() {
        return Err(Error::device("OpenCL", "no driver found", INSTALL));
    }
    let platforms = core::get_platform_ids().map_err(|e| device_error("OpenCL", &e, INSTALL))?;
    let mut out = Vec::new();
    for platform in platforms {
        let name = core::get_platform_info(platform, PlatformInfo::Name)
            .map_or_else(|_| "unknown".into(), |v| v.to_string());
        // A platform without a device answers with an error, which is no error here.
        let devices =
            core::get_device_ids(platform, Some(DeviceType::ALL), None).unwrap_or_default();
        for id in devices {
            // A device that cannot say what it is must not keep the others from being used.
            if let Ok(info) = describe(out.len(), &name, id) {
                out.push((info, id));
            }
        }
    }
    if out.is_empty() {
        return Err(Error::device("OpenCL", "no device found", NO_DEVICE));
    }
    Ok(out)
}

fn describe(index: usize, platform: &str, id: core::DeviceId) -> Result<DeviceInfo> {
    let ask = |query: Query| {
        core::get_device_info(id, query)
            .map_err(|e| device_error("device query", &e, "select another with --device"))
    };
    let text = |query: Query| ask(query).map(|v| v.to_string());
    let kind = match ask(Query::Type)? {
        DeviceInfoResult::Type(t) if t.contains(DeviceType::GPU) => DeviceKind::Gpu,
        DeviceInfoResult::Type(t) if t.contains(DeviceType::CPU) => DeviceKind::Cpu,
        _ => DeviceKind::Accelerator,
    };
    let number = |query: Query| -> Result<u64> {
        Ok(match ask(query)? {
            DeviceInfoResult::MaxComputeUnits(v) | DeviceInfoResult::NativeVectorWidthFloat(v) => {
                u64::from(v)
            }
            DeviceInfoResult::MaxMemAllocSize(v)
            | DeviceInfoResult::GlobalMemSize(v)
            | DeviceInfoResult::LocalMemSize(v) => v,
            DeviceInfoResult::MaxWorkGroupSize(v) => v as u64,
            _ => 0,
        })
    };
    let compute_units = number(Query::MaxComputeUnits)? as u32;
    Ok(DeviceInfo {
        index,
        name: text(Query::Name)?.trim().to_owned(),
        vendor: text(Query::Vendor)?.trim().to_owned(),
        platform: platform.trim().to_owned(),
        driver: text(Query::DriverVersion)?.trim().to_owned(),
        kind,
        compute_units,
        cores: compute_units,
        fp64: text(Query::Extensions)?.contains("cl_khr_fp64"),
        vector_width: number(Query::NativeVectorWidthFloat)? as u32,
        max_alloc: number(Query::MaxMemAllocSize)?,
        global_memory: number(Query::GlobalMemSize)?,
        local_memory: number(Query::LocalMemSize)?,
        max_work_group: number(Query::MaxWorkGroupSize)? as usize,
    })
}
