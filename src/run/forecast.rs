//! [`Forecast`]: the time that a run still takes, from that of its iterations so far.

use std::fmt::Write;
use std::time::Instant;

use crate::base::error::Result;
use crate::chart::text::{about, grouped};
use crate::config::{Init, Preset, TrainConfig, TrainingSize};
use crate::density::Expected;
use crate::evaluate::Evaluator;
use crate::run::cost::{TYPICAL, cost};
use crate::run::cost_meter::{CostMeter, First};
use crate::run::footprint::Footprint;
use crate::run::report::gallery::{GALLERY_VIEWS, data_uri, error_map};
use crate::run::report::training::{SHOWN, VIEWS};
use crate::train::Trainer;
use crate::train::growth::Growth;
use crate::train::schedule::Schedule;
use crate::train::sizes::Sizes;

/// Mean cost of an iteration at full size over that of the last one: Gaussians die towards the end.
const MEAN_COST: f64 = 1.05;

/// Expected cost of a density step over that of an iteration at the end (1500 and 7000 iterations of plush, fox-colmap, lego and
/// tankard at 400 to 640 px: 0.6 to 2).
const STEP: f64 = 1.0;

/// Cost of showing a view at the end, to find the Gaussians that none shows, of scoring one, and of FLIP beside that, over that of an
/// iteration then (FLIP: tankard, plush and herz-jesus at 400, 640 and 1600 px 0.5, 0.5, 1.0; a little too much ends a budget in time).
const SEEN: f64 = 0.15;
const SCORED: f64 = 0.4;
const FLIPPED: f64 = 0.8;

/// Cost of the report's pictures of a view over that of the probe's, per pixel of the view (six datasets of 400 to 1600 px: 2.9 to 3.5, one
/// 6.5), and seconds of the files.
const PICTURES: f64 = 3.0;
const FILES: f64 = 0.1;

/// Share of a run's time that evaluations on the way take at most unless they are asked for.
const EVALUATIONS: f64 = 0.05;

/// Share of a run's time that the scene and the report after evaluations on the way take at most, but for the first time.
const EXPORTS: f64 = 0.01;

/// Pixels of a photo where none is known.
const SMALL: f64 = 43_000.0;

/// Side of the square picture that tells how quick the host is.
const PROBE: usize = 192;

/// Iterations done at density steps to come, and the number of Gaussians expected after each; `None` if nothing is expected of them.
type Steps = Option<Vec<(u32, f64)>>;

/// A number of Gaussians in words: two digits.
fn counted(gaussians: f64) -> String {
    let step = 10f64.powf((gaussians.max(1.0).log10() - 1.0).floor().max(0.0));
    format!(
        "about {}",
        grouped((gaussians / step).round() as u64 * step as u64)
    )
}

/// Number and total time of what is done now and then.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Spent {
    times: u32,
    seconds: f64,
}

impl Spent {
    fn add(&mut self, seconds: f64) {
        self.times += 1;
        self.seconds += seconds;
    }

    /// Mean of the times so far and a guess, which counts as one of them.
    fn mean_with(&self, guess: f64) -> f64 {
        (self.seconds + guess) / f64::from(self.times + 1)
    }

    /// Mean of the times so far; `None` before the first.
    fn mean(&self) -> Option<f64> {
        (self.times > 0).then(|| self.seconds / f64::from(self.times))
    }
}

/// Distances between two evaluations and between two checkpoints, iterations; 0 for none before the end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Every {
    /// `None` for a twentieth of the run.
    pub evaluation: Option<u32>,
    /// Evaluations on the way that are made of those that are due.
    pub made: Made,
    pub checkpoint: u32,
}

/// Seconds per pixel that the pictures of a view take on this machine, from those of a small one: some thousandths of a second.
///
/// # Errors
/// None that a picture of these numbers could bring about.
pub(super) fn picture_cost() -> Result<f64> {
    let value = |i: usize, by: usize| (i / 3 % PROBE + ((i * by) >> 7) % 31) as u8;
    let picture = |by: usize| -> Vec<u8> { (0..3 * PROBE * PROBE).map(|i| value(i, by)).collect() };
    let (render, photo) = (picture(40_503), picture(69_069));
    let side = PROBE as u32;
    let mut best = f64::INFINITY;
    for _ in 0..3 {
        let start = Instant::now();
        let error = error_map(&render, &photo)?;
        for rgb in [&render, &photo, &error] {
            data_uri("probe", rgb, side, side)?;
        }
        best = best.min(start.elapsed().as_secs_f64());
    }
    Ok(best / (PROBE * PROBE) as f64)
}

/// Evaluations on the way that are made of those that are due.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Made {
    /// All, which are asked for.
    All,
    /// Those that keep their share, [`EVALUATIONS`], of the time spent so far: where a budget plans the run.
    AsTimeAllows,
    /// Every so many of them, by the costs of the photos' sizes: the same whenever the run is repeated.
    AsLengthAllows,
}

impl Made {
    fn of(config: &TrainConfig) -> Self {
        match (config.eval_every.or(config.patience), config.has_budget()) {
            (Some(_), _) => Self::All,
            (None, true) => Self::AsTimeAllows,
            (None, false) => Self::AsLengthAllows,
        }
    }
}

/// Measured times of a run. Seconds are of either clock, wall or CPU, the same in all calls.
#[derive(Debug, Clone)]
pub(super) struct Forecast {
    /// Numbers of Gaussians to come; `None` if they stay as many.
    pub(super) growth: Option<Growth>,
    /// Iterations done at the last density step, or where the run began or went on, and the set since then.
    since: (u32, Expected),
    /// Density steps to come of a run of a length; `None` if they are to be foreseen anew.
    ahead: Option<(u32, Steps)>,
    sizes: Sizes,
    /// Halvings that photos have had: there are no more from then on, be it that another length would have them.
    reached: u32,
    /// Pixels of a photo of full size.
    pixels: f64,
    /// Largest size of the photos that are trained on.
    size: TrainingSize,
    /// Training views that are shown at the end.
    shown: usize,
    /// Training views that are scored at the end, or held-out ones that are scored again after a fit of colours.
    also: usize,
    /// Training views whose pictures are shown.
    pictured: usize,
    /// Cost of FLIP of a view over that of an iteration.
    flipped: f64,
    /// Held-out views, and pixels of all of them.
    scored: (usize, u64),
    /// Seconds per pixel of a view's pictures.
    pictures: f64,
    /// Seconds of an iteration of cost 1.
    pub(super) meter: CostMeter,
    every: Every,
    /// Memory of the run; `None` where it is not known.
    footprint: Option<Footprint>,
    /// Density steps.
    steps: Spent,
    evaluations: Spent,
    exports: Spent,
    checkpoints: Spent,
}

impl Forecast {
    /// A forecast for a run that begins or goes on, whose first measurement is made after `latest` seconds at the latest, and is of `shortest` at least, as all are; seconds per pixel
    /// of a view's pictures, and ranks that share an iteration.
    pub fn new(
        trainer: &Trainer,
        evaluator: Option<&Evaluator>,
        [latest, shortest]: [f64; 2],
        (pictures, ranks): (f64, usize),
    ) -> Self {
        let config = &trainer.plan().config;
        let shown = match config.work.remove_unseen {
            true => trainer.views(),
            false => 0,
        };
        let every = Every {
            evaluation: config.eval_every,
            made: Made::of(config),
            checkpoint: config.checkpoint_every,
        };
        let scored = evaluator.map_or((0, 0), |evaluator| {
            let cameras = &evaluator.views().cameras;
            let pixels = cameras
                .iter()
                .map(|c| c.size.map(i32::unsigned_abs))
                .map(|[w, h]| u64::from(w) * u64::from(h));
            (cameras.len(), pixels.sum())
        });
        let (plan, done) = (trainer.plan(), trainer.iteration());
        let exposed = trainer.compensates_exposure();
        let first = match config.init {
            _ if plan.random_start => First::Random,
            Init::Points if plan.swept.is_none() => First::Sparse,
            _ => First::Found,
        };
        let begun = config
            .lengths
            .iter()
            .map(|l| l.from)
            .filter(|at| *at < done);
        let share_at = |at: u32| {
            let length = config.iterations_at(at.saturating_sub(1)).max(1);
            f64::from(at) / f64::from(length)
        };
        let share = begun.map(share_at).fold(share_at(done), f64::max);
        let growth = Growth::new(
            trainer.schedule().clone(),
            plan.strategy(),
            plan.most_gaussians.value,
        );
        Self {
            growth: Some(growth),
            since: (
                done,
                Expected {
                    gaussians: trainer.gaussians() as f64,
                    born: 0.0,
                },
            ),
            meter: CostMeter::new(first, share, latest).with_shortest(shortest),
            pixels: trainer.largest_photo() as f64,
            size: config.last_size(),
            footprint: Footprint::of(trainer),
            also: if exposed {
                scored.0
            } else {
                trainer.views().min(VIEWS)
            },
            pictured: if exposed {
                0
            } else {
                trainer.views().min(SHOWN)
            },
            flipped: FLIPPED * ranks as f64,
            reached: trainer.halvings(),
            ..Self::of(
                trainer.sizes().clone(),
                shown,
                scored,
                every,
                latest,
                pictures,
            )
        }
    }

    /// A forecast before anything is measured, for a fixed set of Gaussians and small photos.
    pub fn of(
        sizes: Sizes,
        shown: usize,
        scored: (usize, u64),
        every: Every,
        latest: f64,
        pictures: f64,
    ) -> Self {
        Self {
            growth: None,
            since: (
                0,
                Expected {
                    gaussians: TYPICAL,
                    born: 0.0,
                },
            ),
            ahead: None,
            footprint: None,
            sizes,
            reached: u32::MAX,
            pixels: SMALL,
            size: TrainingSize::Full,
            shown,
            also: 0,
            pictured: 0,
            flipped: FLIPPED,
            scored,
            pictures,
            meter: CostMeter::new(First::Found, 0.0, latest),
            every,
            steps: Spent::default(),
            evaluations: Spent::default(),
            exports: Spent::default(),
            checkpoints: Spent::default(),
        }
    }

    /// Takes note of the training time and the number of Gaussians after so many iterations of a run of `length`.
    pub fn iterated(&mut self, done: u32, length: u32, seconds: f64, gaussians: f64) {
        if self.ahead.as_ref().is_none_or(|(of, _)| *of != length) {
            self.ahead = Some((length, self.steps_ahead(length)));
        }
        let halvings = self.sizes.halvings(done, length).min(self.reached);
        let before = std::mem::replace(&mut self.reached, halvings);
        // Before the first call there was no size.
        let grows = before != halvings && before != u32::MAX;
        let one = self.cost(before, gaussians);
        self.meter.iterated((done, length), seconds, one, grows);
    }

    /// Takes note of a density step that began after so many iterations, of the set after it, and of the time that it took beside iterations
    /// (of one that lags behind that of its end).
    pub fn grown(&mut self, begun: u32, [gaussians, born]: [u64; 2], seconds: f64) {
        let [gaussians, born] = [gaussians, born].map(|n| n as f64);
        self.since = (begun, Expected { gaussians, born });
        // Where it is not known how many are to come they are taken for a part of iterations.
        let known = self.ahead.take().map(|(_, steps)| steps.is_some());
        if known.unwrap_or(self.growth.is_some()) {
            self.steps.add(seconds);
            self.meter.leave_out(seconds);
        }
    }

    /// Takes over the schedule of a run whose length, and maybe the size of its photos, has changed after so many iterations; returns true
    /// for another size, of which losses are others.
    pub fn follow(&mut self, schedule: &Schedule, done: u32) -> bool {
        if let Some(growth) = &mut self.growth {
            growth.follow(schedule);
        }
        let length = schedule.iterations(done);
        self.ahead = Some((length, self.steps_ahead(length)));
        let before = std::mem::replace(&mut self.size, schedule.size(done));
        // A shorter run has larger photos at once.
        let halvings = self.sizes.halvings(done, length).min(self.reached);
        if std::mem::replace(&mut self.reached, halvings) != halvings || before != self.size {
            self.meter.grew();
        }
        before != self.size
    }

    /// Largest size of the photos that are trained on.
    pub fn size(&self) -> TrainingSize {
        self.size
    }

    /// The forecast for photos of another size from now on.
    pub fn at_size(&self, size: TrainingSize) -> Self {
        Self {
            size,
            ..self.clone()
        }
    }

    /// Has the present measurement begin anew: something else than iterations has taken time.
    pub fn disturbed(&mut self) {
        self.meter.disturbed();
    }

    /// Takes note of an evaluation on the way.
    pub fn evaluated(&mut self, seconds: f64) {
        self.evaluations.add(seconds);
    }

    /// Takes note of the scene and the report after an evaluation.
    pub fn exported(&mut self, seconds: f64) {
        self.exports.add(seconds);
    }

    /// True if the scene and the report are to be written after an evaluation in a run of so many seconds: they keep a share of
    /// its time, and the first come at once.
    pub fn affords_export(&self, spent: f64) -> bool {
        let next = self.exports.mean();
        next.is_none_or(|next| self.exports.seconds + next <= EXPORTS * spent)
    }

    /// Takes note of a checkpoint.
    pub fn saved(&mut self, seconds: f64) {
        self.checkpoints.add(seconds);
    }

    /// Number of measurements of an iteration so far.
    pub fn measured(&self) -> u32 {
        self.meter.measured()
    }

    /// The time `left` that a run of `iterations` is expected to take yet, the size of its scene and its memory, and the time of the presets beside it.
    pub fn told(&self, iterations: u32, left: f64) -> String {
        let mut text = format!("{iterations} iterations: about {} left", about(left));
        text += &self.told_size(iterations);
        let others = Preset::ALL.iter().filter(|p| p.iterations() != iterations);
        let times = others.filter_map(|p| {
            let whole = self.left(0, p.iterations())?;
            Some(format!("{} {}", p.name(), about(whole)))
        });
        let times: Vec<String> = times.collect();
        let _ = write!(text, " (on this device --preset {})", times.join(", "));
        text
    }

    /// The size of the scene of a run of so many iterations, and its memory, as far as they are known, to come after what is told of it.
    pub fn told_size(&self, iterations: u32) -> String {
        let Some(steps) = self.steps_ahead(iterations) else {
            return String::new();
        };
        let n = steps.last().map_or(self.since.1.gaussians, |(_, n)| *n);
        let memory = self.footprint.map(|f| format!(", {}", f.told(n)));
        format!(", {} Gaussians{}", counted(n), memory.unwrap_or_default())
    }

    /// Seconds from `done` iterations to the very end of a run of `length`; `None` before the first measurement.
    pub fn left(&self, done: u32, length: u32) -> Option<f64> {
        let unit = self.meter.unit(length)?;
        let n = self.since.1.gaussians;
        let other;
        let steps = match &self.ahead {
            Some((of, steps)) if *of == length => steps,
            _ => {
                other = self.steps_ahead(length);
                &other
            }
        };
        let steps = steps.as_deref().unwrap_or_default();
        let last = steps.last().map_or(n, |(_, n)| *n);
        let step = STEP * unit * self.cost_at_end(last);
        let iterations = unit * self.work([done, length], length, self.reached, (n, steps))
            + steps.len() as f64 * self.steps.mean_with(step);
        let rest = length.saturating_sub(done);
        let times = |every: u32| f64::from(rest.checked_div(every).unwrap_or(0));
        let every = self.every.evaluation.unwrap_or((length / 20).max(1));
        let mut evaluations = times(every) * self.evaluation(last, length)?;
        if self.every.made != Made::All {
            evaluations = evaluations.min(EVALUATIONS * iterations);
        }
        let checkpoints = times(self.every.checkpoint) * self.checkpoints.mean().unwrap_or(0.0);
        Some(iterations + evaluations + checkpoints + self.ending(last, length)?)
    }

    /// Density steps to come of a run of `length`.
    fn steps_ahead(&self, length: u32) -> Steps {
        let (since, set) = self.since;
        self.growth.as_ref()?.steps(since, set, length)
    }

    /// Seconds from the last iteration of a run of a length to the end, if that comes with the Gaussians of now. `None` as [`Forecast::left`].
    pub fn end(&self, length: u32) -> Option<f64> {
        self.ending(self.since.1.gaussians, length)
    }

    /// Seconds from the last iteration to the end with so many Gaussians: views are shown and scored, files are written.
    fn ending(&self, gaussians: f64, length: u32) -> Option<f64> {
        let last = self.meter.unit(length)? * self.cost_at_end(gaussians);
        let (views, pixels) = self.scored;
        // Views with pictures are rendered and scored once more.
        let pictured = [views.min(GALLERY_VIEWS), self.pictured];
        let scored = (self.also + pictured[0] + pictured[1]) as f64;
        let rendered = SEEN * self.shown as f64 + SCORED * scored + self.flipped * views as f64;
        let held_out = pixels as f64 / views.max(1) as f64;
        let shown = pictured[0] as f64 * held_out + pictured[1] as f64 * self.pixels;
        let saved = self.checkpoints.mean().unwrap_or(0.0);
        let host = PICTURES * self.pictures * shown + saved + FILES;
        Some(last * rendered + self.evaluation(gaussians, length)? + host)
    }

    /// Seconds of an evaluation on the way with so many Gaussians.
    fn evaluation(&self, gaussians: f64, length: u32) -> Option<f64> {
        let guess =
            SCORED * self.meter.unit(length)? * self.cost_at_end(gaussians) * self.scored.0 as f64;
        Some(self.evaluations.mean().unwrap_or(guess))
    }

    /// True if the evaluation that is due after `done` iterations of a run of `length` and so many seconds is to be made.
    pub fn affords_evaluation(&self, done: u32, length: u32, spent: f64) -> bool {
        match self.every.made {
            Made::All => true,
            Made::AsTimeAllows => {
                let now = self.since.1.gaussians;
                let next = self.evaluation(now, length).unwrap_or(0.0);
                self.evaluations.seconds + next <= EVALUATIONS * spent
            }
            Made::AsLengthAllows => {
                // Without the number of Gaussians, which a run that goes on does not know from its start.
                let run = self.work([0, length], length, u32::MAX, (TYPICAL, &[]));
                let one = SCORED / MEAN_COST * self.cost_at_end(TYPICAL) * self.scored.0 as f64;
                let due = (length / 20).max(1);
                let fit = EVALUATIONS * run / one.max(1e-9);
                let apart = (f64::from(length / due - 1) / fit).ceil().max(1.0);
                f64::from(done / due) % apart == 0.0
            }
        }
    }

    /// Cost of an iteration of photos that are halved so many times, of so many Gaussians.
    fn cost(&self, halvings: u32, gaussians: f64) -> f64 {
        let pixels = self.pixels * self.size.area() * 0.25f64.powi(halvings as i32);
        cost(pixels, gaussians)
    }

    /// The same with photos of the size asked for, at which views are shown and scored.
    fn cost_at_end(&self, gaussians: f64) -> f64 {
        cost(self.pixels, gaussians)
    }

    /// Cost of the iterations between two of a run of `length` with no more halvings than `most`, of `n` Gaussians until the first of the
    /// `steps` that tell another number.
    fn work(
        &self,
        [from, to]: [u32; 2],
        length: u32,
        most: u32,
        (n, steps): (f64, &[(u32, f64)]),
    ) -> f64 {
        let ends: Vec<u32> = self.sizes.ends(length).collect();
        let mut edges = vec![from, to];
        edges.extend(ends.iter().chain(steps.iter().map(|(at, _)| at)));
        edges.retain(|e| (from..=to).contains(e));
        edges.sort_unstable();
        let piece = |pair: &[u32]| {
            let halvings = ends.iter().filter(|end| pair[0] < **end).count() as u32;
            let past = steps.partition_point(|(at, _)| *at <= pair[0]);
            let n = past.checked_sub(1).map_or(n, |last| steps[last].1);
            f64::from(pair[1] - pair[0]) * self.cost(halvings.min(most), n)
        };
        edges.windows(2).map(piece).sum()
    }
}
