//! Device time of each stage, from the profiling counters of its launches.

use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

use ocl_core::{self as core, Event, ProfilingInfo};

use crate::base::error::Result;
use crate::device::error::{LOST, device_error};

/// Device time of one stage.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct StageTime {
    /// Seconds between start and end, by the device's profiling counters.
    pub seconds: f64,
    /// Number of launches.
    pub calls: u64,
}

/// A launch whose profiling counters have not been read yet.
#[derive(Debug)]
struct Pending {
    stage: &'static str,
    event: Event,
}

/// Launches of a device and their times by stage.
#[derive(Debug, Default)]
pub(super) struct Profile {
    pending: Mutex<Vec<Pending>>,
    times: Mutex<BTreeMap<&'static str, StageTime>>,
}

impl Profile {
    fn pending(&self) -> MutexGuard<'_, Vec<Pending>> {
        self.pending.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn locked_times(&self) -> MutexGuard<'_, BTreeMap<&'static str, StageTime>> {
        self.times.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a launch.
    pub(super) fn add(&self, stage: &'static str, event: Event) {
        self.pending().push(Pending { stage, event });
    }

    /// Number of launches whose time has not been read.
    pub(super) fn launches(&self) -> usize {
        self.pending().len()
    }

    /// Adds up the times of the oldest `launches` launches; waits for them if they are not done.
    pub(super) fn collect(&self, launches: usize) -> Result<()> {
        let drained: Vec<Pending> = {
            let mut pending = self.pending();
            let n = launches.min(pending.len());
            pending.drain(..n).collect()
        };
        let mut times = self.locked_times();
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

    /// Drops the launches whose time has not been read.
    pub(super) fn forget(&self) {
        self.pending().clear();
    }

    /// Times by stage.
    pub(super) fn times(&self) -> Vec<(&'static str, StageTime)> {
        self.locked_times().iter().map(|(k, v)| (*k, *v)).collect()
    }

    /// Sets the times to zero.
    pub(super) fn reset(&self) {
        self.locked_times().clear();
    }
}
