//! The check of the importance and of the first-order estimate on a run's checkpoint.

use std::path::Path;

use serde::Serialize;

use crate::base::constants::ALPHA_MIN;
use crate::base::error::{Error, Result};
use crate::base::rng::{Philox, Stream};
use crate::capture::Dataset;
use crate::density::mh::importance::importance;
use crate::device::{Device, Real};
use crate::lab::surrogate::births::{Birth, Candidate, FORMS, Ground};
use crate::lab::surrogate::instrument::{Base, Instrument, Setting};
use crate::lab::surrogate::rank::{FormOutcome, of_form};
use crate::pipeline::buffers::ViewSet;
use crate::pipeline::forward::{Quantity, RenderOptions};
use crate::pipeline::photos::Photos;
use crate::run::checkpoint;
use crate::run::checkpoint::Checkpoint;
use crate::scene::Plane;
use crate::train::estimates::{EPSILON_DOUBLE, EPSILON_SINGLE};
use crate::train::schedule::Schedule;

/// Size and seed of a check.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Options {
    /// Births to try, half of them drawn as the sampler proposes, half evenly over the importance.
    pub candidates: u32,
    /// Training views over which the loss is taken.
    pub views: u32,
    /// Seed of views, candidates and bootstrap.
    pub seed: u64,
}

/// Result of a check.
#[derive(Debug, Clone, Serialize)]
pub struct Assessment {
    /// Version of this package.
    pub version: &'static str,
    /// Run folder.
    pub run: String,
    /// Dataset.
    pub dataset: String,
    /// Largest width and height of the views, pixels.
    pub size: [usize; 2],
    /// Iterations done, and those of the whole run.
    pub iterations: [u32; 2],
    /// Progress η of density control.
    pub progress: f64,
    /// Gaussians.
    pub gaussians: usize,
    /// Names of the views.
    pub views: Vec<String>,
    /// Seed.
    pub seed: u64,
    /// OpenCL device.
    pub device: String,
    /// Precision of the kernels, bits.
    pub bits: u32,
    /// Mean loss over the views.
    pub loss: f64,
    /// Candidates that no view sees in any pixel; they are left out of everything below.
    pub unseen: usize,
    /// Statistics of each of [`FORMS`].
    pub forms: [FormOutcome; FORMS.len()],
    /// The candidates.
    pub candidates: Vec<Candidate>,
}

/// Checks importance and first-order estimate on the checkpoint in the folder `run`, trained on `dataset`. `progress` receives
/// the numbers of births done and of all births.
///
/// # Errors
/// No usable checkpoint, another dataset, or the device's.
pub fn check(
    run: &Path,
    dataset: Dataset,
    device: &Device,
    options: &Options,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<Assessment> {
    let saved = checkpoint::read(run)?;
    if saved.dataset != dataset.fingerprint() {
        return Err(Error::input(
            &dataset.path,
            dataset.not_that_of(run),
            "give the dataset of that run",
        ));
    }
    let (filter, exposures) = (&saved.state.rows.filter, &saved.state.exposures);
    for (with, option, absent) in [
        ("anti-aliasing", "--anti-aliasing", filter.is_empty()),
        ("per-image exposure", "--exposure", exposures.is_empty()),
    ] {
        if !absent {
            return Err(Error::input(
                run,
                format!("was trained with {with}, which the check's renders do not have"),
                format!("give a run trained with {option} off"),
            ));
        }
    }
    let subject = Subject {
        run,
        dataset,
        saved,
        options,
        device,
    };
    if device.info().fp64 {
        subject.check::<f64>(EPSILON_DOUBLE, progress)
    } else {
        subject.check::<f32>(EPSILON_SINGLE, progress)
    }
}

struct Subject<'a> {
    run: &'a Path,
    dataset: Dataset,
    saved: Checkpoint,
    options: &'a Options,
    device: &'a Device,
}

impl Subject<'_> {
    fn check<R: Real>(
        self,
        epsilon: f64,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<Assessment> {
        let (config, options, device) = (&self.saved.config, self.options, self.device);
        let (splats, done) = (&self.saved.state.splats, self.saved.state.iteration);
        let schedule = Schedule::new(config).with_background(self.saved.state.background);
        // The renders and the loss of training, over the background of evaluation.
        let setting = Setting {
            render: RenderOptions {
                sh_degree: splats.sh_degree(),
                background: schedule.fixed_background(),
                quantity: Quantity::Color,
                active_only: false,
            },
            lambda_ssim: config.loss.lambda_ssim,
            alpha_min: ALPHA_MIN,
            epsilon,
        };
        let train = &self.dataset.train;
        let chosen = choose_views(train.len(), options);
        let photos = Photos::new(device, self.dataset.image_budget);
        let views = ViewSet::<R>::new(&photos, chosen.iter().map(|v| train[*v].clone()))?;
        let (names, size) = (views.names.clone(), views.largest.pixels);
        let candidates = options.candidates as usize;
        let mut instrument =
            Instrument::new(device, views, splats.clone(), setting, 2 * candidates)?;
        let base = instrument.base()?;
        let c = &config.mh;
        let weights = [c.weight_opacity, c.weight_ssim, c.weight_l1];
        let logits = &splats.planes()[Plane::OPACITY];
        let ground = Ground {
            config: c,
            splats,
            errors: base.errors(),
            importance: &importance(logits, &base.errors(), weights),
            progress: eta(&schedule, done),
            seed: options.seed,
        };
        let mut judged = ground.draw(candidates);
        judge(&mut instrument, &base, &mut judged, progress)?;
        let all = judged.len();
        judged.retain(|c| c.views > 0);
        Ok(Assessment {
            version: env!("CARGO_PKG_VERSION"),
            run: self.run.display().to_string(),
            dataset: self.dataset.path.display().to_string(),
            size,
            iterations: [done, config.last_iterations()],
            progress: ground.progress,
            gaussians: splats.len(),
            views: names,
            seed: options.seed,
            device: device.info().name.clone(),
            bits: if R::IS_DOUBLE { 64 } else { 32 },
            loss: base.losses.iter().sum::<f64>() / base.losses.len() as f64,
            unseen: all - judged.len(),
            forms: std::array::from_fn(|form| of_form(form, &judged, options.seed)),
            candidates: judged,
        })
    }
}

/// Progress η of density control after so many iterations; 1 without density control.
fn eta(schedule: &Schedule, done: u32) -> f64 {
    let [from, until] = schedule.density_span(done).map(f64::from);
    match from < until {
        true => ((f64::from(done) - from) / (until - from)).clamp(0.0, 1.0),
        false => 1.0,
    }
}

/// Some of `count` views, keyed by the seed, in their order.
fn choose_views(count: usize, options: &Options) -> Vec<usize> {
    let mut order: Vec<usize> = (0..count).collect();
    for i in (1..order.len()).rev() {
        let u = Philox::uniform(options.seed, Stream::Surrogate.stream(0), i as u64)[0];
        order.swap(i, (u * (i + 1) as f64) as usize);
    }
    order.truncate(options.views as usize);
    order.sort_unstable();
    order
}

/// Estimates the gain of all candidates together and measures that of each, in every form.
fn judge<R: Real>(
    instrument: &mut Instrument<R>,
    base: &Base,
    candidates: &mut [Candidate],
    progress: &mut dyn FnMut(usize, usize),
) -> Result<()> {
    let births: Vec<Birth> = candidates.iter().flat_map(|c| c.births).collect();
    let estimates = instrument.estimate(&births)?;
    for (k, (birth, estimate)) in births.iter().zip(&estimates).enumerate() {
        let (candidate, form) = (&mut candidates[k / FORMS.len()], k % FORMS.len());
        candidate.gain[form] = -instrument.change(base, birth, &estimate.touched)?;
        candidate.estimate[form] = -estimate.change;
        if form == 0 {
            candidate.views = estimate.touched.iter().filter(|t| **t).count();
        }
        progress(k + 1, births.len());
    }
    Ok(())
}
