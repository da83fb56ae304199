//! [`Device`]: choosing one and opening it.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use ocl_core::{self as core, CommandQueueProperties};

use crate::base::error::{Error, Result};
use crate::device::error::{LOST, device_error};
use crate::device::info::{DeviceInfo, DeviceKind, INSTALL, enumerate, select};
use crate::device::profile::{Profile, StageTime};
use crate::device::tuning::Tuning;

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
    pub profile: Profile,
    /// Bytes of the buffers that are alive.
    pub allocated: AtomicU64,
}

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
                profile: Profile::default(),
                allocated: AtomicU64::new(0),
            }),
        })
    }

    /// Properties that the device reports.
    #[must_use]
    pub fn info(&self) -> &DeviceInfo {
        &self.inner.info
    }

    /// Sizes that kernels are built with: the default of its class, unless [`Device::with_tuning`] says otherwise.
    #[must_use]
    pub fn tuning(&self) -> Tuning {
        self.tuning
    }

    /// The same device with other sizes for its kernels.
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
    pub fn flush(&self) -> Result<()> {
        core::flush(&self.inner.queue).map_err(|e| device_error("flush", &e, LOST))
    }

    /// Waits until everything enqueued is done.
    pub fn finish(&self) -> Result<()> {
        core::finish(&self.inner.queue).map_err(|e| device_error("finish", &e, LOST))
    }

    /// Number of launches so far whose device time has not been read.
    #[must_use]
    pub fn launches(&self) -> usize {
        self.inner.profile.launches()
    }

    /// Adds up the device time of the oldest `launches` launches; waits for them if they are not done.
    pub fn collect_times(&self, launches: usize) -> Result<()> {
        self.inner.profile.collect(launches)
    }

    /// Leaves the launches whose device time has not been read out of all stages, for callers that time them otherwise.
    pub fn forget_launches(&self) {
        self.inner.profile.forget();
    }

    /// Device time per stage since the device was opened (or [`Device::reset_times`]).
    #[must_use]
    pub fn times(&self) -> Vec<(&'static str, StageTime)> {
        self.inner.profile.times()
    }

    /// Sets the times to zero.
    pub fn reset_times(&self) {
        self.inner.profile.reset();
    }
}
