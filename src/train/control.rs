//! [`Control`]: density control in the loop. Statistics are gathered on the device, decisions are taken on the host, edits go back.

use std::sync::Arc;
use std::time::Instant;

use crate::base::error::Result;
use crate::base::rng::Stream;
use crate::capture::Alpha;
use crate::capture::photo::colors;
use crate::density::{
    Candidate, DensityControl, DensityStats, ErrorStatistics, NoiseLaw, Outcome, Picture,
    SceneState, ScreenGradient, Statistics, StatisticsKind, StepContext,
};
use crate::device::{Device, Kernels, Program, StageTime};
use crate::pipeline::forward::{Quantity, RenderOptions};
use crate::pipeline::pass::{Pipeline, Target};
use crate::pipeline::stage::loss::ImagePair;
use crate::pipeline::stage::{noise, screen_grad};
use crate::scene::{Plane, morton};
use crate::train::estimates::{Context, Estimates};
use crate::train::gaussians::{GaussianState, Geometry};
use crate::train::noted::Noted;
use crate::train::plan::Plan;
use crate::train::schedule::Schedule;
use crate::train::smoothing::Smoothing;
use crate::train::trace::DensityTrace;
use crate::train::views::Views;

/// Result of one density step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DensityEvent {
    /// Iteration.
    pub iteration: u32,
    /// Progress η.
    pub progress: f64,
    /// Gaussians afterwards.
    pub gaussians: usize,
    /// This step's statistics.
    pub stats: DensityStats,
}

/// Parts of a trainer that a density step changes or reads.
#[derive(Debug)]
pub struct Working<'a> {
    /// Device.
    pub device: &'a Device,
    /// Pipeline of training.
    pub pipeline: &'a mut Pipeline,
    /// Gaussians.
    pub gaussians: &'a mut GaussianState,
    /// Training views.
    pub views: &'a Views,
    /// Smoothing filter, if there is one.
    pub smoothing: Option<&'a Smoothing>,
}

/// Density control with the stages that its strategy needs; the others are not built.
pub struct Control {
    strategy: Arc<dyn DensityControl>,
    plan: Plan,
    pub(super) schedule: Schedule,
    noise: Option<(Program, NoiseLaw)>,
    screen_grad: Option<Program>,
    importance: Option<Program>,
    edit: Program,
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
        let (device, degree) = (kernels.device(), plan.sh_degree.value);
        let defines = *kernels.defines();
        Ok(Self {
            noise: noise.transpose()?,
            screen_grad: screen.transpose()?,
            importance: errors.transpose()?,
            edit: kernels.build::<f32>("edit")?,
            estimates: Estimates::new(device, defines, degree, pipeline, strategy.as_ref())?,
            strategy,
            plan: plan.clone(),
            schedule: Schedule::new(&plan.config),
            stats: DensityStats::default(),
            trace: None,
            noted: None,
            time: StageTime::default(),
        })
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

    /// Time of the estimates, if there are any.
    #[must_use]
    pub fn estimate_time(&self) -> StageTime {
        self.estimates
            .as_ref()
            .map_or_else(StageTime::default, |e| e.time)
    }

    /// Adds the errors of the iteration's render to the statistics if the next density step wants them.
    ///
    /// The last k renders before a step serve as its view subset (\[MH\] Eq. 10), as many as there are since the last step at
    /// most. Training takes the views in random order, so that they are a random subset (of two epochs where one ends
    /// between: a view may then count twice), and no view is rendered for density control alone.
    pub fn observe(
        &self,
        iteration: u32,
        pipeline: &Pipeline,
        gaussians: &GaussianState,
        pair: &ImagePair<'_, f32>,
        views: usize,
    ) -> Result<()> {
        let Some((due, progress)) = self.schedule.next_density(iteration) else {
            return Ok(());
        };
        let StatisticsKind::Errors { views } = self.strategy.wanted(views, progress) else {
            return Ok(());
        };
        let since_last = self.schedule.density_interval(due).min(due);
        let first = due - since_last.min(u32::try_from(views).unwrap_or(u32::MAX));
        // Where the length of the run has changed, gathering begins with it.
        let first = first.max(self.schedule.length_from(iteration));
        if iteration < first {
            return Ok(());
        }
        self.add_errors(pipeline, gaussians, pair, iteration == first)
    }

    fn add_errors(
        &self,
        pipeline: &Pipeline,
        gaussians: &GaussianState,
        pair: &ImagePair<'_, f32>,
        first_view: bool,
    ) -> Result<()> {
        let Some(importance) = &self.importance else {
            return Ok(());
        };
        let (scene, sums) = (&gaussians.scene, &gaussians.statistics);
        pipeline.add_errors(importance, scene, pair, first_view, sums)
    }

    /// The strategy's part of an iteration, after the optimiser: screen-space gradients are added up until the last density
    /// step; noise goes on to the end.
    pub fn perturb(
        &self,
        iteration: u32,
        pipeline: &Pipeline,
        gaussians: &GaussianState,
    ) -> Result<()> {
        let (frame, scene) = (&pipeline.forward.frame, &gaussians.scene);
        if let Some(stage) = &self.screen_grad
            && self.schedule.next_density(iteration).is_some()
        {
            screen_grad::add_norms(stage, scene, frame, &gaussians.statistics)?;
        }
        if let Some((stage, law)) = &self.noise {
            let law = NoiseLaw {
                rate: law.rate * self.schedule.position_rate(iteration),
                ..*law
            };
            let key = [self.plan.config.seed, Stream::Noise.stream(iteration)];
            noise::perturb(stage, scene, frame, &law, key)?;
        }
        Ok(())
    }

    /// Decides from the statistics, edits the Gaussians and puts them in Morton order.
    pub fn step(
        &mut self,
        mut on: Working<'_>,
        iteration: u32,
        progress: f64,
    ) -> Result<DensityEvent> {
        let began = Instant::now();
        let geometry = on.gaussians.geometry()?;
        let outcome = self.decide(&mut on, &geometry, iteration, progress)?;
        let order = self.order(&geometry, &outcome);
        if let Some(trace) = &mut self.trace {
            let logits = geometry.plane(Plane::OPACITY);
            trace.step(iteration, logits, &outcome, order.as_deref());
        }
        if let Some(noted) = &mut self.noted {
            let before = geometry.plane(Plane::OPACITY).len();
            *noted = Noted::new(&outcome, before, order.as_deref());
        }
        self.apply(&mut on, &outcome, order.as_deref())?;
        on.device.finish()?;
        self.time.seconds += began.elapsed().as_secs_f64();
        self.time.calls += 1;
        self.stats.add(&outcome.stats);
        Ok(DensityEvent {
            iteration,
            progress,
            gaussians: on.gaussians.scene.count,
            stats: outcome.stats,
        })
    }

    fn decide(
        &mut self,
        on: &mut Working<'_>,
        geometry: &Geometry,
        iteration: u32,
        progress: f64,
    ) -> Result<Outcome> {
        let state = SceneState {
            positions: std::array::from_fn(|k| geometry.plane(Plane::POSITION + k)),
            log_scales: std::array::from_fn(|k| geometry.plane(Plane::LOG_SCALE + k)),
            rotations: std::array::from_fn(|k| geometry.plane(Plane::ROTATION + k)),
            opacity_logits: geometry.plane(Plane::OPACITY),
        };
        let cameras: Vec<[f32; 3]> = on.views.set.cameras.iter().map(|c| c.center).collect();
        let pictures = self.pictures(on, iteration, progress)?;
        let context = StepContext {
            iteration,
            progress,
            seed: self.plan.config.seed,
            max_gaussians: self.plan.most_gaussians.value,
            opacity_resets: self.schedule.opacity_resets(iteration),
            resets_opacity: self.schedule.resets_opacity(iteration),
            last: self.schedule.next_density(iteration).is_none(),
            before: self.schedule.density_before(iteration),
            cameras: &cameras,
            pictures: &pictures,
        };
        let rows = on.gaussians.read_statistics()?;
        let row = |k: usize| rows.get(k).map_or(&[][..], Vec::as_slice);
        let wanted = self.strategy.wanted(on.views.len(), progress);
        let views: Vec<u32> = match wanted {
            StatisticsKind::Nothing => Vec::new(),
            // The last row counts.
            _ => row(wanted.rows() - 1).iter().map(|v| *v as u32).collect(),
        };
        let evidence = match wanted {
            StatisticsKind::Nothing => Statistics::Nothing,
            StatisticsKind::Errors { .. } => Statistics::Errors(ErrorStatistics {
                ssim: row(0),
                l1: row(1),
                views: &views,
            }),
            StatisticsKind::ScreenGradient => Statistics::ScreenGradient(ScreenGradient {
                norms: row(0),
                views: &views,
            }),
        };
        let strategy = self.strategy.clone();
        let mut estimate = |candidates: &[Candidate]| self.estimate(on, iteration, candidates);
        strategy.step_estimated(&context, &state, &evidence, &mut estimate)
    }

    /// First-order changes of the loss by births; empty if the strategy asks for none.
    pub fn estimate(
        &mut self,
        on: &mut Working<'_>,
        iteration: u32,
        candidates: &[Candidate],
    ) -> Result<Vec<f64>> {
        let lambda = self.plan.config.loss.lambda_ssim;
        match &mut self.estimates {
            Some(estimates) => {
                estimates.changes(context(on, &self.edit, lambda, iteration), candidates)
            }
            None => Ok(Vec::new()),
        }
    }

    fn apply(&self, on: &mut Working<'_>, outcome: &Outcome, order: Option<&[u32]>) -> Result<()> {
        let edits = &outcome.edits;
        let (device, rows) = (on.device, outcome.rows);
        let limit = outcome.logit_limit;
        on.gaussians
            .edit(device, &self.edit, edits, rows, limit, order)?;
        match on.smoothing {
            Some(s) => s.run(&on.gaussians.scene, &on.pipeline.forward.frame),
            None => Ok(()),
        }
    }

    /// Rows that stay, in Morton order if that is wanted: births are appended, wherever they lie. `None` if nothing moves.
    fn order(&self, geometry: &Geometry, outcome: &Outcome) -> Option<Vec<u32>> {
        if !self.plan.config.work.morton_order && outcome.removed.is_empty() {
            return None;
        }
        let mut order = if self.plan.config.work.morton_order {
            let [x, y, z] = geometry.positions_after(&outcome.edits, outcome.rows);
            morton::order([&x, &y, &z])
        } else {
            (0..outcome.rows as u32).collect()
        };
        let removed = &outcome.removed;
        if !removed.is_empty() {
            order.retain(|row| removed.binary_search(row).is_err());
        }
        Some(order)
    }

    /// The views that training takes next, as many as the strategy wants, at the size that they have now. Colour and depth are
    /// rendered: two forward passes a view.
    fn pictures(
        &self,
        on: &mut Working<'_>,
        iteration: u32,
        progress: f64,
    ) -> Result<Vec<Picture>> {
        let count = self.strategy.pictures(progress).min(on.views.len());
        if count == 0 {
            return Ok(Vec::new());
        }
        let views = on.views.upcoming(iteration, count);
        let at = (iteration..).zip(views);
        at.map(|(at, view)| picture(on, iteration, at, view))
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
            self.add_errors(on.pipeline, on.gaussians, &pair, true)?;
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

/// A view as it is at an iteration, over the background of iteration `background_of`.
fn picture(
    on: &mut Working<'_>,
    iteration: u32,
    background_of: u32,
    number: usize,
) -> Result<Picture> {
    let view = on.views.view(iteration, background_of, number, &[])?;
    let (scene, camera) = (&on.gaussians.scene, &view.camera);
    let options = RenderOptions {
        sh_degree: scene.sh_degree,
        background: view.background,
        quantity: Quantity::Color,
        active_only: false,
    };
    let forward = &mut on.pipeline.forward;
    forward.render(scene, camera, &options)?;
    let mut render = forward.read_image()?;
    let by_depth = RenderOptions {
        quantity: Quantity::Depth,
        background: [0.0; 3],
        ..options
    };
    forward.render(scene, camera, &by_depth)?;
    let mut depth = forward.read_image()?.rgb;
    let pixels = render.width * render.height;
    depth.truncate(pixels);
    for (z, left) in depth.iter_mut().zip(&render.transmittance) {
        // Weighted by opacity so far; 0/0 where nothing is.
        *z /= 1.0 - left;
    }
    let alpha = on.views.set.alpha;
    let bytes = on.views.photo(&view).read(0, alpha.planes() * pixels)?;
    // Image space has no birth where the photo has nothing, whatever fog is there.
    let opaque = |i: usize| f32::from(*bytes.get(3 * pixels + i).unwrap_or(&255)) / 255.0;
    let taken = colors(alpha, &bytes, view.background);
    let mut photo = match alpha {
        // What is born has the photo's colour and not that of this iteration's background.
        Alpha::Transparency => colors(Alpha::Mask, &bytes, view.background),
        _ => taken.clone(),
    };
    if let Some(exposure) = &on.pipeline.exposure {
        exposure.exchange(number, &mut render.rgb, &mut photo)?;
    }
    let error = |i: usize| -> f32 {
        let apart = |c: usize| (render.rgb[c * pixels + i] - taken[c][i]).abs();
        opaque(i) * (0..3).map(apart).sum::<f32>() / 3.0
    };
    let masked = match alpha {
        Alpha::Mask => (0..pixels).map(|i| opaque(i) < 0.5).collect(),
        _ => Vec::new(),
    };
    Ok(Picture {
        width: render.width,
        intrinsics: camera.intrinsics,
        rotation: camera.w,
        center: camera.center,
        error: (0..pixels).map(error).collect(),
        photo,
        depth,
        transmittance: render.transmittance,
        masked,
    })
}
