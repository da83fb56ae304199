//! [`Device`]: choosing one and opening it.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use ocl_core::{self as core, Event, ProfilingInfo};

use crate::base::cores::Cores;
use crate::base::error::{Error, Result};
use crate::device::compiled::{Compiled, OF_CPUS};
use crate::device::error::{LOST, device_error};
use crate::device::info::{DeviceInfo, DeviceKind, enumerate, select};
use crate::device::part::Part;
use crate::device::queues::{InUse, Queues};
use crate::device::seat::Seat;
use crate::device::staging::Staging;
use crate::device::tuning::Tuning;
use crate::ranks::Exchange;
use crate::ranks::launched::local_rank;

/// Device time of one stage.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct StageTime {
    /// Seconds between start and end, by the device's profiling counters.
    pub seconds: f64,
    /// Number of launches.
    pub calls: u64,
}

/// Device time by stage.
pub type StageTimes = BTreeMap<&'static str, StageTime>;

/// An open device, which does everything in the order in which it is enqueued. Cheap to clone.
#[derive(Clone, Debug)]
pub struct Device {
    pub(super) inner: Arc<Inner>,
    tuning: Tuning,
    helpers: Helpers,
}

/// Devices or processes that train a scene together with a device.
#[derive(Clone, Debug, Default)]
pub enum Helpers {
    /// Nobody.
    #[default]
    None,
    /// Other devices of this process.
    Devices(Arc<[Device]>),
    /// Other processes, which have devices of their own.
    Processes(Arc<dyn Exchange>),
}

impl Helpers {
    /// Number of ranks, that of the device itself included.
    #[must_use]
    pub fn ranks(&self) -> usize {
        match self {
            Self::None => 1,
            Self::Devices(devices) => 1 + devices.len(),
            Self::Processes(exchange) => exchange.ranks(),
        }
    }
}

/// A timed launch whose profiling counters have not been read yet.
#[derive(Debug)]
pub(super) struct Enqueued {
    pub kernel: &'static str,
    /// The stage that its time is counted as.
    pub stage: &'static str,
    /// Number of work-items.
    pub items: usize,
    pub event: Event,
}

#[derive(Debug)]
pub(super) struct Inner {
    pub info: DeviceInfo,
    pub id: core::DeviceId,
    queues: Queues,
    pub staging: Staging,
    /// Timed launches whose profiling counters have not been read yet.
    pending: Mutex<Vec<Enqueued>>,
    /// Bytes of the buffers that are alive.
    pub allocated: AtomicU64,
    /// The context, and what is built in it; it goes after everything that is of it.
    pub compiled: Arc<Compiled>,
    /// The part of the device that `id` is, if it is one; contexts and queues go before it.
    _part: Option<Part>,
}

impl Inner {
    fn pending(&self) -> MutexGuard<'_, Vec<Enqueued>> {
        self.pending.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The queue in use.
    pub(super) fn queue(&self) -> InUse<'_> {
        self.queues.in_use()
    }

    /// Adds a timed launch.
    pub(super) fn add_launch(&self, launch: Enqueued) {
        self.pending().push(launch);
    }
}

impl Drop for Inner {
    /// Waits for what is enqueued on a CPU, or where programs have seats: nothing of them runs any more when another open device has them or their
    /// seats. Nobody has those of a device that fails to.
    fn drop(&mut self) {
        let waits = self.info.kind == DeviceKind::Cpu || Seat::is_needed(&self.info);
        if waits && core::finish(&self.queue()).is_err() {
            OF_CPUS.forget(&self.compiled);
        }
    }
}

/// The description of a device of which a part is taken, or all.
fn taking(info: DeviceInfo, part: Option<&Part>) -> DeviceInfo {
    let cores = part.map_or(info.compute_units, |part| part.units);
    DeviceInfo { cores, ..info }
}

/// The device that a selector names, or the default, with its handle.
fn find(selector: Option<&str>) -> Result<(DeviceInfo, core::DeviceId)> {
    let (infos, ids): (Vec<DeviceInfo>, Vec<core::DeviceId>) = enumerate()?.into_iter().unzip();
    let found = match selector {
        None => Device::default_of(&infos),
        Some("") => None,
        Some("local-rank") => Device::of_local_rank(&infos, local_rank()),
        Some(s) => select(&infos, s),
    };
    let Some(info) = found.cloned() else {
        return Err(Error::device(
            "device",
            format!("no device matches {:?}", selector.unwrap_or("")),
            "`mhsplat devices` lists what can be selected; a list or a part of one is for `mhsplat train` alone",
        ));
    };
    let id = ids[info.index];
    Ok((info, id))
}

impl Device {
    /// Every device of every platform, with the cores that [`Device::open`] takes of it.
    ///
    /// # Errors
    /// No OpenCL loader, platform or device.
    pub fn list() -> Result<Vec<DeviceInfo>> {
        let taken = |(info, id): (DeviceInfo, core::DeviceId)| {
            let part = Part::of(&info, id, Cores::allowed())?;
            Ok(taking(info, part.as_ref()))
        };
        enumerate()?.into_iter().map(taken).collect()
    }

    /// The device that [`Device::open`] takes without a selector: the first GPU, then accelerator, then CPU.
    #[must_use]
    pub fn default_of(list: &[DeviceInfo]) -> Option<&DeviceInfo> {
        list.iter().min_by_key(|d| (d.kind, d.index))
    }

    /// The device of the process with this number among those on its node: one of the default's kind, platform and name, in turn. Another platform may
    /// have the same hardware again under another driver, and a device of another name another speed.
    #[must_use]
    pub fn of_local_rank(list: &[DeviceInfo], rank: usize) -> Option<&DeviceInfo> {
        let default = Self::default_of(list)?;
        let alike = list.iter().filter(|d| {
            d.kind == default.kind && d.platform == default.platform && d.name == default.name
        });
        let alike: Vec<&DeviceInfo> = alike.collect();
        alike.get(rank % alike.len().max(1)).copied()
    }

    /// Opens the device named by an index, a part of its name or platform, a type (cpu, gpu, accelerator), or `local-rank`: the device of
    /// this process among those on its node ([`Device::of_local_rank`]). A CPU takes the cores that the process may use ([`Cores::allowed`]).
    ///
    /// # Errors
    /// No device, or none that matches.
    pub fn open(selector: Option<&str>) -> Result<Self> {
        Self::open_on(selector, Cores::allowed())
    }

    /// Opens a device as [`Device::open`]; a CPU takes these cores, where its driver can divide it. Results do not depend on their number.
    ///
    /// # Errors
    /// Those of [`Device::open`], or a number of cores that was asked for and cannot be had.
    pub fn open_on(selector: Option<&str>, cores: Cores) -> Result<Self> {
        let (info, whole) = find(selector)?;
        let part = Part::of(&info, whole, cores)?;
        Self::make(info, whole, part)
    }

    /// Opens the devices of a list, such as `0,1`, or several parts of one, such as `cpu/2`; the first has the others as its helpers
    /// ([`Device::helpers`]). Any other selector is that of [`Device::open_on`].
    ///
    /// # Errors
    /// Those of [`Device::open_on`], or a device that cannot be divided so often.
    pub fn open_all(selector: Option<&str>, cores: Cores) -> Result<Self> {
        let known = find(selector);
        let (Some(list), Err(_)) = (selector, &known) else {
            return Self::open_on(selector, cores);
        };
        let mut all = Vec::new();
        for one in list.split(',').map(str::trim) {
            let parts = one.rsplit_once('/');
            match parts.and_then(|(name, n)| Some((name, n.parse().ok()?))) {
                Some((name, parts)) => {
                    let (info, whole) = find(Some(name))?;
                    for part in Part::even(&info, whole, cores, parts)? {
                        all.push(Self::make(info.clone(), whole, Some(part))?);
                    }
                }
                None => all.push(Self::open_on(Some(one), cores)?),
            }
        }
        let mut all = all.into_iter();
        let first = all
            .next()
            .map_or_else(|| Self::open_on(selector, cores), Ok)?;
        let helpers = match all.len() {
            0 => Helpers::None,
            _ => Helpers::Devices(all.collect()),
        };
        Ok(Self { helpers, ..first })
    }

    /// Opens a device, or a part of it.
    fn make(info: DeviceInfo, whole: core::DeviceId, part: Option<Part>) -> Result<Self> {
        let id = part.as_ref().map_or(whole, |part| part.id);
        let info = taking(info, part.as_ref());
        let fail = |e: core::Error| device_error("open device", &e, "select another with --device");
        let compiled = match part {
            None if info.kind == DeviceKind::Cpu => OF_CPUS.context(id),
            _ => Compiled::new(id),
        };
        let compiled = compiled.map_err(fail)?;
        let queues = Queues::new(&compiled.context, id);
        let queues = queues
            .inspect_err(|_| OF_CPUS.forget(&compiled))
            .map_err(fail)?;
        Ok(Self {
            tuning: Tuning::for_device(&info),
            inner: Arc::new(Inner {
                info,
                id,
                queues,
                staging: Staging::default(),
                pending: Mutex::default(),
                allocated: AtomicU64::new(0),
                compiled,
                _part: part,
            }),
            helpers: Helpers::None,
        })
    }

    /// Devices or processes that share the training of a scene with this device.
    #[must_use]
    pub fn helpers(&self) -> &Helpers {
        &self.helpers
    }

    /// The same device with the processes of an exchange as its helpers.
    #[must_use]
    pub fn with_processes(mut self, exchange: Arc<dyn Exchange>) -> Self {
        self.helpers = Helpers::Processes(exchange);
        self
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
        core::flush(&self.inner.queue()).map_err(|e| device_error("flush", &e, LOST))
    }

    /// Waits until everything enqueued is done.
    pub fn finish(&self) -> Result<()> {
        core::finish(&self.inner.queue()).map_err(|e| device_error("finish", &e, LOST))
    }

    /// Has every launch from now on timed, which costs some time with each, or no longer; returns true if they were timed so far. Waits
    /// until everything enqueued is done if that changes.
    ///
    /// # Errors
    /// The driver's.
    pub fn time_launches(&self, timed: bool) -> Result<bool> {
        let switched = self.inner.queues.switch(timed);
        switched.map_err(|e| device_error("finish", &e, LOST))
    }

    /// Result of `work`, whose launches are timed; those from before are in no time any more.
    ///
    /// # Errors
    /// Those of `work`, or the driver's.
    pub fn timed<T>(&self, work: impl FnOnce() -> Result<T>) -> Result<T> {
        let before = self.time_launches(true)?;
        self.forget_launches(0);
        let result = work();
        self.time_launches(before)?;
        result
    }

    /// Number of timed launches so far whose time has not been taken.
    #[must_use]
    pub fn launches(&self) -> usize {
        self.inner.pending().len()
    }

    /// Kernels and numbers of work-items of the timed launches whose time has not been taken, in their order.
    #[must_use]
    pub fn enqueued(&self) -> Vec<(&'static str, usize)> {
        let pending = self.inner.pending();
        pending.iter().map(|l| (l.kernel, l.items)).collect()
    }

    /// Device time of the oldest `launches` timed launches, or of all if there are fewer; waits for them if they are not done.
    ///
    /// # Errors
    /// The driver's.
    pub fn take_times(&self, launches: usize) -> Result<StageTimes> {
        let drained: Vec<Enqueued> = {
            let mut pending = self.inner.pending();
            let n = launches.min(pending.len());
            pending.drain(..n).collect()
        };
        let mut times = StageTimes::new();
        for Enqueued { stage, event, .. } in drained {
            core::wait_for_event(&event).map_err(|e| device_error(stage, &e, LOST))?;
            let ask = |info| {
                let counter = core::get_event_profiling_info(&event, info);
                counter.ok().and_then(|t| t.time().ok())
            };
            let entry = times.entry(stage).or_default();
            entry.calls += 1;
            if let (Some(start), Some(end)) = (ask(ProfilingInfo::Start), ask(ProfilingInfo::End)) {
                entry.seconds += end.saturating_sub(start) as f64 * 1e-9;
            }
        }
        Ok(times)
    }

    /// Leaves the timed launches but for the oldest `kept` out of all times, for callers that time them otherwise.
    pub fn forget_launches(&self, kept: usize) {
        self.inner.pending().truncate(kept);
    }
}
