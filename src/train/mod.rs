//! [`Trainer`]: one iteration after the other, as the paper's loop.

mod bands;
pub mod brightness;
mod control;
mod exposure;
mod filter;
mod finish;
mod observe;
mod overflow;
mod pictures;
pub mod plan;
mod probe;
mod sampler;
pub mod sampling_rates;
pub mod schedule;
mod state;
mod warm_up;

pub use crate::train::bands::{BAND_WORTH, BandTrial, Bands, SET_ASIDE_EVERY, TRIAL_WORTH};
pub use crate::train::control::DensityEvent;
pub use crate::train::finish::Findings;
pub use crate::train::state::TrainerState;

use std::collections::VecDeque;

use crate::base::error::{Error, Result};
use crate::capture::{Alpha, Dataset};
use crate::config::TrainConfig;
use crate::density;
use crate::density::{DensityControl, DensityStats};
use crate::device::tuning::status;
use crate::device::{Array, CameraArg, Defines, Device, Kernels, StageTime};
use crate::pipeline::backward::Pass;
use crate::pipeline::buffers::{Blank, Scene, ViewSet};
use crate::pipeline::forward::{Quantity, RenderOptions, Renderer};
use crate::pipeline::photos::{AHEAD, Photos};
use crate::pipeline::stage::adam::{Adam, AdamArgs};
use crate::pipeline::stage::edit::Edit;
use crate::pipeline::stage::live::Live;
use crate::pipeline::stage::loss::Loss;
use crate::pipeline::stage::project_grad::{ProjectGrad, ProjectGradArgs};
use crate::pipeline::stage::shrink::Shrink;
use crate::pipeline::stage::splat_grad::SplatGrad;
use crate::scene::{Plane, Splats};
use crate::train::brightness::{Decision, check as check_exposure};
use crate::train::exposure::Compensation;
use crate::train::filter::FilterStage;
use crate::train::finish::Judge;
use crate::train::overflow::InFlight;
use crate::train::sampler::SamplerStages;
use crate::train::sampling_rates::AntiAlias;
use crate::train::schedule::Schedule;

/// Iterations that may be on their way to the device before the host looks at the counters of the oldest.
const LAG: usize = 2;
/// Losses kept on the device.
const LOSS_RING: usize = 256;

/// Whether photos are ever shrunk; see [`Schedule::shrink_factor`].
fn coarse_first(config: &TrainConfig) -> bool {
    config.work.resolution_levels > 0 && config.time_budget.is_none()
}

/// Room for a photo at half its size, if the configuration ever asks for one.
fn small_photo(device: &Device, views: &ViewSet, config: &TrainConfig) -> Result<Array<u8>> {
    let pixels = if coarse_first(config) {
        (views.largest[0] / 2) * (views.largest[1] / 2)
    } else {
        0
    };
    let planes = views.alpha.planes();
    Array::zeros(device, "small", planes * pixels)
}

fn shrink_stage(kernels: &Kernels, config: &TrainConfig) -> Result<Option<Shrink>> {
    let stage = coarse_first(config).then(|| Shrink::new::<f32>(kernels));
    stage.transpose()
}

fn defines(device: &Device, views: &ViewSet, config: &TrainConfig, anti_alias: bool) -> Defines {
    Defines {
        alpha: views.alpha,
        cull_chunks: config.work.cull_chunks,
        skip_blank: config.work.skip_blank,
        anti_alias,
        ..Defines::new(device.tuning())
    }
}

fn check(config: &TrainConfig, views: &ViewSet, splats: &Splats) -> Result<()> {
    config.validate()?;
    check_exposure(config.exposure, views.alpha)?;
    if splats.is_empty() {
        return Err(Error::Numerics {
            stage: "train".into(),
            what: "no Gaussian to start from".into(),
        });
    }
    Ok(())
}

/// What is counted over a run.
#[derive(Debug, Default)]
struct Tally {
    stats: DensityStats,
    /// Time that density steps took on the host, their transfers and edits included.
    density_time: StageTime,
    /// Of that, what probes took.
    probe_time: StageTime,
    most_pairs: usize,
    non_finite: u64,
    overflows: u64,
}

/// Trains a scene on one device. Every random number is keyed by (seed, purpose, iteration, index).
pub struct Trainer {
    config: TrainConfig,
    schedule: Schedule,
    device: Device,
    views: ViewSet,
    scene: Scene,
    grads: Array<f32>,
    moment1: Array<f32>,
    moment2: Array<f32>,
    renderer: Renderer,
    /// Where coarse photos come first.
    shrink: Option<Shrink>,
    /// Where photos have masks or are transparent: tiles in which nothing counts get no pairs, and what is blank no loss.
    live: Option<Live>,
    loss: Loss,
    splat_grad: SplatGrad,
    project_grad: Vec<ProjectGrad>,
    adam: Adam,
    edit: Edit,
    maps: Array<f32>,
    /// A photo at a fraction of its size.
    small: Array<u8>,
    judge: Judge,
    findings: Findings,
    dimage: Array<f32>,
    partial: Array<f32>,
    losses: Array<f32>,
    cues: Array<f32>,
    density: Box<dyn DensityControl>,
    /// Renders probes; none where density control tries no birth.
    probes: Option<Pass<f32>>,
    sampler: SamplerStages,
    /// Keeps the 3D filter; none without anti-aliasing.
    filter: Option<FilterStage>,
    /// Per-image exposure, where it is on.
    exposure: Option<Compensation>,
    exposure_decision: Option<Decision>,
    tally: Tally,
    in_flight: VecDeque<InFlight>,
    iteration: u32,
    /// Iterations done when density control last acted: repeating an iteration must not repeat that.
    last_density: Option<u32>,
}

impl Trainer {
    /// Uploads the training views and the scene, builds the kernels of an iteration and runs each once over nothing, so that no
    /// later one waits for a compiler; those of per-image exposure, which is decided on the way, are built then.
    ///
    /// # Errors
    /// A bad configuration, a build failure, or more than the device can allocate.
    pub fn new(
        device: &Device,
        dataset: &Dataset,
        config: &TrainConfig,
        splats: &Splats,
    ) -> Result<Self> {
        let photos = Photos::new(device, dataset.image_budget);
        let views = ViewSet::new(&photos, dataset.train.iter().cloned())?;
        let anti_alias = AntiAlias::decide(dataset, config).on;
        Self::with_views(views, config, splats, anti_alias)
    }

    /// As [`Trainer::new`], with training views whose photos may share their budget with others, and with the decision on
    /// anti-aliasing taken.
    ///
    /// # Errors
    /// As [`Trainer::new`].
    #[doc(hidden)]
    pub fn with_views(
        views: ViewSet,
        config: &TrainConfig,
        splats: &Splats,
        anti_alias: bool,
    ) -> Result<Self> {
        let device = &views.photos().device().clone();
        check(config, &views, splats)?;
        let (tuning, degree) = (device.tuning(), config.sh_degree);
        let defines = defines(device, &views, config, anti_alias);
        let kernels = Kernels::new(device, defines);
        let scene = Scene::upload(device, splats, sampler::capacity(config, splats.len()))?;
        let (scene, filter) = filter::stage(&kernels, scene, &views)?;
        let density = density::make(config);
        let sampler = SamplerStages::new(&kernels, density.as_ref())?;
        let loss = Loss::new::<f32>(&kernels)?;
        let [w, h] = views.largest;
        let plane = w.next_multiple_of(16) * h.next_multiple_of(16);
        let state = |name| Array::zeros(device, name, scene.planes() * scene.stride);
        let mut trainer = Self {
            schedule: Schedule::new(config),
            device: device.clone(),
            grads: Array::zeros(device, "grads", Plane::count(degree) * tuning.update_block)?,
            moment1: state("moment1")?,
            moment2: state("moment2")?,
            renderer: Renderer::new(device, defines, degree, true)?,
            splat_grad: SplatGrad::new::<f32>(&kernels)?,
            project_grad: warm_up::project_grad_per_degree(device, defines, degree)?,
            adam: Adam::new::<f32>(&kernels)?,
            edit: Edit::new::<f32>(&kernels)?,
            live: Live::if_asked::<f32>(&kernels)?,
            shrink: shrink_stage(&kernels, config)?,
            judge: Judge::new(&kernels, h, config)?,
            findings: Findings::default(),
            small: small_photo(device, &views, config)?,
            maps: Array::zeros(device, "maps", 3 * plane)?,
            dimage: Array::zeros(device, "dimage", 3 * plane)?,
            partial: Array::zeros(device, "partial", loss.partial_len(w, h))?,
            losses: Array::zeros(device, "losses", 2 * LOSS_RING)?,
            cues: sampler.cues(device, scene.stride)?,
            probes: probe::pass(device, defines, degree, density.as_ref())?,
            density,
            sampler,
            filter,
            exposure: None,
            exposure_decision: None,
            tally: Tally::default(),
            in_flight: VecDeque::new(),
            iteration: 0,
            last_density: None,
            config: config.clone(),
            views,
            scene,
            loss,
        };
        trainer.warm_up()?;
        Ok(trainer)
    }

    /// Makes the arrays fit the scene, the largest image, and the pairs seen so far with a quarter to spare.
    fn fit_views(&mut self) -> Result<()> {
        self.renderer
            .frame
            .fit_gaussians(&self.device, self.scene.stride)?;
        self.renderer
            .frame
            .fit_image(&self.device, &self.views.largest_camera)?;
        let pairs =
            (self.tally.most_pairs + self.tally.most_pairs / 4).max(4 * self.scene.count.max(1024));
        self.renderer.frame.fit_pairs(&self.device, pairs)
    }

    /// Whether the training photos are.
    fn transparent(&self) -> bool {
        self.views.alpha == Alpha::Transparency
    }

    fn options(&self, iteration: u32, sh_degree: u32) -> RenderOptions {
        RenderOptions {
            sh_degree,
            background: self.schedule.background(iteration, self.transparent()),
            quantity: Quantity::Color,
            live_only: false,
        }
    }

    /// Forward, loss, backward and optimiser of one iteration, without waiting.
    fn enqueue_step(&mut self, iteration: u32, degree: u32) -> Result<()> {
        let order = self.upcoming(iteration, 1 + AHEAD);
        let view = order[0];
        self.filter_at(iteration)?;
        let photo = self.views.photo(view, &order[1..])?;
        let (camera, factor) = self.camera_at(iteration, view);
        let options = self.options(iteration, degree);
        self.shrink_photo(&photo, view, factor)?;
        if let Some(live) = &self.live {
            let photo = self.at_size(&photo, factor);
            live.run(photo, &camera, self.renderer.live_tiles())?;
        }
        let live_only = self.views.alpha == Alpha::Mask;
        let render = RenderOptions {
            live_only,
            ..options
        };
        self.renderer.enqueue(&self.scene, &camera, &render)?;

        let photo = self.at_size(&photo, factor);
        let mut pair = self.pair(view, &camera, photo, options.background)?;
        pair.blank = self.blank();
        self.loss_gradient(view, &pair)?;
        self.loss.sum(
            &pair,
            &self.partial,
            &self.losses,
            iteration as usize % LOSS_RING,
        )?;
        // Cues are of faint Gaussians, too, whose tiles may be blank: the rounding of SSIM there must not depend on what is skipped.
        pair.blank = None;
        self.watch(iteration, &camera, &pair)?;
        self.step_exposure(iteration, view)?;

        let frame = &self.renderer.frame;
        self.splat_grad
            .run(&self.renderer.lists(&camera), &self.dimage, &frame.sums)?;
        self.update(iteration, degree, &camera)?;
        self.sample(iteration, &camera)
    }

    /// Where render and photo are blank, if that is skipped. A transform of exposure would change what is clear; it is refused
    /// for transparent photos.
    fn blank(&self) -> Option<Blank<'_>> {
        let skipped = self.live.is_some() && self.config.work.skip_blank;
        skipped.then(|| self.renderer.frame.blank())
    }

    /// Gradients of the parameters and the optimiser's step, block by block: a block's gradients are used while they are
    /// still in cache.
    fn update(&self, iteration: u32, degree: u32, camera: &CameraArg<f32>) -> Result<()> {
        let (frame, count) = (&self.renderer.frame, self.scene.count);
        let grad_stride = self.device.tuning().update_block;
        let o = &self.config.optimizer;
        // Once for no Gaussians, too: warming up builds the kernels so.
        for first in (0..count.max(1)).step_by(grad_stride) {
            let block = first..count.min(first + grad_stride);
            self.project_grad[degree as usize].run(&ProjectGradArgs {
                params: &self.scene.params,
                stride: self.scene.stride,
                count,
                filter: &self.scene.filter,
                camera,
                pair_start: &frame.pair_start,
                pair_counts: &frame.pair_counts,
                status: &frame.status,
                sums: &frame.sums,
                lambda_opacity: self.config.loss.lambda_opacity,
                lambda_scale: self.config.loss.lambda_scale,
                block: block.clone(),
                grad_stride,
                grads: &self.grads,
            })?;
            self.adam.run(&AdamArgs {
                grads: &self.grads,
                grad_stride,
                block,
                stride: self.scene.stride,
                planes: Plane::count(degree),
                rates: self.schedule.rates(iteration),
                constants: [o.beta1, o.beta2, o.epsilon],
                step: iteration + 1,
                params: &self.scene.params,
                moment1: &self.moment1,
                moment2: &self.moment2,
                status: &frame.status,
            })?;
        }
        Ok(())
    }

    /// One iteration; returns as soon as it is enqueued and no more than two others are under way.
    ///
    /// Where the pairs of a view do not fit, the device skips the update and every one after it; the host notices,
    /// makes room and goes back to that iteration, so that the result is the same as if there had been room.
    ///
    /// # Errors
    /// More than the device can allocate, or the driver's.
    pub fn step(&mut self) -> Result<()> {
        if self.prepare()? {
            self.build_exposure()?;
        }
        self.enqueue_step(self.iteration, self.scene.sh_degree)?;
        self.in_flight.push_back(InFlight {
            iteration: self.iteration,
            counters: self.renderer.frame.status.read_later(0, status::SLOTS)?,
            launches: self.device.launches(),
        });
        self.device.flush()?;
        self.iteration += 1;
        if self.in_flight.len() > LAG {
            self.settle_oldest()?;
        }
        Ok(())
    }
}
