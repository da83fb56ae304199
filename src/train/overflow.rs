//! Iterations on their way to the device, and what happens when the pairs of one do not fit.

use crate::base::error::Result;
use crate::device::PendingRead;
use crate::device::tuning::status;
use crate::train::Trainer;

/// An iteration that the device may not have done yet.
pub(super) struct InFlight {
    pub(super) iteration: u32,
    pub(super) counters: PendingRead<u32>,
    pub(super) launches: usize,
}

impl Trainer {
    pub(super) fn settle_oldest(&mut self) -> Result<()> {
        let Some(done) = self.in_flight.pop_front() else {
            return Ok(());
        };
        let counters = done.counters.wait()?;
        self.device.collect_times(done.launches)?;
        for later in &mut self.in_flight {
            later.launches -= done.launches.min(later.launches);
        }
        self.tally.most_pairs = self
            .tally
            .most_pairs
            .max(counters[status::PAIRS as usize] as usize);
        self.tally.non_finite = u64::from(counters[status::NON_FINITE as usize]);
        let needed = counters[status::OVERFLOW as usize];
        if needed > 0 {
            self.in_flight.clear();
            self.tally.overflows += 1;
            self.tally.most_pairs = self.tally.most_pairs.max(needed as usize);
            self.renderer.grow_pairs(needed)?;
            self.iteration = done.iteration;
        }
        Ok(())
    }

    /// Waits until every iteration enqueued so far has truly been done (repeating those that overflowed).
    ///
    /// # Errors
    /// As [`Trainer::step`].
    pub fn settle(&mut self) -> Result<()> {
        let goal = self.iteration;
        loop {
            while !self.in_flight.is_empty() {
                self.settle_oldest()?;
            }
            if self.iteration >= goal {
                return Ok(());
            }
            self.step()?;
        }
    }
}
