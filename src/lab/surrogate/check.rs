//! The check of the importance and of the first-order estimate on a run's checkpoint.

use std::path::Path;

use serde::Serialize;

use crate::base::constants::ALPHA_MIN;
use crate::base::error::{Error, Result};
use crate::base::rng::Philox;
use crate::capture::Dataset;
use crate::density::mh::importance::importance;
use crate::device::{Device, Real};
use crate::lab::surrogate::births::Birth;
use crate::lab::surrogate::candidates::{Candidate, Ground};
use crate::lab::surrogate::instrument::{Base, Instrument, Setting};
use crate::lab::surrogate::outcome::{FORMS, FormOutcome, Judged, of_form};
use crate::lab::surrogate::stream::{VIEWS, stream};
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
    /// Candidates.
    pub candidates: usize,
    /// Training views.
    pub views: usize,
    /// Seed of views, candidates and resamples.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            candidates: 200,
            views: 8,
            seed: 0,
        }
    }
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
    pub candidates: Vec<Judged>,
}

/// Checks the surrogates on the checkpoint in the folder `run`, trained on `dataset`. `progress` receives the numbers of births
/// done and of all births.
///
/// # Errors
/// No usable checkpoint, another dataset, no candidates or views, or the device's.
pub fn check(
    run: &Path,
    dataset: Dataset,
    device: &Device,
    options: &Options,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<Assessment> {
    for (name, value) in [
        ("--candidates", options.candidates),
        ("--views", options.views),
    ] {
        if value == 0 {
            return Err(Error::config(name, "0; at least 1 expected"));
        }
    }
    let saved = checkpoint::read(run)?;
    if saved.dataset != dataset.fingerprint() {
        return Err(Error::input(
            &dataset.path,
            dataset.not_that_of(run),
            "give the dataset of that run",
        ));
    }
    if !saved.state.rows.filter.is_empty() {
        return Err(Error::input(
            run,
            "was trained with anti-aliasing, which the check's renders do not have",
            "give a run trained with --anti-aliasing off",
        ));
    }
    if !saved.state.exposures.is_empty() {
        return Err(Error::input(
            run,
            "was trained with per-image exposure, which the check's renders do not have",
            "give a run trained with --exposure off",
        ));
    }
    let subject = Subject {
        run,
        dataset,
        saved,
        options,
    };
    if device.info().fp64 {
        subject.check::<f64>(device, EPSILON_DOUBLE, progress)
    } else {
        subject.check::<f32>(device, EPSILON_SINGLE, progress)
    }
}

struct Subject<'a> {
    run: &'a Path,
    dataset: Dataset,
    saved: Checkpoint,
    options: &'a Options,
}

impl Subject<'_> {
    /// The renders and the loss of training at the checkpoint, over the background of evaluation.
    fn setting(&self, schedule: &Schedule, probe: f64) -> Setting {
        Setting {
            render: RenderOptions {
                sh_degree: self.saved.state.splats.sh_degree(),
                background: schedule.fixed_background(),
                quantity: Quantity::Color,
                active_only: false,
            },
            lambda_ssim: self.saved.config.loss.lambda_ssim,
            alpha_min: ALPHA_MIN,
            probe,
        }
    }

    fn check<R: Real>(
        self,
        device: &Device,
        probe: f64,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<Assessment> {
        let (config, done) = (&self.saved.config, self.saved.state.iteration);
        let schedule = Schedule::new(config);
        let setting = self.setting(&schedule, probe);
        let chosen = choose_views(self.dataset.train.len(), self.options);
        let photos = Photos::new(device, self.dataset.image_budget);
        let train = &self.dataset.train;
        let views = ViewSet::<R>::new(&photos, chosen.iter().map(|v| train[*v].clone()))?;
        let (names, size) = (views.names.clone(), views.largest.0);
        let splats = &self.saved.state.splats;
        let room = 2 * self.options.candidates;
        let mut instrument = Instrument::new(device, views, splats.clone(), setting, room)?;
        let base = instrument.base()?;
        let c = &config.mh;
        let weights = [c.weight_opacity, c.weight_ssim, c.weight_l1];
        let logits = &splats.planes()[Plane::OPACITY];
        let values = importance(logits, &base.cues.cues(), weights).values;
        let ground = Ground {
            config: c,
            splats,
            cues: base.cues.cues(),
            importance: &values,
            progress: eta(&schedule, done),
            seed: self.options.seed,
        };
        let drawn = ground.draw(self.options.candidates);
        let judged = judge(&mut instrument, &base, &drawn, progress)?;
        let all = judged.len();
        let seen: Vec<Judged> = judged.into_iter().filter(|j| j.views > 0).collect();
        Ok(Assessment {
            version: env!("CARGO_PKG_VERSION"),
            run: self.run.display().to_string(),
            dataset: self.dataset.path.display().to_string(),
            size,
            iterations: [done, config.iterations],
            progress: ground.progress,
            gaussians: splats.len(),
            views: names,
            seed: self.options.seed,
            device: device.info().name.clone(),
            bits: if R::IS_DOUBLE { 64 } else { 32 },
            loss: base.losses.iter().sum::<f64>() / base.losses.len() as f64,
            unseen: all - seen.len(),
            forms: std::array::from_fn(|form| of_form(form, &seen, self.options.seed)),
            candidates: seen,
        })
    }
}

/// Progress η of density control after so many iterations; 1 without density control.
fn eta(schedule: &Schedule, done: u32) -> f64 {
    let [from, until] = schedule.density_span();
    if from >= until {
        return 1.0;
    }
    ((f64::from(done) - f64::from(from)) / f64::from(until - from)).clamp(0.0, 1.0)
}

/// Some of `count` views, keyed by the seed, in their order.
fn choose_views(count: usize, options: &Options) -> Vec<usize> {
    let mut order: Vec<usize> = (0..count).collect();
    for i in (1..order.len()).rev() {
        let u = Philox::uniform(options.seed, stream(VIEWS), i as u64)[0];
        order.swap(i, (u * (i + 1) as f64) as usize);
    }
    order.truncate(options.views);
    order.sort_unstable();
    order
}

/// Probes all candidates together and measures each in every form.
fn judge<R: Real>(
    instrument: &mut Instrument<R>,
    base: &Base,
    drawn: &[Candidate],
    progress: &mut dyn FnMut(usize, usize),
) -> Result<Vec<Judged>> {
    let births: Vec<Birth> = drawn.iter().flat_map(Candidate::births).collect();
    let probed = instrument.probe(base, &births)?;
    let mut gains = Vec::with_capacity(births.len());
    for (k, (birth, probe)) in births.iter().zip(&probed).enumerate() {
        gains.push([
            -instrument.change(base, birth, &probe.touched)?,
            -probe.change,
        ]);
        progress(k + 1, births.len());
    }
    const N: usize = FORMS.len();
    let views = |k: usize| probed[N * k].touched.iter().filter(|t| **t).count();
    Ok(drawn
        .iter()
        .enumerate()
        .map(|(k, candidate)| Judged {
            candidate: *candidate,
            views: views(k),
            gain: std::array::from_fn(|form| gains[N * k + form][0]),
            probe: std::array::from_fn(|form| gains[N * k + form][1]),
        })
        .collect())
}
