//! Density steps in the loop: when one begins and when it ends.

use crate::base::error::{Error, Result};
use crate::train::control::{Control, DensityEvent};
use crate::train::crew::{DECIDE, EDIT, Words};
use crate::train::decision::{Deciding, Decision, outcome_of, words_of};
use crate::train::step::{Event, Next, Trainer};
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

    /// Settles what is in flight if a density step begins and ends before the next iteration, or one that lags ends: whoever measures the
    /// time of the step has that of iterations apart.
    ///
    /// # Errors
    /// See [`Trainer::settle`].
    pub fn settle_before_density(&mut self) -> Result<()> {
        let at = self.iteration;
        let over = at >= self.schedule.iterations(at);
        let ends = (self.control.deciding.as_ref()).map(|step| over || at >= step.ends);
        let begins = self.schedule.density_lag(at) == 0 && self.schedule.density_due(at).is_some();
        match matches!(self.next, Next::Pause | Next::Density) && ends.unwrap_or(begins) {
            true => self.settle(),
            false => Ok(()),
        }
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
        let before = self.gaussians.scene.all();
        self.timing.begin_step()?;
        let division = self.end_together()?;
        let event = self.end_density_step(at, division.as_deref())?;
        self.timing.end_step()?;
        self.rest();
        let max = self.counters.max_intersections as f64;
        let after = self.gaussians.scene.all() as f64;
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
        if self.decides_together() {
            self.spread()?;
            // A photo that cannot be read is an error before the others begin.
            for view in self.control.pictured(&self.views, at, progress) {
                self.views.view(at, at, view, &[])?;
            }
            self.tell(vec![DECIDE, at])?;
        } else if self.crew.is_some() {
            self.gather()?;
        }
        self.decide(at, progress)?;
        self.rest();
        match lag {
            0 => self.timing.end_step(),
            _ => Ok(()),
        }
    }

    /// True if all ranks take the decisions of density control, and edit the rows that they have.
    fn decides_together(&self) -> bool {
        self.crew.is_some() && !self.control.estimates_births()
    }

    /// Begins a density step after `at` iterations, with the others where ranks share the rows.
    fn decide(&mut self, at: u32, progress: f64) -> Result<()> {
        let lag = self.schedule.density_lag(at);
        let (control, on) = self.controlled();
        control.begin(on, at, progress, lag)
    }

    /// Has the others end the density step that has begun, if they take part in it; returns the first row of each rank afterwards, and the
    /// number of all.
    fn end_together(&mut self) -> Result<Option<Vec<usize>>> {
        if !self.decides_together() {
            self.gather()?;
            return Ok(None);
        }
        self.spread()?;
        let Some(step) = &mut self.control.deciding else {
            return Ok(None);
        };
        let decision = step.settled()?;
        // They do not know a step of a checkpoint.
        let words = match decision.before {
            Some(_) => Vec::new(),
            None => words_of(&decision.outcome),
        };
        let rows = decision.outcome.gaussians();
        let division = self.crew.as_mut().map(|crew| crew.divide_rows(rows));
        let bounds = division.iter().flatten().map(|row| *row as u32);
        let mut order = vec![EDIT, self.iteration];
        order.extend(bounds.chain(words));
        self.tell(order)?;
        Ok(division)
    }

    /// Ends the density step that has begun.
    fn end_density_step(
        &mut self,
        at: u32,
        division: Option<&[usize]>,
    ) -> Result<Option<DensityEvent>> {
        let (control, on) = self.controlled();
        let event = control.end(on, division)?;
        if self.amidst_batch(at) {
            // At the end of a run alone; the rows are others now.
            self.gaussians.clear_gradients()?;
        }
        Ok(event)
    }

    /// Begins a density step that the leader has begun.
    ///
    /// # Errors
    /// A step that is not due here, or those of [`Control::begin`].
    pub(super) fn follow_decision(&mut self, at: u32) -> Result<()> {
        match self.schedule.density_due(at) {
            Some(progress) => self.decide(at, progress),
            None => Err(not_here()),
        }
    }

    /// Ends a density step that the leader ends: the words are the first row of each rank afterwards, the number of all rows and, if this rank does
    /// not know the decision, that.
    ///
    /// # Errors
    /// No step that has begun here, or those of [`Control::end`].
    pub(super) fn follow_edits(&mut self, at: u32, ranks: usize, words: &[u32]) -> Result<()> {
        let mut words = Words(words);
        let division = words.some(ranks + 1)?;
        let division: Vec<usize> = division.iter().map(|row| *row as usize).collect();
        if !words.0.is_empty() {
            let decision = Decision {
                outcome: outcome_of(words.0)?,
                before: None,
                seconds: 0.0,
            };
            self.control.deciding = Some(Deciding::decided([at; 2], 0.0, decision));
        }
        match self.end_density_step(at, Some(&division))? {
            Some(_) => Ok(()),
            None => Err(not_here()),
        }
    }
}

/// The error of a density step that only the leader knows.
fn not_here() -> Error {
    let what = "the leader has a density step that is none here; start one program with one dataset on all nodes";
    Error::numerics("density control", what)
}
