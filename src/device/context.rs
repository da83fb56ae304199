//! Platforms and devices: listing, choosing, opening.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use ocl::core::{
    self, ClDeviceIdPtr, CommandQueueProperties, DeviceInfo as Query, DeviceInfoResult, DeviceType,
    PlatformInfo,
};
use serde::Serialize;

use crate::base::error::{Error, Result};
use crate::device::launch::{Pending, StageTime};
use crate::device::tuning::Tuning;
use crate::device::{LOST, device_error};

/// Kind of a device, as OpenCL classes it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum DeviceKind {
    /// A CPU.
    Cpu,
    /// A GPU.
    Gpu,
    /// Any other accelerator.
    Accelerator,
}

/// What a device says of itself.
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
    /// Whether double precision is available (verify needs it, training does not).
    pub fp64: bool,
    /// Preferred native vector width for f32.
    pub vector_width: u32,
    /// Largest buffer, bytes.
    pub max_alloc: u64,
    /// Device memory, bytes.
    pub global_memory: u64,
    /// Largest work-group.
    pub max_work_group: usize,
}

/// An open device with one in-order queue. Cheap to clone.
#[derive(Clone, Debug)]
pub struct Device {
    pub(super) inner: Arc<Inner>,
    tuning: Tuning,
}

#[derive(Debug)]
pub(super) struct Inner {
    pub info: DeviceInfo,
    pub id: core::DeviceId,
    pub context: core::Context,
    pub queue: core::CommandQueue,
    pub pending: Mutex<Vec<Pending>>,
    pub times: Mutex<BTreeMap<&'static str, StageTime>>,
    /// Bytes of the buffers that are alive.
    pub allocated: AtomicU64,
}

const INSTALL: &str = "install an OpenCL driver (on Debian/Ubuntu: `apt-get install ocl-icd-libopencl1 pocl-opencl-icd`) \
     or point OCL_ICD_VENDORS at one";

impl Device {
    /// Every device of every platform.
    ///
    /// # Errors
    /// No OpenCL loader, platform or device.
    pub fn list() -> Result<Vec<DeviceInfo>> {
        Ok(enumerate()?.into_iter().map(|(info, _)| info).collect())
    }

    /// The device that [`Device::open`] takes without a selector: the first GPU, then accelerator, then CPU.
    #[must_use]
    pub fn default_of(list: &[DeviceInfo]) -> Option<&DeviceInfo> {
        let rank = |d: &DeviceInfo| match d.kind {
            DeviceKind::Gpu => 0,
            DeviceKind::Accelerator => 1,
            DeviceKind::Cpu => 2,
        };
        list.iter().min_by_key(|d| (rank(d), d.index))
    }

    /// Opens the device named by an index, a part of its name or platform, or a type (cpu, gpu, accelerator).
    ///
    /// # Errors
    /// No device, or none that matches.
    pub fn open(selector: Option<&str>) -> Result<Self> {
        let all = enumerate()?;
        let infos: Vec<DeviceInfo> = all.iter().map(|(i, _)| i.clone()).collect();
        let index = match selector {
            None => Self::default_of(&infos).map(|d| d.index),
            Some(s) => select(&infos, s),
        };
        let Some(index) = index else {
            return Err(Error::device(
                "device",
                format!("no device matches {:?}", selector.unwrap_or("")),
                "`mhsplat devices` lists what can be selected",
            ));
        };
        let Some((info, id)) = all.into_iter().nth(index) else {
            return Err(Error::device(
                "device",
                "the list of devices changed",
                INSTALL,
            ));
        };
        let fail = |e: core::Error| device_error("open device", &e, "select another with --device");
        let context = core::create_context(None, &[id], None, None).map_err(fail)?;
        let queue = core::create_command_queue(
            &context,
            id,
            Some(CommandQueueProperties::PROFILING_ENABLE),
        )
        .map_err(fail)?;
        Ok(Self {
            tuning: Tuning::for_device(&info),
            inner: Arc::new(Inner {
                info,
                id,
                context,
                queue,
                pending: Mutex::new(Vec::new()),
                times: Mutex::new(BTreeMap::new()),
                allocated: AtomicU64::new(0),
            }),
        })
    }

    /// What the device says of itself.
    #[must_use]
    pub fn info(&self) -> &DeviceInfo {
        &self.inner.info
    }

    /// How kernels are cut for this device: the default of its class, unless [`Device::with_tuning`] says otherwise.
    #[must_use]
    pub fn tuning(&self) -> Tuning {
        self.tuning
    }

    /// The same device, for which kernels are to be cut like this.
    #[must_use]
    pub fn with_tuning(mut self, tuning: Tuning) -> Self {
        self.tuning = tuning;
        self
    }

    /// Bytes of all arrays that are alive on the device.
    #[must_use]
    pub fn allocated_bytes(&self) -> u64 {
        self.inner.allocated.load(Ordering::Relaxed)
    }

    /// Hands everything enqueued so far to the device without waiting.
    ///
    /// # Errors
    /// The driver's.
    pub fn flush(&self) -> Result<()> {
        core::flush(&self.inner.queue).map_err(|e| device_error("flush", &e, LOST))
    }

    /// Waits until everything enqueued is done.
    ///
    /// # Errors
    /// The driver's.
    pub fn finish(&self) -> Result<()> {
        core::finish(&self.inner.queue).map_err(|e| device_error("finish", &e, LOST))
    }
}

fn select(list: &[DeviceInfo], selector: &str) -> Option<usize> {
    let s = selector.to_lowercase();
    let kind = match s.as_str() {
        "cpu" => Some(DeviceKind::Cpu),
        "gpu" => Some(DeviceKind::Gpu),
        "accelerator" => Some(DeviceKind::Accelerator),
        _ => None,
    };
    if let Some(kind) = kind {
        return list.iter().find(|d| d.kind == kind).map(|d| d.index);
    }
    if let Ok(index) = s.parse::<usize>() {
        return list.get(index).map(|d| d.index);
    }
    list.iter()
        .find(|d| d.name.to_lowercase().contains(&s) || d.platform.to_lowercase().contains(&s))
        .map(|d| d.index)
}

/// The devices, asked for once: some drivers answer wrongly when several threads ask for the first time.
static DEVICES: Mutex<Vec<(DeviceInfo, core::DeviceId)>> = Mutex::new(Vec::new());

fn enumerate() -> Result<Vec<(DeviceInfo, core::DeviceId)>> {
    let mut known = DEVICES.lock().unwrap_or_else(PoisonError::into_inner);
    if known.is_empty() {
        *known = ask_platforms()?;
    }
    Ok(known.clone())
}

fn ask_platforms() -> Result<Vec<(DeviceInfo, core::DeviceId)>> {
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
        return Err(Error::device("OpenCL", "no device found", INSTALL));
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
            DeviceInfoResult::MaxMemAllocSize(v) | DeviceInfoResult::GlobalMemSize(v) => v,
            DeviceInfoResult::MaxWorkGroupSize(v) => v as u64,
            _ => 0,
        })
    };
    Ok(DeviceInfo {
        index,
        name: text(Query::Name)?.trim().to_owned(),
        vendor: text(Query::Vendor)?.trim().to_owned(),
        platform: platform.trim().to_owned(),
        driver: text(Query::DriverVersion)?.trim().to_owned(),
        kind,
        compute_units: number(Query::MaxComputeUnits)? as u32,
        fp64: text(Query::Extensions)?.contains("cl_khr_fp64"),
        vector_width: number(Query::NativeVectorWidthFloat)? as u32,
        max_alloc: number(Query::MaxMemAllocSize)?,
        global_memory: number(Query::GlobalMemSize)?,
        max_work_group: number(Query::MaxWorkGroupSize)? as usize,
    })
}

impl Inner {
    pub(super) fn device_ptr(&self) -> impl ClDeviceIdPtr + use<> {
        self.id
    }
}
