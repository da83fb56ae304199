//! Density steps in the loop: when one begins and when it ends.

use crate::base::error::Result;
use crate::train::control::Control;
use crate::train::step::{Event, Trainer};
use crate::train::working::Working;

impl Trainer {
    /// Density control and the parts of the trainer that it changes.
    pub(super) fn controlled(&mut self) -> (&mut Control, Working<'_>) {
        let on = Working {
            device: &self.device,
            pipeline: &mut self.pipeline,
            gaussians: &mut self.gaussians,
            views: &self.views,
            smoothing: self.smoothing.as_ref(),
        };
        (&mut self.control, on)
    }

    /// Begins density control if it is due, and ends what has begun if it has lagged behind for long enough.
    pub(super) fn density_step(&mut self) -> Result<Option<Event>> {
        let at = self.iteration;
        if self.schedule.density_lag(at) == 0 {
            self.begin_density_step()?;
        }
        let over = at >= self.schedule.iterations(at);
        if !(self.control.deciding.as_ref()).is_some_and(|step| over || at >= step.ends) {
            return Ok(None);
        }
        self.settle()?;
        let before = self.gaussians.scene.count;
        self.timing.begin_step()?;
        let (control, on) = self.controlled();
        let event = control.end(on)?;
        self.timing.end_step()?;
        if self.amidst_batch(at) {
            // At the end of a run alone; the rows are others now.
            self.gaussians.clear_gradients()?;
        }
        let max = self.counters.max_intersections as f64;
        let after = self.gaussians.scene.count as f64;
        self.counters.max_intersections = (max * after / before.max(1) as f64) as usize;
        self.fit_views()?;
        Ok(event.map(Event::Density))
    }

    /// Begins a density step if one is due and none has begun.
    pub(super) fn begin_density_step(&mut self) -> Result<()> {
        let (at, lag) = (self.iteration, self.schedule.density_lag(self.iteration));
        let due = self.schedule.density_due(at);
        let Some(progress) = due.filter(|_| self.control.deciding.is_none()) else {
            return Ok(());
        };
        // The queue with counters has to be waited for.
        if lag == 0 || self.crew.is_some() {
            self.settle()?;
        }
        if lag == 0 {
            self.timing.begin_step()?;
        }
        let (control, on) = self.controlled();
        control.begin(on, at, progress, lag)?;
        match lag {
            0 => self.timing.end_step(),
            _ => Ok(()),
        }
    }
}
