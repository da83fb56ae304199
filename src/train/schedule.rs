//! Schedules of a run: pure functions of the configuration and the iteration. Learning rates decay here.

use crate::base::rng::{Philox, Stream};
use crate::config::{DENSITY_STEPS, PAPER_ITERATIONS, Sampler};
use crate::config::{ExposureChoice, Length, TrainConfig, TrainingSize};
use crate::device::PhotoScale;
use crate::pipeline::stage::adam::LearningRates;
use crate::train::sizes::Sizes;

/// Largest f of [`Schedule::boost`].
const MAX_BOOST: f64 = 4.0;

/// Iterations that new Gaussians are given before the next step judges them.
const MIN_INTERVAL: u32 = 25;

/// Iterations, of the papers' 30,000, after which exposure is compensated, or it is decided whether: full photos have been trained
/// on by then. Before, renders differ from photos by how much of a view is there yet (measured: gains in synthetic sets, which
/// have one exposure, spread by up to 30 % after 2,000 iterations and by 2 % after 6,000).
const EXPOSURE_FROM: u32 = 6000;

/// Iterations that a short run does before it decides: of fewer, no render tells how bright a photo should be.
const MIN_BEFORE_DECISION: u32 = 300;

/// Pixels that a shrunk photo has in width and height at least.
const MIN_SIDE: usize = 64;

/// Number of times that photos of `size` pixels can be halved so that both sides keep at least 64 pixels.
#[must_use]
pub fn most_halvings(size: [usize; 2]) -> u32 {
    (size[0].min(size[1]) / MIN_SIDE).max(1).ilog2()
}

/// Times that the default lag fits into the interval between two steps at least: newborns need the rest to find their places (docs/results/gpu.md).
const LAG_SHARE: u32 = 6;

/// The schedules of one run.
///
/// Each goes by the length of the run as it is planned at the iteration asked for: a time budget changes it on the way.
#[derive(Debug, Clone)]
pub struct Schedule {
    config: TrainConfig,
    density_lag: u32,
    background: [f32; 3],
}

impl Schedule {
    /// Schedules scaled from the papers' 30,000 iterations to the run's.
    #[must_use]
    pub fn new(config: &TrainConfig) -> Self {
        Self {
            config: config.clone(),
            density_lag: config.work.density_lag.unwrap_or(0),
            background: config.background.named(),
        }
    }

    /// The same with a lag of density steps that a plan has decided on, iterations.
    #[must_use]
    pub fn with_density_lag(mut self, density_lag: u32) -> Self {
        self.density_lag = density_lag;
        self
    }

    /// The same with a fixed background that a plan has decided on.
    #[must_use]
    pub fn with_background(mut self, background: [f32; 3]) -> Self {
        self.background = background;
        self
    }

    /// Sets the length of the run from an iteration on.
    pub fn set_length(&mut self, length: Length) {
        self.config.set_length(length);
    }

    /// Iterations of the whole run as they are planned at one of them.
    #[must_use]
    pub fn iterations(&self, at: u32) -> u32 {
        self.config.iterations_at(at)
    }

    /// Length of the run over the papers', as it is planned at an iteration.
    fn scale(&self, at: u32) -> f64 {
        f64::from(self.iterations(at)) / PAPER_ITERATIONS
    }

    /// Number of iterations that the papers' `iterations` are for the length at `at`.
    fn scaled(&self, at: u32, iterations: u32) -> u32 {
        (f64::from(iterations) * self.scale(at)).round() as u32
    }

    /// Iterations between two bands of spherical harmonics at an iteration.
    #[must_use]
    pub fn sh_interval(&self, at: u32) -> u32 {
        self.scaled(at, self.config.optimizer.sh_interval).max(1)
    }

    /// Size of photos of `size` pixels at an iteration over their full size: the largest of the run, halved, both if both sides keep at
    /// least 64 pixels. Never halved more often than at an iteration before, be it that another length was planned then.
    #[must_use]
    pub fn scale_of(&self, sizes: &Sizes, iteration: u32, size: [usize; 2]) -> PhotoScale {
        let [num, den] = self.size(iteration).fraction().map(|n| n as usize);
        let large = |scale: &PhotoScale| size.iter().all(|side| scale.of(*side) >= MIN_SIDE);
        let largest = Some(PhotoScale { num, den }).filter(large);
        let largest = largest.unwrap_or(PhotoScale::FULL);
        let most = most_halvings(size.map(|side| largest.of(side)));
        largest.halved(self.halvings(sizes, iteration).min(most))
    }

    /// Largest size of the photos over that asked for, as it is planned at an iteration.
    #[must_use]
    pub fn size(&self, at: u32) -> TrainingSize {
        self.config.size_at(at)
    }

    /// Number of halvings of photos of any size at an iteration.
    #[must_use]
    pub fn halvings(&self, sizes: &Sizes, iteration: u32) -> u32 {
        let past = self.config.lengths.iter().filter(|l| l.from <= iteration);
        let ends = past.filter_map(|l| l.from.checked_sub(1));
        let halvings = |at: u32| sizes.halvings(at, self.iterations(at));
        ends.map(halvings).fold(halvings(iteration), u32::min)
    }

    /// First iteration from which photos of `size` pixels have the largest size of the run, by the lengths so far.
    #[must_use]
    pub fn full_size_from(&self, sizes: &Sizes, size: [usize; 2]) -> u32 {
        let lengths = &self.config.lengths;
        let before = |k: usize| {
            k.checked_sub(1)
                .map_or(TrainingSize::Full, |k| lengths[k].size)
        };
        let changed = (0..lengths.len()).rfind(|k| lengths[*k].size != before(*k));
        let changed = changed.map_or(0, |k| lengths[k].from);
        if self.halvings(sizes, 0).min(most_halvings(size)) == 0 {
            return changed;
        }
        let changes = self.config.lengths.iter().map(|l| l.from);
        let starts: Vec<u32> = [0].into_iter().chain(changes).collect();
        let reached = starts.iter().enumerate().find_map(|(k, from)| {
            let end = sizes.ends(self.iterations(*from)).last().unwrap_or(0);
            let next = starts.get(k + 1).copied().unwrap_or(u32::MAX);
            Some(end.max(*from)).filter(|first| *first < next)
        });
        reached.unwrap_or(0).max(changed)
    }

    /// Views of a batch that come before the one of an iteration.
    #[must_use]
    pub fn views_before(&self, iteration: u32) -> usize {
        (iteration % self.config.batch) as usize
    }

    /// Step of the optimiser, from 1, that an iteration takes: the last one of a batch, with the mean gradient of its views. `None`
    /// for the others.
    #[must_use]
    pub fn step_of(&self, iteration: u32) -> Option<u32> {
        let done = iteration + 1;
        let batch = self.config.batch;
        done.is_multiple_of(batch).then_some(done / batch)
    }

    /// The first iteration that takes a step of the optimiser.
    #[must_use]
    pub fn first_step(&self) -> u32 {
        self.config.batch - 1
    }

    /// Learning rates of an iteration: positions decay log-linearly over the run, the others settle at its end. Local units: the
    /// scene extent is 1.
    ///
    /// Adam moves a parameter by about its rate per iteration, whatever the gradient, so that a short run cannot reach what
    /// a long one does. With f = √(30,000/n), 1 ≤ f ≤ 4, a run of n iterations therefore takes f^1.5 times the rate for positions, which have the
    /// longest way to go, and with mh for scales, f times for the higher SH bands and √f times for the rest (docs/results/learning-rates.md). From 30,000 iterations on the rates are
    /// the papers'. Towards the end all but the position's settle (`lr-settle`). A step for a batch of B views takes √B times the rates: the gradients of B views have
    /// a mean whose scatter is 1/√B of that of one, and B steps of one view get as far at random as one of √B times the length
    /// (Grendel-GS, Zhao et al. 2024).
    #[must_use]
    pub fn rates(&self, iteration: u32) -> LearningRates {
        let o = &self.config.optimizer;
        let boost = self.boost(iteration);
        let factor = self.settle(iteration) * self.batch_boost();
        let (slow, far) = (factor * boost.sqrt(), boost.powf(1.5));
        // With mcmc and with a fixed set plush loses by it (docs/results/learning-rates.md).
        let scale = match self.config.sampler {
            Sampler::Mh => factor * far,
            Sampler::Mcmc | Sampler::Adc | Sampler::None => slow,
        };
        LearningRates {
            position: far * self.position_rate(iteration),
            scale: scale * o.lr_scale,
            rotation: slow * o.lr_rotation,
            opacity: slow * o.lr_opacity,
            sh0: slow * o.lr_sh0,
            sh: factor * boost * o.lr_sh,
        }
    }

    /// Factor f = √(30,000/n) of a run of n iterations, 1 ≤ f ≤ 4; 1 without `lr-scales-with-run`.
    fn boost(&self, at: u32) -> f64 {
        match self.config.optimizer.lr_scales_with_run {
            true => (1.0 / self.scale(at)).sqrt().clamp(1.0, MAX_BOOST),
            false => 1.0,
        }
    }

    /// Decay of Adam's second moment in a step for one view, as the run is planned at an iteration: 1 − f²·(1 − `beta2`) with the f of [`Schedule::rates`], so that
    /// it remembers the same share, 1/30, of runs of 1,875 to 30,000 iterations. Gradients fall as a scene is fitted, and with a longer memory steps are as small as
    /// the large gradients of long ago make them. Not less than `beta1`, unless `beta2` is: the first moment of what no view shows would outlast the second, and steps would grow.
    #[must_use]
    pub fn beta2(&self, at: u32) -> f64 {
        let o = &self.config.optimizer;
        let short = 1.0 - self.boost(at).powi(2) * (1.0 - o.beta2);
        short.max(o.beta1.min(o.beta2))
    }

    /// Factor on the rates of the step after an iteration that makes up for lengths planned before with another [`Schedule::beta2`]: the optimiser corrects the bias of the second
    /// moment as if the present one had held from the beginning. √((1 − Π β₂ᵢ)/(1 − β₂ᵗ)); 1 for a run of one length.
    #[must_use]
    pub fn memory_correction(&self, iteration: u32) -> f64 {
        let batch = self.config.batch;
        let end = (iteration + 1) / batch * batch;
        let changes = self.config.lengths.iter().map(|l| l.from);
        let starts: Vec<u32> = [0]
            .into_iter()
            .chain(changes)
            .take_while(|from| *from < end)
            .collect();
        let now = self.beta2(iteration);
        if starts.iter().all(|from| self.beta2(*from) == now) {
            return 1.0;
        }
        // A batch in which a length begins is taken by that.
        let whole = |at: u32| at / batch * batch;
        let ends = starts.iter().skip(1).map(|to| whole(*to)).chain([end]);
        let spans = starts
            .iter()
            .zip(ends)
            .map(|(from, to)| (from, whole(*from)..to));
        let logs = spans
            .filter(|(_, span)| !span.is_empty())
            .map(|(from, span)| span.len() as f64 * self.beta2(*from).ln());
        let weight = |log: f64| -log.exp_m1();
        (weight(logs.sum()) / weight(f64::from(end) * now.ln())).sqrt()
    }

    /// Factor on the rates of the steps of batches.
    fn batch_boost(&self) -> f64 {
        f64::from(self.config.batch).sqrt()
    }

    /// Factor by which the rates settle towards the end: 1, then log-linear down to `lr-settle`.
    fn settle(&self, iteration: u32) -> f64 {
        let o = &self.config.optimizer;
        let paper = f64::from(iteration) / self.scale(iteration);
        let from = f64::from(o.lr_settle_from);
        let share = (paper - from) / (PAPER_ITERATIONS - from).max(1.0);
        o.lr_settle.powf(share.clamp(0.0, 1.0))
    }

    /// Learning rate of the positions without what short runs add to it: log-linear over the run. The noise on positions is
    /// in proportion to this one: n·lr² is its variance after n iterations, and with the rate of [`Schedule::rates`] that of a
    /// short run would be more than a long one's, which costs (docs/results/samplers.md, short runs). By the same law √B times the rate
    /// for batches of B views keeps the variance.
    #[must_use]
    pub fn position_rate(&self, iteration: u32) -> f64 {
        let o = &self.config.optimizer;
        self.batch_boost() * self.log_linear(iteration, [o.lr_position, o.lr_position_final])
    }

    /// Learning rate of the photos' colour transforms: log-linear over the run.
    #[must_use]
    pub fn exposure_rate(&self, iteration: u32) -> f64 {
        let o = &self.config.optimizer;
        self.log_linear(iteration, [o.lr_exposure, o.lr_exposure_final])
    }

    /// Log-linear interpolation over the run; the first value throughout if either is 0.
    fn log_linear(&self, iteration: u32, [from, to]: [f64; 2]) -> f64 {
        let t = f64::from(iteration) / f64::from(self.iterations(iteration).max(1));
        if from > 0.0 && to > 0.0 {
            (from.ln() + t.min(1.0) * (to.ln() - from.ln())).exp()
        } else {
            from
        }
    }

    /// Iterations done when exposure is first compensated or, if the configuration leaves that open, when it is decided, as it is
    /// planned at an iteration.
    ///
    /// Not from the start: the first renders are far from any photo, all transforms would take up some of that at random, and
    /// view-dependent colour would undo it in the training views alone (measured: held-out PSNR of one set falls by 2.7 dB).
    #[must_use]
    pub fn exposure_from(&self, at: u32) -> u32 {
        let from = self.scaled(at, EXPOSURE_FROM).max(1);
        match self.config.exposure {
            ExposureChoice::Auto => from.max(MIN_BEFORE_DECISION),
            _ => from,
        }
    }

    /// First iteration at which density control may act, and the one before which it ends, as planned at an iteration; empty
    /// for a fixed set.
    #[must_use]
    pub fn density_span(&self, at: u32) -> [u32; 2] {
        self.config.density_times().map_or([0, 0], |times| {
            let from = self.scaled(at, times.from) + u32::from(times.after_from);
            [from, self.scaled(at, times.until)]
        })
    }

    /// Iterations between two density steps at an iteration: the paper's, or fewer where a short run would have less than 15 steps; whole
    /// batches, whose gradients are of one set of Gaussians.
    #[must_use]
    pub fn density_interval(&self, at: u32) -> u32 {
        let [from, until] = self.density_span(at);
        let least = until.saturating_sub(from) / DENSITY_STEPS;
        let asked = self.config.density_times().map_or(1, |t| t.interval);
        let interval = asked.min(least.max(MIN_INTERVAL));
        interval.next_multiple_of(self.config.batch)
    }

    /// Difference Δη of the progress of two density steps, as the run is planned at an iteration.
    #[must_use]
    pub fn density_spacing(&self, at: u32) -> f64 {
        let [from, until] = self.density_span(at);
        f64::from(self.density_interval(at)) / f64::from(until.saturating_sub(from).max(1))
    }

    /// Iterations that training does between the begin of a density step after `done` iterations and its end: the plan's, but no more
    /// than half of the interval, or a sixth where none was asked for, and whole batches.
    #[must_use]
    pub fn density_lag(&self, done: u32) -> u32 {
        let lag = self.density_lag.min(self.most_lag(done));
        lag - lag % self.config.batch
    }

    /// Longest lag of a density step after `done` iterations: half of the interval, or [a sixth](LAG_SHARE) where none was asked for.
    pub(super) fn most_lag(&self, done: u32) -> u32 {
        let interval = self.density_interval(done);
        match self.config.work.density_lag {
            Some(_) => interval / 2,
            None => (interval / LAG_SHARE).max(1).min(interval / 2),
        }
    }

    /// True if the length of the run may change after `done` iterations: right after a density step or away from them all, so that
    /// none is called off whose statistics are being gathered, and none comes without.
    #[must_use]
    pub fn may_change(&self, done: u32) -> bool {
        let [from, until] = self.density_span(done);
        let away = done.saturating_add(self.density_interval(done)) < from || done >= until;
        let after = 1 + self.density_lag(done);
        away || (done.checked_sub(after)).is_some_and(|at| self.density_due(at).is_some())
    }

    /// First iteration from which the length holds that holds at one.
    #[must_use]
    pub fn length_from(&self, at: u32) -> u32 {
        let lengths = self.config.lengths.iter().rev();
        lengths
            .map(|l| l.from)
            .find(|from| *from <= at)
            .unwrap_or(0)
    }

    /// Progress η of density control if a step is due after `done` iterations.
    #[must_use]
    pub fn density_due(&self, done: u32) -> Option<f64> {
        let progress = self.density_multiple(done)?;
        // Another length has other steps: none so soon after one of the length before.
        let half = self.density_interval(done) / 2;
        let changed = self.length_from(done);
        let soon =
            (done.saturating_sub(half)..changed).any(|at| self.density_multiple(at).is_some());
        (!soon).then_some(progress)
    }

    /// Progress η at a multiple of the interval within the span.
    fn density_multiple(&self, done: u32) -> Option<f64> {
        let [from, until] = self.density_span(done);
        if done < from
            || done >= until.min(self.iterations(done))
            || !done.is_multiple_of(self.density_interval(done))
        {
            return None;
        }
        Some(self.density_progress(done))
    }

    /// Progress η of density control after `done` iterations: 0 before its span, 1 after it.
    #[must_use]
    pub fn density_progress(&self, done: u32) -> f64 {
        let [from, until] = self.density_span(done);
        let past = done.clamp(from, until.max(from)) - from;
        f64::from(past) / f64::from(until.saturating_sub(from).max(1))
    }

    /// The next density step at or after `iteration`'s end: after how many iterations done, and its progress η.
    #[must_use]
    pub fn next_density(&self, iteration: u32) -> Option<(u32, f64)> {
        let at = iteration.saturating_add(1);
        let [from, _] = self.density_span(at);
        let interval = self.density_interval(at);
        let due = from.max(at).checked_next_multiple_of(interval)?;
        let mut due = [due, due.saturating_add(interval)].into_iter();
        due.find_map(|due| self.density_due(due).map(|progress| (due, progress)))
    }

    /// Progress η of the density step before the one after `done` iterations; `None` if that is the first.
    #[must_use]
    pub fn density_before(&self, done: u32) -> Option<f64> {
        // Nothing has been trained after no iteration, and no step is made. Where the length has changed the last step may be
        // nearer or farther than an interval.
        let first = done.saturating_sub(self.density_interval(done).saturating_mul(4));
        (first.max(1)..done)
            .rev()
            .find_map(|at| self.density_due(at))
    }

    /// Opacity resets (adc) that come at intervals, before the density step at `done`.
    #[must_use]
    pub fn opacity_resets(&self, done: u32) -> u32 {
        let every = self.scaled(done, self.config.adc.reset_interval).max(1);
        done.saturating_sub(self.density_interval(done)) / every
    }

    /// True if opacity is reset (adc) with the density step at `done`: when the interval is over, and before a white
    /// background at the first step, too (released code: at `densify_from_iter`).
    #[must_use]
    pub fn resets_opacity(&self, done: u32) -> bool {
        let every = self.scaled(done, self.config.adc.reset_interval).max(1);
        let [from, _] = self.density_span(done);
        let first = done < from + self.density_interval(done);
        done / every > self.opacity_resets(done) || (first && self.background == [1.0; 3])
    }

    /// True if Gaussians born in the last density step have had the time that they are given before they are judged.
    #[must_use]
    pub fn recovered(&self, done: u32) -> bool {
        let given = MIN_INTERVAL - 1 + self.density_lag(done);
        let steps = (done.saturating_sub(given)..=done).rev();
        steps
            .into_iter()
            .all(|at| self.density_due(at).is_none() || at == done)
    }

    /// Iterations between two evaluations at an iteration, 0 for none before the end.
    #[must_use]
    pub fn eval_every(&self, at: u32) -> u32 {
        self.config
            .eval_every
            .unwrap_or((self.iterations(at) / 20).max(1))
    }

    /// True if an evaluation, a checkpoint or an export is due after `done` iterations, before the end.
    #[must_use]
    pub fn pause_due(&self, done: u32) -> bool {
        let c = &self.config;
        let due = |every: u32| every > 0 && done.is_multiple_of(every);
        let evaluated = due(self.eval_every(done));
        let any = evaluated || due(c.checkpoint_every) || due(c.export_every);
        done > 0 && done < self.iterations(done) && any
    }

    /// Views of `count` iterations from `iteration` on: every epoch is a permutation of the views, keyed by (seed, epoch). Its last
    /// ones that fill no batch are left out, so that no batch has a view twice.
    #[must_use]
    pub fn upcoming(&self, iteration: u32, count: usize, views: usize) -> Vec<usize> {
        let batch = self.config.batch as usize;
        let n = (views / batch * batch).max(1);
        let first = iteration as usize;
        let mut epoch = first / n;
        let mut order = self.permutation(epoch as u32, views);
        let view = |i: usize| {
            if i / n != epoch {
                epoch = i / n;
                order = self.permutation(epoch as u32, views);
            }
            order[i % n]
        };
        (first..first + count).map(view).collect()
    }

    fn permutation(&self, epoch: u32, views: usize) -> Vec<usize> {
        let mut order: Vec<usize> = (0..views.max(1)).collect();
        for i in (1..order.len()).rev() {
            let u = Philox::uniform(self.config.seed, Stream::ViewOrder.stream(epoch), i as u64)[0];
            order.swap(i, (u * (i + 1) as f64) as usize);
        }
        order
    }

    /// Background colour of an iteration, `random` or the fixed one.
    #[must_use]
    pub fn background(&self, iteration: u32, random: bool) -> [f32; 3] {
        if !random {
            return self.fixed_background();
        }
        let stream = Stream::Background.stream(0);
        let u = Philox::uniform(self.config.seed, stream, u64::from(iteration));
        [u[0] as f32, u[1] as f32, u[2] as f32]
    }

    /// Background colour where it must not change: evaluation.
    #[must_use]
    pub fn fixed_background(&self) -> [f32; 3] {
        self.background
    }
}
