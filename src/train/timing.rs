//! [`Timing`]: the iterations whose stages are timed, and what they say of all.

use std::collections::BTreeMap;

use crate::base::error::Result;
use crate::device::{Device, StageTime, StageTimes};

/// Iterations from one that is timed to the next: few enough to tell how the stages change, and so many that waiting for the queue
/// with counters costs nothing. A prime, so that samples meet whatever comes at every hundredth iteration as often as it comes.
pub const TIMING_INTERVAL: u32 = 61;
/// First iteration that is timed for good: in the middle of an interval, since what it stands for grows or shrinks.
const MIDDLE: u32 = TIMING_INTERVAL / 2;
/// Iteration that is timed until then, not the first, in which more is due than in most.
const EARLY: u32 = 1;

/// Times of the stages of training. Launches of anything else between iterations count for none.
pub(super) struct Timing {
    device: Device,
    /// Iterations from one that is timed to the next; 1 if all are.
    interval: u32,
    /// Sums over the iterations that were timed.
    sampled: StageTimes,
    /// Number of iterations that were timed.
    samples: u64,
    /// Number of iterations so far, repeated ones too.
    iterations: u64,
    /// Sums over all density steps.
    steps: StageTimes,
}

impl Timing {
    /// Times of a device on which nothing is timed yet but a sample of the iterations.
    pub fn new(device: &Device) -> Self {
        Self {
            device: device.clone(),
            interval: TIMING_INTERVAL,
            sampled: BTreeMap::new(),
            samples: 0,
            iterations: 0,
            steps: BTreeMap::new(),
        }
    }

    /// Has every iteration timed. Before the first one.
    pub fn time_all(&mut self) {
        self.interval = 1;
    }

    /// Begins an iteration; `alone` if no other is under way.
    pub fn begin(&mut self, iteration: u32, alone: bool) -> Result<()> {
        if alone {
            self.device.forget_launches(0);
        }
        if self.interval > 1 && iteration == MIDDLE {
            self.sampled.clear();
            self.samples = 0;
        }
        let due = iteration % self.interval == MIDDLE % self.interval || iteration == EARLY;
        self.device.time_launches(due)?;
        self.iterations += 1;
        Ok(())
    }

    /// Ends what is enqueued of an iteration. Returns the launches whose times are to be taken when it is done.
    pub fn end(&mut self) -> Result<usize> {
        // At once, with a queue that has been waited for; later where that would be after every iteration.
        if self.interval > 1 && self.device.time_launches(false)? {
            self.take(usize::MAX)?;
        }
        Ok(self.device.launches())
    }

    /// Takes the times of the oldest iteration, which is done.
    pub fn settle(&mut self, launches: usize) -> Result<()> {
        if launches > 0 {
            self.take(launches)?;
        }
        Ok(())
    }

    fn take(&mut self, launches: usize) -> Result<()> {
        add(&mut self.sampled, self.device.take_times(launches)?, 1.0);
        self.samples += 1;
        Ok(())
    }

    /// Begins a density step, with nothing under way. All are timed: they are few, no two of them are alike, and the queue has been
    /// waited for, so that the one with counters costs nothing.
    pub fn begin_step(&self) -> Result<()> {
        self.device.forget_launches(0);
        self.device.time_launches(true).map(|_| ())
    }

    /// Ends a density step.
    pub fn end_step(&mut self) -> Result<()> {
        self.device.time_launches(self.interval == 1)?;
        add(&mut self.steps, self.device.take_times(usize::MAX)?, 1.0);
        Ok(())
    }

    /// Device time in density steps so far.
    pub fn step_seconds(&self) -> f64 {
        self.steps.values().map(|time| time.seconds).sum()
    }

    /// Time by stage so far: those timed stand for all iterations.
    pub fn stages(&self) -> StageTimes {
        let mut times = self.steps.clone();
        let each = self.iterations as f64 / self.samples.max(1) as f64;
        add(&mut times, self.sampled.clone(), each);
        times
    }
}

/// Adds `times`, each as often as `weight` says.
fn add(sums: &mut StageTimes, times: StageTimes, weight: f64) {
    for (stage, time) in times {
        let sum: &mut StageTime = sums.entry(stage).or_default();
        sum.seconds += weight * time.seconds;
        sum.calls += (weight * time.calls as f64).round() as u64;
    }
}
