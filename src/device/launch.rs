//! Kernels with checked argument types, and the time each stage takes.

use std::sync::{Arc, Mutex, PoisonError};

use ocl::core::{self, ArgVal, Event, KernelArgInfo, KernelInfo, KernelInfoResult, ProfilingInfo};

use crate::base::error::{Error, Result};
use crate::device::array::Array;
use crate::device::context::{Device, Inner};
use crate::device::layout::Element;
use crate::device::{LOST, device_error};

/// Device time of one stage.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct StageTime {
    /// Seconds between start and end, as the device's profiling counters say.
    pub seconds: f64,
    /// Launches.
    pub calls: u64,
}

/// A launch whose profiling counters have not been read yet.
#[derive(Debug)]
pub(super) struct Pending {
    stage: &'static str,
    event: Event,
}

/// A compiled kernel. Arguments are set and checked on every launch.
#[derive(Debug)]
pub struct Kernel {
    device: Arc<Inner>,
    kernel: Mutex<core::Kernel>,
    stage: &'static str,
    name: &'static str,
    types: Vec<String>,
}

/// Argument list under construction; see [`Kernel::launch`].
pub struct Launch<'a> {
    owner: &'a Kernel,
    kernel: std::sync::MutexGuard<'a, core::Kernel>,
    next: u32,
    error: Option<Error>,
}

impl Kernel {
    pub(super) fn new(
        device: &Device,
        program: &core::Program,
        stage: &'static str,
        name: &'static str,
    ) -> Result<Self> {
        let fail = |e: core::Error| device_error(name, &e, "this is a bug; please report it");
        let kernel = core::create_kernel(program, name).map_err(fail)?;
        let KernelInfoResult::NumArgs(n) =
            core::get_kernel_info(&kernel, KernelInfo::NumArgs).map_err(fail)?
        else {
            return Err(Error::device(
                name,
                "no number of arguments",
                "update the driver",
            ));
        };
        // Drivers may answer without -cl-kernel-arg-info support; then lengths alone are checked.
        let types = (0..n)
            .map(|i| {
                core::get_kernel_arg_info(&kernel, i, KernelArgInfo::TypeName, None)
                    .map_or_else(|_| String::new(), |t| t.to_string())
            })
            .collect();
        Ok(Self {
            device: device.inner.clone(),
            kernel: Mutex::new(kernel),
            stage,
            name,
            types,
        })
    }

    /// The same kernel with its time counted under another stage's name.
    #[must_use]
    pub fn counted_as(self, stage: &'static str) -> Self {
        Self { stage, ..self }
    }

    /// Starts an argument list; arguments follow in the order of the kernel's signature.
    pub fn launch(&self) -> Launch<'_> {
        Launch {
            owner: self,
            kernel: self.kernel.lock().unwrap_or_else(PoisonError::into_inner),
            next: 0,
            error: None,
        }
    }
}

impl Launch<'_> {
    fn set(mut self, type_name: &str, pointer: bool, value: ArgVal<'_>) -> Self {
        if self.error.is_some() {
            return self;
        }
        let found = self.owner.types.get(self.next as usize).map(String::as_str);
        let matches = match found {
            None => false,
            Some("") => true,
            Some(t) => t.trim_end_matches('*') == type_name && t.ends_with('*') == pointer,
        };
        if !matches {
            self.error = Some(Error::device(
                self.owner.name,
                format!(
                    "argument {} is {}{}; the kernel takes {}",
                    self.next,
                    type_name,
                    if pointer { "*" } else { "" },
                    found.unwrap_or("fewer arguments")
                ),
                "this is a bug; please report it",
            ));
            return self;
        }
        if let Err(e) = core::set_kernel_arg(&self.kernel, self.next, value) {
            self.error = Some(device_error(
                self.owner.name,
                &e,
                "this is a bug; please report it",
            ));
        }
        self.next += 1;
        self
    }

    /// A device array; at least `len` values are needed.
    #[must_use]
    pub fn array<T: Element>(mut self, array: &Array<T>, len: usize) -> Self {
        if self.error.is_none() && array.len() < len {
            self.error = Some(Error::device(
                self.owner.name,
                format!(
                    "{} holds {} values; {len} are needed",
                    array.name(),
                    array.len()
                ),
                "this is a bug; please report it",
            ));
        }
        self.set(T::NAME, true, ArgVal::mem(&array.mem))
    }

    /// A value.
    #[must_use]
    pub fn value<T: Element>(self, value: T) -> Self {
        self.set(T::NAME, false, ArgVal::scalar(&value))
    }

    /// Enqueues the kernel over `global` work-items (rounded up to whole work-groups of `local`). Does not wait.
    ///
    /// # Errors
    /// A wrong argument, or the driver's.
    pub fn run(self, global: [usize; 2], local: [usize; 2]) -> Result<()> {
        if let Some(error) = self.error {
            return Err(error);
        }
        if self.next as usize != self.owner.types.len() {
            return Err(Error::device(
                self.owner.name,
                format!(
                    "{} arguments given; {} expected",
                    self.next,
                    self.owner.types.len()
                ),
                "this is a bug; please report it",
            ));
        }
        let size = |k: usize| global[k].max(1).next_multiple_of(local[k]);
        let mut event = Event::null();
        // SAFETY: every argument has been set with its own type; kernels check their bounds against the counts given.
        unsafe {
            core::enqueue_kernel(
                &self.owner.device.queue,
                &self.kernel,
                2,
                None,
                &[size(0), size(1), 1],
                Some([local[0], local[1], 1]),
                None::<&Event>,
                Some(&mut event),
            )
        }
        .map_err(|e| device_error(self.owner.name, &e, LOST))?;
        let mut pending = self
            .owner
            .device
            .pending
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        pending.push(Pending {
            stage: self.owner.stage,
            event,
        });
        Ok(())
    }
}

impl Device {
    /// Launches so far whose device time has not been read.
    #[must_use]
    pub fn launches(&self) -> usize {
        let pending = self
            .inner
            .pending
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        pending.len()
    }

    /// Adds up the device time of the oldest `launches` launches; waits for them if they are not done.
    ///
    /// # Errors
    /// The driver's.
    pub fn collect_times(&self, launches: usize) -> Result<()> {
        let drained: Vec<Pending> = {
            let mut pending = self
                .inner
                .pending
                .lock()
                .unwrap_or_else(PoisonError::into_inner);
            let n = launches.min(pending.len());
            pending.drain(..n).collect()
        };
        let mut times = self
            .inner
            .times
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        for p in drained {
            core::wait_for_event(&p.event).map_err(|e| device_error(p.stage, &e, LOST))?;
            let ask = |info| {
                core::get_event_profiling_info(&p.event, info)
                    .ok()
                    .and_then(|t| t.time().ok())
            };
            let entry = times.entry(p.stage).or_default();
            entry.calls += 1;
            if let (Some(start), Some(end)) = (ask(ProfilingInfo::Start), ask(ProfilingInfo::End)) {
                entry.seconds += end.saturating_sub(start) as f64 * 1e-9;
            }
        }
        Ok(())
    }

    /// Leaves launches so far whose device time has not been read out of all stages: who made them counts them otherwise.
    pub fn forget_launches(&self) {
        self.inner
            .pending
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clear();
    }

    /// Device time per stage since the device was opened (or [`Device::reset_times`]).
    #[must_use]
    pub fn times(&self) -> Vec<(&'static str, StageTime)> {
        let times = self
            .inner
            .times
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        times.iter().map(|(k, v)| (*k, *v)).collect()
    }

    /// Forgets the times so far.
    pub fn reset_times(&self) {
        self.inner
            .times
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clear();
    }
}
