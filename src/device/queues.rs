//! [`Queues`]: one queue to work with, and one that takes the time of every launch.

use std::ops::Deref;
use std::sync::{PoisonError, RwLock, RwLockReadGuard};

use ocl_core::{self as core, CommandQueue, CommandQueueProperties};

/// Two in-order queues of one context. Counters for profiling belong to a queue and cost time with every launch, so that only one of
/// the two has them. Never do both have work: whatever is enqueued is in one order.
#[derive(Debug)]
pub(super) struct Queues {
    plain: CommandQueue,
    timed: CommandQueue,
    /// True while `timed` is in use. Whoever enqueues holds it.
    is_timed: RwLock<bool>,
}

/// The queue in use, which stays in use as long as this is held.
pub(super) struct InUse<'a> {
    queues: &'a Queues,
    is_timed: RwLockReadGuard<'a, bool>,
}

impl Queues {
    /// Two queues of which the one without counters is in use.
    pub fn new(context: &core::Context, id: core::DeviceId) -> core::Result<Self> {
        let create = |properties| core::create_command_queue(context, id, properties);
        Ok(Self {
            plain: create(None)?,
            timed: create(Some(CommandQueueProperties::PROFILING_ENABLE))?,
            is_timed: RwLock::new(false),
        })
    }

    /// The queue in use.
    pub fn in_use(&self) -> InUse<'_> {
        InUse {
            queues: self,
            is_timed: self.is_timed.read().unwrap_or_else(PoisonError::into_inner),
        }
    }

    /// Puts the queue with counters in use, or the other; returns true if it was the one with counters so far. Waits until everything
    /// enqueued is done if that changes.
    pub fn switch(&self, timed: bool) -> core::Result<bool> {
        if *self.in_use().is_timed == timed {
            return Ok(timed);
        }
        let mut is_timed = self
            .is_timed
            .write()
            .unwrap_or_else(PoisonError::into_inner);
        let before = *is_timed;
        core::finish(if before { &self.timed } else { &self.plain })?;
        *is_timed = timed;
        Ok(before)
    }
}

impl InUse<'_> {
    /// True if launches are timed.
    pub fn is_timed(&self) -> bool {
        *self.is_timed
    }
}

impl Deref for InUse<'_> {
    type Target = CommandQueue;

    fn deref(&self) -> &CommandQueue {
        match *self.is_timed {
            true => &self.queues.timed,
            false => &self.queues.plain,
        }
    }
}
