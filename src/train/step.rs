//! [`Trainer`]: the training loop. `Trainer::iterate` is one iteration in order; [`Trainer::advance`] goes from one event to the
//! next.

use std::collections::VecDeque;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::base::error::{Error, Result};
use crate::capture::{Alpha, Dataset};
use crate::config::{Length, TrainingSize};
use crate::density::DensityControl;
use crate::device::tuning::status;
use crate::device::{Array, Defines, Device, Kernels, PendingRead, Program};
use crate::pipeline::buffers::ViewSet;
use crate::pipeline::forward::{Quantity, RenderOptions};
use crate::pipeline::pass::Pipeline;
use crate::pipeline::photos::Photos;
use crate::pipeline::stage::adam::Step;
use crate::pipeline::stage::loss::Beside;
use crate::scene::Gaussians;
use crate::train::control::{Control, DensityEvent};
use crate::train::crew::{Crew, LENGTH, RAISE, words_of_length};
use crate::train::gaussians::GaussianState;
use crate::train::optimizer::Optimizer;
use crate::train::plan::{Decision, Learned, Plan};
use crate::train::schedule::Schedule;
use crate::train::smoothing::Smoothing;
use crate::train::timing::Timing;
use crate::train::trace::DensityTrace;
use crate::train::views::{TrainingView, Views, capacity};

/// Iterations that may be on their way to the device before the host looks at the counters of the oldest.
const LAG: usize = 2;
/// Losses kept on the device.
pub(super) const LOSS_RING: usize = 256;

/// One thing that training did; see [`Trainer::advance`].
#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    /// An iteration was enqueued.
    Iteration {
        /// Iterations enqueued so far.
        enqueued: u32,
        /// Iterations that have settled: the device has done them, and none of them is ever repeated.
        settled: u32,
    },
    /// A density step has ended, with all iterations so far settled; it began after those that it tells.
    Density(DensityEvent),
    /// All iterations so far have settled, and an evaluation, a checkpoint or an export is due.
    Settled(u32),
    /// Training found out what the plan had left open.
    Decided(Decision),
    /// The next call compiles kernels and does nothing else: stop the clock.
    Compiling,
    /// The kernels are compiled.
    Compiled,
    /// All iterations are done, and Gaussians that no view shows are removed.
    Finished,
}

/// The next thing to do between two iterations. A checkpoint keeps it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Next {
    /// A pause for evaluation, checkpoint or export, if one is due: before density control, whose births have not found their
    /// places yet right after it.
    Pause,
    /// Density control, if it is due.
    Density,
    /// Another band of spherical harmonics, if one is due.
    #[default]
    Band,
    /// The decision on exposure compensation, if it is due.
    Exposure,
    /// Kernels of exposure compensation.
    Compile,
    /// An iteration.
    Iterate,
}

/// An iteration that the device may not have done yet.
struct InFlight {
    iteration: u32,
    counters: PendingRead<u32>,
    launches: usize,
}

/// Counters over a run.
#[derive(Debug, Default)]
pub(super) struct Counters {
    /// Largest number of tile intersections of a view.
    pub(super) max_intersections: usize,
    /// Non-finite gradient values.
    pub(super) non_finite: u64,
    /// Iterations repeated because their tile intersections did not fit.
    pub(super) overflows: u64,
}

/// Trains a scene on a device, with others where it has helpers. Every random number is keyed by (seed, purpose, iteration, index).
pub struct Trainer {
    pub(super) plan: Plan,
    pub(super) schedule: Schedule,
    pub(super) device: Device,
    pub(super) views: Views,
    pub(super) pipeline: Pipeline,
    pub(super) gaussians: GaussianState,
    optimizer: Optimizer,
    pub(super) control: Control,
    pub(super) smoothing: Option<Smoothing>,
    /// Finds Gaussians that no view shows; `None` if they stay.
    pub(super) seen: Option<Program>,
    /// Ring of mean |x − y| and mean SSIM of the last iterations.
    pub(super) losses: Array<f32>,
    pub(super) learned: Learned,
    pub(super) counters: Counters,
    in_flight: VecDeque<InFlight>,
    pub(super) timing: Timing,
    pub(super) iteration: u32,
    pub(super) next: Next,
    /// Ranks that train with this one; `None` alone, and for those that do not lead.
    pub(super) crew: Option<Crew>,
}

/// The error of a set without any.
pub(super) fn no_gaussian() -> Error {
    Error::numerics("train", "no Gaussian to start from")
}

impl Trainer {
    /// Uploads the training views and the Gaussians, builds the kernels of an iteration and runs each once over nothing, so that
    /// no later one waits for a compiler; those of exposure compensation, which is decided on the way, are built then.
    ///
    /// # Errors
    /// A bad configuration, a build failure, or more than the device can allocate.
    pub fn new(
        device: &Device,
        dataset: &Dataset,
        plan: &Plan,
        splats: &Gaussians,
    ) -> Result<Self> {
        let photos = Photos::new(device, dataset.image_budget);
        let views = ViewSet::new(&photos, dataset.train.iter().cloned())?;
        Self::with_views(views, plan, splats)
    }

    /// [`Trainer::new`] with a strategy of density control of the caller's own, at the iterations that the configuration has for its
    /// `sampler`; `max_gaussians` alone bounds it.
    ///
    /// # Errors
    /// See [`Trainer::new`].
    pub fn with_strategy(
        device: &Device,
        dataset: &Dataset,
        plan: &Plan,
        splats: &Gaussians,
        strategy: Arc<dyn DensityControl>,
    ) -> Result<Self> {
        let photos = Photos::new(device, dataset.image_budget);
        let views = ViewSet::new(&photos, dataset.train.iter().cloned())?;
        Self::assemble(views, &plan.clone().without_photo_bound(), splats, strategy)
    }

    /// [`Trainer::new`] with training views whose photos may share their budget with others.
    ///
    /// # Errors
    /// See [`Trainer::new`].
    pub fn with_views(set: ViewSet, plan: &Plan, splats: &Gaussians) -> Result<Self> {
        Self::assemble(set, plan, splats, plan.strategy())
    }

    pub(super) fn assemble(
        set: ViewSet,
        plan: &Plan,
        splats: &Gaussians,
        strategy: Arc<dyn DensityControl>,
    ) -> Result<Self> {
        plan.config.validate()?;
        if splats.is_empty() {
            return Err(no_gaussian());
        }
        if plan.alpha != set.alpha {
            let what = format!(
                "photos with {:?}; the plan is for {:?}",
                set.alpha, plan.alpha
            );
            return Err(Error::config("plan", what));
        }
        let device = &set.photos().device().clone();
        let plan = &plan
            .clone()
            .with_strategy(device.info().kind, strategy.as_ref());
        let (config, degree) = (&plan.config, plan.sh_degree.value);
        let defines = Defines {
            alpha: plan.alpha,
            cull_chunks: config.work.cull_chunks,
            skip_blank: config.work.skip_blank,
            anti_alias: plan.anti_aliasing.value,
            ..Defines::new(device.tuning())
        };
        let kernels = Kernels::new(device, defines);
        let pipeline = Pipeline::new(device, defines, degree, set.largest)?;
        let control = Control::new(&kernels, plan, &pipeline, strategy)?;
        let smoothing = Smoothing::new(&kernels, &set)?;
        let room = capacity(config, splats.len());
        let (rows, kept) = (control.rows(), [smoothing.is_some(), config.batch > 1]);
        let seen = config
            .work
            .remove_unseen
            .then(|| kernels.build::<f32>("seen"));
        let mut trainer = Self {
            gaussians: GaussianState::new(device, splats, room, rows, kept)?,
            views: Views::new(set, plan),
            optimizer: Optimizer::new(&kernels, plan)?,
            schedule: plan.schedule(),
            losses: Array::zeros(device, "losses", 2 * LOSS_RING)?,
            seen: seen.transpose()?,
            plan: plan.clone(),
            device: device.clone(),
            learned: Learned::default(),
            counters: Counters::default(),
            in_flight: VecDeque::new(),
            timing: Timing::new(device),
            iteration: 0,
            next: Next::default(),
            crew: None,
            smoothing,
            pipeline,
            control,
        };
        trainer.warm_up()?;
        let traced = plan.config.trace_density;
        trainer.control.trace = traced.then(|| DensityTrace::new(splats.len()));
        Ok(trainer)
    }

    /// One iteration, enqueued and not waited for; where ranks share the rows, all of it is waited for.
    pub(super) fn iterate(&mut self, iteration: u32, sh_degree: u32) -> Result<()> {
        if self.smoothing_due(iteration) {
            self.smooth()?;
        }
        let view = self.views.at(iteration, self.pipeline.share.as_ref())?;
        let options = self.options(&view, sh_degree);
        let (camera, photo) = (&view.camera, &view.photo);
        self.pipeline
            .enqueue(&self.gaussians.scene, camera, photo, &options)?;

        let pair = self.pipeline.pair(self.views.target(&view))?;
        let lambda = self.plan.config.loss.lambda_ssim;
        let observed = self.control.observed(iteration, self.views.len());
        // Faint Gaussians have statistics, too, and their tiles may be blank: the rounding of SSIM there must not depend on
        // what is skipped.
        let beside = Beside {
            losses: Some((&self.losses, iteration as usize % LOSS_RING)),
            errors: observed.is_some(),
        };
        self.pipeline
            .loss_gradient(view.number, &pair, lambda, beside)?;
        if let Some(first_view) = observed {
            self.control
                .observe(&self.pipeline, &self.gaussians, first_view)?;
        }

        if let Some(exposure) = &self.pipeline.exposure {
            // All ranks take this step alike; the leader counts for them.
            let status = match (&self.crew, &self.pipeline.share) {
                (None, Some(share)) => &share.uncounted,
                _ => &self.pipeline.frame().status,
            };
            exposure.step(view.number, self.transform_step(iteration), status)?;
        }
        self.pipeline.splat_gradient()?;
        for part in 0..self.pipeline.parts() {
            let rows = self.pipeline.take_sums(part, self.gaussians.scene.count)?;
            let at = [iteration, sh_degree];
            self.optimizer
                .step(&self.pipeline, &self.gaussians, at, rows)?;
        }
        self.control
            .perturb(iteration, &self.pipeline, &self.gaussians)?;
        self.pipeline.end_update()
    }

    /// True if the smoothing filter is to be computed before an iteration: a density step that has just ended has done it already.
    pub(super) fn smoothing_due(&self, iteration: u32) -> bool {
        let schedule = &self.schedule;
        let ended =
            schedule.density_due(iteration).is_some() && schedule.density_lag(iteration) == 0;
        Smoothing::due(iteration) && !ended
    }

    fn options(&self, view: &TrainingView, sh_degree: u32) -> RenderOptions {
        RenderOptions {
            sh_degree,
            background: view.background,
            quantity: Quantity::Color,
            active_only: self.plan.alpha == Alpha::Mask,
        }
    }

    pub(super) fn transform_step(&self, iteration: u32) -> Step {
        Step {
            rate: self.schedule.exposure_rate(iteration),
            constants: self.optimizer.constants(),
            t: iteration,
        }
    }

    /// Goes on to the next event: between two iterations everything that is due, one event a call; then an iteration, which
    /// is enqueued, with no more than two others under way.
    ///
    /// If the tile intersections of a view do not fit, the device skips the update and every one after it; the host notices,
    /// makes room and goes back to that iteration, so that the result is the same as if there had been room. Nothing but
    /// [`Event::Iteration`] comes before all iterations so far have settled, so that no other event comes twice.
    ///
    /// # Errors
    /// More than the device can allocate, a photo that cannot be read, or the driver's. After a photo could not be read the next
    /// call tries again.
    pub fn advance(&mut self) -> Result<Event> {
        loop {
            let done = self.iteration >= self.schedule.iterations(self.iteration);
            if done && !matches!(self.next, Next::Density | Next::Pause) {
                let decision = self.finish()?;
                return Ok(decision.map_or(Event::Finished, Event::Decided));
            }
            if let Some(event) = self.advance_once()? {
                return Ok(event);
            }
        }
    }

    /// Advances until `iterations` iterations have settled and everything due after them is done, beyond the end of the
    /// run, too.
    ///
    /// # Errors
    /// See [`Trainer::advance`].
    pub fn advance_to(&mut self, iterations: u32) -> Result<()> {
        loop {
            let due = matches!(self.next, Next::Density | Next::Pause);
            if self.iteration >= iterations && !due {
                return self.settle();
            }
            self.advance_once()?;
        }
    }

    /// Sets the length of the run, in iterations, and the largest size of its photos from the next iteration on; all schedules go by it.
    ///
    /// # Errors
    /// The driver's.
    pub fn set_length(&mut self, iterations: u32, size: TrainingSize) -> Result<()> {
        self.settle()?;
        let from = self.iteration;
        let length = Length {
            from,
            iterations,
            size,
        };
        self.tell([&[LENGTH][..], &words_of_length(&length)].concat())?;
        self.rest();
        self.apply_length(length);
        Ok(())
    }

    pub(super) fn apply_length(&mut self, length: Length) {
        self.plan.set_length(length);
        for schedule in [
            &mut self.schedule,
            &mut self.views.schedule,
            &mut self.control.schedule,
            &mut self.optimizer.schedule,
        ] {
            schedule.set_length(length);
        }
    }

    /// Makes the pause of the last [`Event::Settled`] come again, if it could not be used.
    pub fn repeat_pause(&mut self) {
        self.next = Next::Pause;
    }

    /// True if nothing has been done since the last iteration.
    #[must_use]
    pub fn rested(&self) -> bool {
        self.iteration == 0 || self.next == Next::Pause
    }

    /// True if the run may end here: the births of the last density step have found their places.
    #[must_use]
    pub fn recovered(&self) -> bool {
        self.rested() && self.schedule.recovered(self.iteration)
    }

    /// Does what is next; `None` if nothing is due.
    fn advance_once(&mut self) -> Result<Option<Event>> {
        let at = self.iteration;
        let (event, next) = match self.next {
            Next::Pause if self.schedule.pause_due(at) => {
                self.settle()?;
                (Some(Event::Settled(at)), Next::Density)
            }
            Next::Pause => (None, Next::Density),
            Next::Density => (self.density_step()?, Next::Band),
            Next::Band => {
                self.update_sh_degree()?;
                (None, Next::Exposure)
            }
            Next::Exposure => self.exposure_due()?,
            Next::Compile => {
                self.begin_exposure()?;
                (Some(Event::Compiled), Next::Iterate)
            }
            Next::Iterate => {
                self.enqueue()?;
                let oldest = self.in_flight.front().map(|f| f.iteration);
                let event = Event::Iteration {
                    enqueued: self.iteration,
                    settled: oldest.unwrap_or(self.iteration),
                };
                return Ok(Some(event));
            }
        };
        self.next = next;
        Ok(event)
    }

    /// Enqueues an iteration and settles the oldest if too many are under way.
    fn enqueue(&mut self) -> Result<()> {
        let (at, alone) = (self.iteration, self.in_flight.is_empty());
        if self.schedule.density_lag(at) > 0 {
            self.begin_density_step()?;
        }
        let degree = self.gaussians.scene.sh_degree;
        self.share_iteration(at, degree)?;
        self.timing.begin(at, alone)?;
        self.iterate(at, degree)?;
        self.end_iteration(at);
        let status = &self.pipeline.frame().status;
        self.in_flight.push_back(InFlight {
            iteration: at,
            counters: status.read_later(0, status::SLOTS)?,
            launches: self.timing.end()?,
        });
        self.device.flush()?;
        self.iteration += 1;
        self.next = Next::Pause;
        if self.in_flight.len() > LAG {
            self.settle_oldest()?;
        }
        Ok(())
    }

    fn settle_oldest(&mut self) -> Result<()> {
        let Some(done) = self.in_flight.pop_front() else {
            return Ok(());
        };
        let counters = done.counters.wait()?;
        self.timing.settle(done.launches)?;
        for later in &mut self.in_flight {
            later.launches -= done.launches.min(later.launches);
        }
        let max = &mut self.counters.max_intersections;
        let found = match &self.pipeline.share {
            Some(share) => share.pairs_by_row.iter().map(|[n, _]| *n as usize).sum(),
            None => counters[status::INTERSECTIONS as usize] as usize,
        };
        *max = (*max).max(found);
        let others = self.crew.as_ref().map_or(0, Crew::non_finite);
        self.counters.non_finite = others + u64::from(counters[status::NON_FINITE as usize]);
        let needed = counters[status::OVERFLOW as usize];
        if needed > 0 {
            self.in_flight.clear();
            self.counters.overflows += 1;
            *max = (*max).max(needed as usize);
            // Everything due before that iteration was done before it was enqueued.
            self.iteration = done.iteration;
            self.next = Next::Iterate;
            self.control.take_back(done.iteration);
            self.pipeline.forward.grow_intersections(needed)?;
        }
        Ok(())
    }

    /// Waits until every iteration enqueued so far has truly been done (repeating those that overflowed).
    ///
    /// # Errors
    /// See [`Trainer::advance`].
    pub fn settle(&mut self) -> Result<()> {
        let (goal, next) = (self.iteration, self.next);
        loop {
            while !self.in_flight.is_empty() {
                self.settle_oldest()?;
            }
            if self.iteration >= goal {
                self.next = next;
                return Ok(());
            }
            // Nothing was due between the iterations that are repeated: that would have settled those before it.
            self.enqueue()?;
        }
    }

    /// Adds a band of spherical harmonics if one is due before the next iteration (3DGS).
    fn update_sh_degree(&mut self) -> Result<()> {
        let (at, degree) = (self.iteration, self.gaussians.scene.sh_degree);
        let interval = self.schedule.sh_interval(at);
        // Another length has other multiples: none comes before its number is full.
        let soon = self.schedule.length_from(at) > 0 && degree >= at / interval;
        let due = at > 0 && at.is_multiple_of(interval) && !soon;
        if !due || degree >= self.plan.sh_degree.value {
            return Ok(());
        }
        self.settle()?;
        self.tell(vec![RAISE, degree + 1])?;
        self.rest();
        self.gaussians.raise_sh_degree(&self.device, degree + 1)
    }

    /// Recomputes the smoothing filter from the positions; does nothing without anti-aliasing.
    pub(super) fn smooth(&mut self) -> Result<()> {
        self.controlled().1.smooth()
    }

    /// Makes the buffers fit the Gaussians, the largest image, and the tile intersections so far with a quarter to spare.
    pub(super) fn fit_views(&mut self) -> Result<()> {
        let frame = &mut self.pipeline.forward.frame;
        frame.fit_image(&self.device, self.views.set.largest)?;
        if self.pipeline.share.is_some() {
            // A band makes room for its own Gaussians and pairs.
            return Ok(());
        }
        frame.fit_gaussians(&self.device, self.gaussians.scene.stride)?;
        let max = self.counters.max_intersections;
        let least = 4 * self.gaussians.scene.count.max(1024);
        // A guess after density control: what is truly needed, an overflow tells.
        frame.fit_intersections(&self.device, 0, (max + max / 4).max(least))
    }

    /// Runs every kernel once on no Gaussians, for every SH degree, and sizes the buffers of tile intersections by rendering
    /// each view.
    fn warm_up(&mut self) -> Result<()> {
        let highest = self.plan.sh_degree.value;
        let empty = self.gaussians.empty(&self.device, highest)?;
        let gaussians = std::mem::replace(&mut self.gaussians, empty);
        self.fit_views()?;
        for degree in 0..=highest {
            self.iterate(self.schedule.first_step(), degree)?;
            self.warm_up_control(degree)?;
        }
        self.seen(1)?;
        self.gaussians = self.gaussians.empty(&self.device, highest)?;
        let (control, on) = self.controlled();
        control.warm_up_edits(on)?;
        self.gaussians = gaussians;
        self.fit_views()?;
        self.smooth()?;
        for number in 0..self.views.len() {
            let options = RenderOptions {
                background: self
                    .schedule
                    .background(0, self.plan.random_background.value),
                ..RenderOptions::default()
            };
            let (scene, forward) = (&self.gaussians.scene, &mut self.pipeline.forward);
            forward.render(scene, &self.views.set.cameras[number], &options)?;
            let found = forward
                .frame
                .status
                .read(status::INTERSECTIONS as usize, 1)?[0];
            let max = &mut self.counters.max_intersections;
            *max = (*max).max(found as usize);
        }
        self.fit_views()?;
        self.device.finish()
    }

    fn warm_up_control(&mut self, sh_degree: u32) -> Result<()> {
        let view = self.views.at(0, None)?;
        let (control, mut on) = self.controlled();
        let target = on.views.target(&view);
        control.warm_up(&mut on, target, sh_degree)
    }
}
