//! [`Control`]: density control in the loop. Statistics are gathered on the device, decisions are taken on the host, edits go back.

use std::sync::Arc;
use std::time::Instant;

use crate::base::error::Result;
use crate::base::rng::Stream;
use crate::density::{
    DensityControl, DensityStats, Edit, NoiseLaw, Outcome, StatisticsKind, StepContext,
};
use crate::device::tuning::status;
use crate::device::{Kernels, Program, StageTime};
use crate::pipeline::pass::{Pipeline, Target};
use crate::pipeline::stage::morton::{Morton, Order};
use crate::pipeline::stage::photo_error::PhotoErrors;
use crate::pipeline::stage::{noise, screen_grad};
use crate::scene::{self, Plane};
use crate::train::decision::{Deciding, Decision, Evidence, PendingStep};
use crate::train::estimates::{Context, Estimates};
use crate::train::gaussians::{Carried, GaussianState};
use crate::train::moves;
use crate::train::noted::Noted;
use crate::train::picture::PendingPicture;
use crate::train::plan::Plan;
use crate::train::schedule::Schedule;
use crate::train::trace::DensityTrace;
use crate::train::views::Views;
use crate::train::working::Working;

/// Result of one density step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DensityEvent {
    /// Iterations done when it began.
    pub iteration: u32,
    /// Progress η.
    pub progress: f64,
    /// Gaussians afterwards.
    pub gaussians: usize,
    /// This step's statistics.
    pub stats: DensityStats,
}

/// Density control with the stages that its strategy needs; the others are not built.
pub struct Control {
    strategy: Arc<dyn DensityControl>,
    plan: Plan,
    pub(super) schedule: Schedule,
    noise: Option<(Program, NoiseLaw)>,
    screen_grad: Option<Program>,
    importance: Option<Program>,
    /// Errors of pictures, if the strategy ever asks for one.
    photo_errors: Option<PhotoErrors<f32>>,
    edit: Program,
    morton: Morton,
    /// The step that has begun and not ended.
    pub(super) deciding: Option<Deciding>,
    /// First-order estimates of births, if the strategy asks for them.
    estimates: Option<Estimates>,
    /// Statistics over the run.
    pub stats: DensityStats,
    /// Fate of every Gaussian, if the configuration asks for it.
    pub trace: Option<DensityTrace>,
    /// Findings of the last step; `None` if nobody asks for them.
    pub noted: Option<Noted>,
    /// Time of the steps on the host, with their transfers and edits.
    pub time: StageTime,
    /// Time of their decisions alone.
    pub decisions: StageTime,
}

impl Control {
    /// Builds the stages that the strategy needs.
    pub fn new(
        kernels: &Kernels,
        plan: &Plan,
        pipeline: &Pipeline,
        strategy: Arc<dyn DensityControl>,
    ) -> Result<Self> {
        let wanted = strategy.wanted(1, 1.0);
        let noise = strategy.noise().map(|law| {
            let stage = kernels.build::<f32>("noise")?;
            Ok((stage, law))
        });
        let screen =
            (wanted == StatisticsKind::ScreenGradient).then(|| kernels.build::<f32>("screen_grad"));
        let errors = matches!(wanted, StatisticsKind::Errors { .. })
            .then(|| kernels.build::<f32>("importance"));
        let pictures = (strategy.pictures(1.0) > 0).then(|| PhotoErrors::new(kernels));
        let (device, degree) = (kernels.device(), plan.sh_degree.value);
        let defines = *kernels.defines();
        Ok(Self {
            noise: noise.transpose()?,
            screen_grad: screen.transpose()?,
            importance: errors.transpose()?,
            photo_errors: pictures.transpose()?,
            edit: kernels.build::<f32>("edit")?,
            morton: Morton::new::<f32>(kernels)?,
            deciding: None,
            estimates: Estimates::new(device, defines, degree, pipeline, strategy.as_ref())?,
            strategy,
            plan: plan.clone(),
            schedule: plan.schedule(),
            stats: DensityStats::default(),
            trace: None,
            noted: None,
            time: StageTime::default(),
            decisions: StageTime::default(),
        })
    }

    /// The strategy.
    #[must_use]
    pub fn strategy(&self) -> Arc<dyn DensityControl> {
        self.strategy.clone()
    }

    /// True if births are estimated before a step is decided, which takes all Gaussians on one device.
    #[must_use]
    pub fn estimates_births(&self) -> bool {
        self.estimates.is_some()
    }

    /// Rows of statistics that the strategy wants gathered.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.strategy.wanted(1, 1.0).rows()
    }

    /// Kernels of `edit.cl`, which write and reorder rows.
    #[must_use]
    pub fn edit(&self) -> &Program {
        &self.edit
    }

    /// Runs the kernels of a step's begin and end once, on a Gaussian of no meaning.
    pub fn warm_up_edits(&self, mut on: Working<'_>) -> Result<()> {
        let outcome = Outcome {
            edits: vec![scene::Edit::default()],
            rows: 1,
            logit_limit: Some(0.0),
            removed: vec![0],
            ..Outcome::default()
        };
        self.apply(&mut on, &outcome, None)?;
        let snapshot = on.gaussians.snapshot(on.device, &self.edit)?;
        snapshot.wait().map(|_| ())
    }

    /// Time of the estimates, if there are any.
    #[must_use]
    pub fn estimate_time(&self) -> StageTime {
        self.estimates
            .as_ref()
            .map_or_else(StageTime::default, |e| e.time)
    }

    /// Says if the next density step wants the errors of an iteration's render in the statistics, and if those begin with it.
    ///
    /// The last k renders before a step serve as its view subset (\[MH\] Eq. 10), as many as there are since the last step at
    /// most. Training takes the views in random order, so that they are a random subset (of two epochs where one ends
    /// between: a view may then count twice), and no view is rendered for density control alone.
    pub fn observed(&self, iteration: u32, views: usize) -> Option<bool> {
        self.importance.as_ref()?;
        let (due, progress) = self.schedule.next_density(iteration)?;
        let StatisticsKind::Errors { views } = self.strategy.wanted(views, progress) else {
            return None;
        };
        let since_last = self.schedule.density_interval(due).min(due);
        let first = due - since_last.min(u32::try_from(views).unwrap_or(u32::MAX));
        // Where the length of the run has changed, gathering begins with it; before the step before has ended, rows are others.
        let before = due - since_last;
        let first = first
            .max(self.schedule.length_from(iteration))
            .max(before + self.schedule.density_lag(before));
        (iteration >= first).then_some(iteration == first)
    }

    /// Adds the errors that were wanted last to the statistics, which `first_view` starts anew.
    pub fn observe(
        &self,
        pipeline: &Pipeline,
        gaussians: &GaussianState,
        first_view: bool,
    ) -> Result<()> {
        let Some(importance) = &self.importance else {
            return Ok(());
        };
        let (scene, sums) = (&gaussians.scene, &gaussians.statistics);
        pipeline.add_errors(importance, scene, first_view, sums)
    }

    /// The strategy's part of an iteration, after the optimiser: screen-space gradients are added up until the last density
    /// step; noise goes on to the end, with the steps of the optimiser.
    pub fn perturb(
        &self,
        iteration: u32,
        pipeline: &Pipeline,
        gaussians: &GaussianState,
    ) -> Result<()> {
        let (frame, scene) = (pipeline.frame(), &gaussians.scene);
        if let Some(stage) = &self.screen_grad
            && self.schedule.next_density(iteration).is_some()
        {
            screen_grad::add_norms(stage, scene, frame, &gaussians.statistics)?;
        }
        if let Some((stage, law)) = &self.noise
            && self.schedule.step_of(iteration).is_some()
        {
            let law = NoiseLaw {
                rate: law.rate * self.schedule.position_rate(iteration),
                ..*law
            };
            let key = [self.plan.config.seed, Stream::Noise.stream(iteration)];
            noise::perturb(stage, scene, frame, &law, key)?;
        }
        Ok(())
    }

    /// Begins a density step: enqueues the transfer of what the strategy decides from. The step ends after `lag` iterations more, and the
    /// decision is taken meanwhile; with a lag of 0 it is taken before this returns.
    ///
    /// # Errors
    /// A photo that cannot be read, no room, no thread, the strategy's or the driver's.
    pub fn begin(
        &mut self,
        mut on: Working<'_>,
        iteration: u32,
        progress: f64,
        lag: u32,
    ) -> Result<()> {
        let began = Instant::now();
        let on = &mut on;
        let deciding = match lag {
            0 => {
                let evidence = self.fitting_evidence(on, iteration, progress)?;
                let strategy = self.strategy.clone();
                let mut estimate = |born: &[Edit]| self.estimate(on, iteration, born);
                let decision = evidence.decide(strategy.as_ref(), &mut estimate)?;
                Deciding::decided([iteration; 2], progress, decision)
            }
            _ => {
                let evidence = self.evidence(on, iteration, progress)?;
                on.device.flush()?;
                Deciding::begin(evidence, self.strategy.clone(), iteration + lag)?
            }
        };
        self.deciding = Some(deciding);
        self.time.seconds += began.elapsed().as_secs_f64();
        Ok(())
    }

    /// Ends the density step that has begun: edits the Gaussians and puts them in Morton order. `None` if none has. Where ranks share the
    /// rows, `division` has the first row of each afterwards, and the number of all.
    ///
    /// # Errors
    /// The strategy's, ranks that have decided differently, another rank's failure, no room, or the driver's. The step is lost then:
    /// training goes on from a checkpoint.
    pub fn end(
        &mut self,
        mut on: Working<'_>,
        division: Option<&[usize]>,
    ) -> Result<Option<DensityEvent>> {
        let Some(deciding) = self.deciding.take() else {
            return Ok(None);
        };
        let began = Instant::now();
        let (iteration, progress) = (deciding.begun, deciding.progress);
        let Decision {
            outcome,
            before,
            seconds,
        } = deciding.wait()?;
        self.decisions.seconds += seconds;
        self.decisions.calls += 1;
        let rows = on.gaussians.scene.all();
        let order = self.apply(&mut on, &outcome, division)?;
        if let (Some(trace), Some(before)) = (&mut self.trace, &before) {
            let logits = before.plane(Plane::OPACITY);
            trace.step(iteration, logits, &outcome, order.as_deref());
        }
        if let Some(noted) = &mut self.noted {
            *noted = Noted::new(&outcome, rows, order.as_deref());
        }
        on.device.finish()?;
        self.time.seconds += began.elapsed().as_secs_f64();
        self.time.calls += 1;
        self.stats.add(&outcome.stats);
        Ok(Some(DensityEvent {
            iteration,
            progress,
            gaussians: on.gaussians.scene.all(),
            stats: outcome.stats,
        }))
    }

    /// Takes a step back that began after so many iterations or later, because they are repeated.
    pub fn take_back(&mut self, iterations: u32) {
        self.deciding.take_if(|step| step.begun >= iterations);
    }

    /// The step that has begun, decided, for a checkpoint.
    ///
    /// # Errors
    /// See [`Control::end`].
    pub fn settle(&mut self) -> Result<Option<PendingStep>> {
        self.deciding.as_mut().map(Deciding::pending).transpose()
    }

    /// Goes on with the step of a checkpoint, or with none.
    pub fn restore(&mut self, step: Option<&PendingStep>) {
        self.deciding = step.map(Deciding::from);
    }

    /// The evidence of a step; repeated with more room until the pairs of its pictures fit.
    fn fitting_evidence(
        &self,
        on: &mut Working<'_>,
        iteration: u32,
        progress: f64,
    ) -> Result<Evidence> {
        loop {
            let evidence = self.evidence(on, iteration, progress)?;
            let forward = &mut on.pipeline.forward;
            let slot = status::OVERFLOW as usize;
            match forward.frame.status.read(slot, 1)?[0] {
                0 => return Ok(evidence),
                needed => forward.grow_intersections(needed)?,
            }
        }
    }

    /// Enqueues the transfers of what a step decides from.
    fn evidence(&self, on: &mut Working<'_>, iteration: u32, progress: f64) -> Result<Evidence> {
        let mut snapshot = on.gaussians.snapshot(on.device, &self.edit)?;
        if let Some(share) = &on.pipeline.share {
            snapshot = snapshot.of_all(share)?;
        }
        Ok(Evidence {
            context: StepContext {
                iteration,
                progress,
                seed: self.plan.config.seed,
                max_gaussians: self.plan.most_gaussians.value,
                opacity_resets: self.schedule.opacity_resets(iteration),
                resets_opacity: self.schedule.resets_opacity(iteration),
                last: self.schedule.next_density(iteration).is_none(),
                before: self.schedule.density_before(iteration),
                spacing: self.schedule.density_spacing(iteration),
                cameras: &[],
                pictures: &[],
            },
            cameras: on.views.set.cameras.iter().map(|c| c.center).collect(),
            clearance: self.plan.clearance.value.clone(),
            snapshot,
            wanted: self.strategy.wanted(on.views.len(), progress),
            pictures: self.pictures(on, iteration, progress)?,
        })
    }

    /// First-order changes of the loss by births; empty if the strategy asks for none.
    pub fn estimate(
        &mut self,
        on: &mut Working<'_>,
        iteration: u32,
        births: &[Edit],
    ) -> Result<Vec<f64>> {
        let lambda = self.plan.config.loss.lambda_ssim;
        match &mut self.estimates {
            Some(estimates) => {
                estimates.changes(context(on, &self.edit, lambda, iteration), births)
            }
            None => Ok(Vec::new()),
        }
    }

    /// Applies an outcome, and has the rows that stay in Morton order if that is wanted: births are appended, wherever they lie. Gives the
    /// order back where somebody asks for it; `None`, too, if nothing moves.
    fn apply(
        &self,
        on: &mut Working<'_>,
        outcome: &Outcome,
        division: Option<&[usize]>,
    ) -> Result<Option<Vec<u32>>> {
        let known = match (&on.pipeline.share, division) {
            (Some(share), Some(division)) => {
                let order = self.morton_order().unwrap_or(Order::Kept);
                let gaussians = (on.device, &mut *on.gaussians, &self.edit);
                Some(moves::apply(share, gaussians, outcome, (order, division))?)
            }
            _ => self.apply_alone(on, outcome)?,
        };
        on.smooth()?;
        Ok(known)
    }

    /// Morton order, if that is wanted.
    fn morton_order(&self) -> Option<Order> {
        let ordered = self.plan.config.work.morton_order;
        ordered.then_some(Order::Morton { up: self.plan.up })
    }

    /// [`Control::apply`] to all Gaussians on this device, without the smoothing filter.
    fn apply_alone(&self, on: &mut Working<'_>, outcome: &Outcome) -> Result<Option<Vec<u32>>> {
        let (device, rows, removed) = (on.device, outcome.rows, &outcome.removed);
        let limit = outcome.logit_limit;
        on.gaussians
            .edit(device, &self.edit, &outcome.edits, rows, limit)?;
        let kept = (!removed.is_empty()).then_some(Order::Kept);
        let order = self.morton_order().or(kept);
        let mut known = None;
        if let Some(order) = order {
            let (forward, scene) = (&mut on.pipeline.forward, &on.gaussians.scene);
            let sorted = forward.sort_rows(&self.morton, scene, removed, order)?;
            let kept = (sorted, outcome.gaussians());
            on.gaussians
                .reorder(device, &self.edit, kept, Carried::Optimized)?;
            if self.trace.is_some() || self.noted.is_some() {
                known = Some(sorted.read(0, outcome.gaussians())?);
            }
        }
        Ok(known)
    }

    /// Numbers of the views that a step wants rendered: those that training takes next.
    #[must_use]
    pub fn pictured(&self, views: &Views, iteration: u32, progress: f64) -> Vec<usize> {
        let count = self.strategy.pictures(progress).min(views.len());
        views.upcoming(iteration, count)
    }

    /// The views that the strategy wants rendered, at the size that they have now.
    fn pictures(
        &self,
        on: &mut Working<'_>,
        iteration: u32,
        progress: f64,
    ) -> Result<Vec<PendingPicture>> {
        let Some(errors) = &self.photo_errors else {
            return Ok(Vec::new());
        };
        let views = self.pictured(on.views, iteration, progress);
        (iteration..)
            .zip(views)
            .map(|(at, view)| PendingPicture::enqueue(on, errors, iteration, at, view))
            .collect()
    }

    /// Runs the kernels once that do not run in every iteration: errors, edits and estimates.
    pub fn warm_up(
        &mut self,
        on: &mut Working<'_>,
        target: Target<'_>,
        sh_degree: u32,
    ) -> Result<()> {
        if self.importance.is_some() {
            let pair = on.pipeline.pair(target)?.everywhere();
            on.pipeline.errors(&pair)?;
            self.observe(on.pipeline, on.gaussians, true)?;
        }
        let lambda = self.plan.config.loss.lambda_ssim;
        if let Some(estimates) = &mut self.estimates {
            estimates.warm_up(context(on, &self.edit, lambda, 0), sh_degree)?;
        }
        Ok(())
    }
}

fn context<'a>(
    on: &'a mut Working<'_>,
    edit: &'a Program,
    lambda_ssim: f64,
    iteration: u32,
) -> Context<'a> {
    Context {
        device: on.device,
        pipeline: on.pipeline,
        gaussians: on.gaussians,
        views: on.views,
        smoothing: on.smoothing,
        edit,
        lambda_ssim,
        iteration,
    }
}
