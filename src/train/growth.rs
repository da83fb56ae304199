//! [`Growth`]: the numbers of Gaussians that a run is expected to have.

use std::fmt;
use std::sync::Arc;

use crate::config::Length;
use crate::density::{DensityControl, Expected, StepContext};
use crate::train::schedule::Schedule;

/// Largest number of steps that are looked ahead: whoever searches for the length of a run asks for absurd ones.
const MOST: usize = 1000;

/// Density steps to come, by a schedule and what its strategy expects of them.
#[derive(Clone)]
pub struct Growth {
    schedule: Schedule,
    strategy: Arc<dyn DensityControl>,
    max_gaussians: Option<usize>,
}

impl fmt::Debug for Growth {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Growth").finish_non_exhaustive()
    }
}

impl Growth {
    /// The growth of a run with a bound on the number of its Gaussians.
    #[must_use]
    pub fn new(
        schedule: Schedule,
        strategy: Arc<dyn DensityControl>,
        max_gaussians: Option<usize>,
    ) -> Self {
        Self {
            schedule,
            strategy,
            max_gaussians,
        }
    }

    /// Takes over the schedule of a run whose length has changed.
    pub fn follow(&mut self, schedule: &Schedule) {
        self.schedule = schedule.clone();
    }

    /// Iterations done at each density step after `since` of a run of `length`, at most a thousand, and the number of Gaussians expected after it
    /// from the set before the first; `None` if the strategy cannot tell.
    #[must_use]
    pub fn steps(&self, since: u32, set: Expected, length: u32) -> Option<Vec<(u32, f64)>> {
        let mut schedule = self.schedule.clone();
        if schedule.iterations(since) != length {
            schedule.set_length(Length::new(since, length));
        }
        let (mut steps, mut set) = (Vec::new(), set);
        let mut next = schedule.next_density(since);
        let mut before = next.and_then(|(at, _)| schedule.density_before(at));
        while let Some((at, progress)) = next.filter(|_| steps.len() < MOST) {
            next = schedule.next_density(at);
            let context = StepContext {
                max_gaussians: self.max_gaussians,
                last: next.is_none(),
                before,
                spacing: schedule.density_spacing(at),
                ..StepContext::at(at, progress, 0)
            };
            set = self.strategy.expected(&context, set)?;
            steps.push((at, set.gaussians));
            before = Some(progress);
        }
        Some(steps)
    }
}
