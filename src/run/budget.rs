//! Length of a run that fits a budget of time: planned from the cost of an iteration, and corrected on the way. Where few iterations fit the photos
//! are trained on at the smaller size that promises the least error (docs/results/budgets.md).

use crate::base::process::CPU_TICK;
use crate::config::{Length, TrainConfig, TrainingSize};
use crate::run::clock::Clock;
use crate::run::error_model::ErrorModel;
use crate::run::forecast::Forecast;

/// Share of the budget that is planned for; the rest is left for what the plan does not foresee.
const PLANNED: f64 = 0.99;

/// The length stays where it is off by no more than this part of the iterations that are left: every change moves the density steps to come and
/// the progress that they go by (docs/results/budgets.md).
const STEADY: u32 = 10;

/// Share of the budget after which the first plan is made, if fewer iterations have been done by then than a forecast waits for.
const LATEST: f64 = 0.1;

/// The same for the first forecast of a run without a budget, seconds.
const LATEST_SECONDS: f64 = 20.0;

/// Shortest time that a measurement on the CPU clock of one process is of, seconds: either end is cut to ticks, of the user's and the system's time.
const SHORTEST: f64 = 8.0 * CPU_TICK;

/// Largest number of iterations of a run that is extended: no more than its time.
const MOST: u32 = u32::MAX / 4;

/// Configuration of a new run, and the lengths that it is to have later: those that it repeats, whatever its time budget.
pub(super) fn begin(mut config: TrainConfig) -> (TrainConfig, Vec<Length>) {
    let to_come = std::mem::take(&mut config.lengths);
    if !to_come.is_empty() {
        (config.time_budget, config.budget_cpu) = (None, None);
    }
    (config, to_come)
}

/// Configuration of a run that goes on after so many iterations, and the lengths that it is to have later.
pub(super) fn go_on(mut config: TrainConfig, done: u32) -> (TrainConfig, Vec<Length>) {
    let past = config.lengths.partition_point(|l| l.from <= done);
    let to_come = config.lengths.split_off(past);
    match config.has_budget() {
        true => (config, Vec::new()),
        false => (config, to_come),
    }
}

/// Decider on the length of a run.
#[derive(Debug)]
pub(super) enum Pace {
    /// The length is that of the configuration.
    Fixed,
    /// The largest number of iterations that fits.
    Budget(Budget),
    /// The lengths of another run, the next one last.
    Repeats(Vec<Length>),
}

impl Pace {
    /// The pace of a run that begins or goes on; a budget chooses from the sizes of photos, the largest first.
    pub fn new(config: &TrainConfig, to_come: Vec<Length>, sizes: Vec<TrainingSize>) -> Self {
        match (Budget::of(config, sizes), to_come.is_empty()) {
            (Some(budget), _) => Self::Budget(budget),
            (None, true) => Self::Fixed,
            (None, false) => Self::Repeats(to_come.into_iter().rev().collect()),
        }
    }

    /// Another length for the run, which has had `done` iterations of so many, if it is to have one from now on; `spent` is what the budget's
    /// clock shows.
    pub fn length(
        &mut self,
        done: u32,
        length: u32,
        forecast: &Forecast,
        spent: f64,
    ) -> Option<Length> {
        match self {
            Self::Fixed => None,
            Self::Budget(budget) => budget.length(done, length, forecast, spent),
            Self::Repeats(_) => self.beyond(done),
        }
    }

    /// The length that a run which is repeated had from now on, be it that it had come to its end.
    pub fn beyond(&mut self, done: u32) -> Option<Length> {
        match self {
            Self::Repeats(to_come) => to_come.pop_if(|next| next.from <= done),
            _ => None,
        }
    }

    /// True if lengths are those of another run.
    pub fn repeats(&self) -> bool {
        matches!(self, Self::Repeats(_))
    }

    /// The run's budget, if it has one.
    pub fn budget(&self) -> Option<&Budget> {
        match self {
            Self::Budget(budget) => Some(budget),
            _ => None,
        }
    }

    /// Lengths that are known to come.
    pub fn to_come(&self) -> Vec<Length> {
        match self {
            Self::Repeats(lengths) => lengths.iter().rev().copied().collect(),
            _ => Vec::new(),
        }
    }
}

/// Time that a run may take, and the plan of its length.
#[derive(Debug, Clone)]
pub(super) struct Budget {
    /// All of the run's time, seconds.
    pub seconds: f64,
    /// True for CPU seconds of all processes, false for those of a clock.
    pub cpu: bool,
    /// Largest number of iterations.
    most: u32,
    /// Measurements that the last plan was made from; none before the first.
    planned: u32,
    /// Sizes of photos to choose from at the first plan, the largest first.
    sizes: Vec<TrainingSize>,
    /// Expected errors of lengths at these sizes.
    model: ErrorModel,
    /// Iterations that the first plan found room for at full size, where it chose a smaller one.
    at_full_size: Option<u32>,
}

impl Budget {
    /// The budget that a configuration asks for; see [`Pace::new`].
    fn of(config: &TrainConfig, sizes: Vec<TrainingSize>) -> Option<Self> {
        let wall = config.time_budget.map(|seconds| (seconds, false));
        let (seconds, cpu) = wall.or(config.budget_cpu.map(|seconds| (seconds, true)))?;
        let most = match config.extended() {
            true => MOST,
            false => config.iterations,
        };
        Some(Self {
            sizes,
            model: ErrorModel {
                even: config.work.resolution_iterations,
            },
            ..Self::new(seconds, cpu, most)
        })
    }

    /// A budget for a run at full size that begins or goes on.
    pub fn new(seconds: f64, cpu: bool, most: u32) -> Self {
        Self {
            seconds,
            cpu,
            most,
            planned: 0,
            sizes: vec![TrainingSize::Full],
            model: ErrorModel { even: 0 },
            at_full_size: None,
        }
    }

    /// Shortest time that a measurement is of, seconds.
    pub fn shortest(budget: Option<&Self>) -> f64 {
        budget.filter(|b| b.cpu).map_or(0.0, |_| SHORTEST)
    }

    /// Seconds of training until the first plan at the latest.
    pub fn latest(budget: Option<&Self>) -> f64 {
        budget.map_or(LATEST_SECONDS, |budget| LATEST * budget.seconds)
    }

    /// Seconds of training, and of everything, on the clock that the budget goes by; on the wall's without one.
    pub fn spent(budget: Option<&Self>, clock: &Clock) -> (f64, f64) {
        match budget.is_some_and(|budget| budget.cpu) {
            true => (clock.cpu_seconds(), clock.all_cpu_seconds()),
            false => (clock.train_seconds(), clock.wall_seconds()),
        }
    }

    /// A length in a sentence.
    pub fn told(&self, length: &Length) -> String {
        let fit = format!(
            "about {} iterations fit into the time budget",
            length.iterations
        );
        let [num, den] = length.size.fraction();
        match self.at_full_size {
            Some(few) => format!("{fit} at {num}/{den} of the photos' size ({few} at all of it)"),
            None => fit,
        }
    }

    /// The length of the run if another than `length` fits better: asked between two iterations, answered after a measurement. The first plan
    /// chooses the size of the photos, too.
    pub fn length(
        &mut self,
        done: u32,
        length: u32,
        forecast: &Forecast,
        spent: f64,
    ) -> Option<Length> {
        if forecast.measured() == self.planned || spent >= self.seconds {
            return None;
        }
        let first = self.planned == 0;
        self.planned = forecast.measured();
        let left = self.seconds.mul_add(PLANNED, -spent);
        let (iterations, size) = match first {
            true => self.first_plan(done, left, forecast),
            false => (self.most_that_fit(done, left, forecast), forecast.size()),
        };
        let little = (length.saturating_sub(done) / STEADY).max(1);
        // The first plan is recorded whatever it is: who repeats the run need not plan.
        (first || iterations.abs_diff(length) > little).then_some(Length {
            from: done,
            iterations,
            size,
        })
    }

    /// Iterations of the run, and the size of photos of which so many as fit promise the least error.
    fn first_plan(&mut self, done: u32, left: f64, forecast: &Forecast) -> (u32, TrainingSize) {
        let fit = |size: &TrainingSize| {
            let at_size = forecast.at_size(*size);
            (self.most_that_fit(done, left, &at_size), *size)
        };
        let plans: Vec<_> = self.sizes.iter().map(fit).collect();
        let error = |plan: &(u32, TrainingSize)| self.model.error(plan.0, plan.1);
        let best = plans.iter().min_by(|a, b| error(a).total_cmp(&error(b)));
        let plan = best.copied().unwrap_or((self.most, forecast.size()));
        let full = plans.iter().find(|(_, size)| size.is_full());
        self.at_full_size = full.filter(|_| !plan.1.is_full()).map(|(n, _)| *n);
        plan
    }

    /// The longest run that fits into the time that is left, by bisection: it needs the more the longer it is.
    fn most_that_fit(&self, done: u32, left: f64, forecast: &Forecast) -> u32 {
        let fits = |n: u32| forecast.left(done, n).is_some_and(|needs| needs <= left);
        let (mut low, mut high) = (done + 1, self.most.max(done + 1));
        while low < high {
            let middle = low + (high - low).div_ceil(2);
            if fits(middle) {
                low = middle;
            } else {
                high = middle - 1;
            }
        }
        low
    }
}

#[cfg(test)]
mod tests {
    use super::{Budget, CPU_TICK, LATEST, SHORTEST};
    use crate::config::{TrainConfig, TrainingSize};
    use crate::run::forecast::{Every, Forecast, Made, picture_cost};
    use crate::run::forecast_tests::{EVERY, GAUSSIANS, PICTURES};
    use crate::train::sizes::Sizes;

    fn forecast(seconds: f64) -> Forecast {
        // 50 views are shown and 8 of 0.3 megapixels scored at the end.
        let (sizes, latest) = (Sizes::at_shares(&[0.05, 0.1]), LATEST * seconds);
        Forecast::of(sizes, 50, (8, 2_400_000), EVERY, latest, PICTURES)
    }

    /// Seconds of a run in which an iteration takes `cost` of its share of the run and its number, the last length, and how often
    /// it was changed. An evaluation takes as much as three iterations, if there is time for it.
    fn end(seconds: f64, most: u32, cost: impl Fn(f64, u32) -> f64) -> (f64, u32, usize) {
        let mut budget = Budget::new(seconds, false, most);
        let mut forecast = forecast(seconds);
        let (mut used, mut all, mut length, mut done, mut changes) = (0.5, 0.8, most, 0, 0);
        forecast.iterated(done, length, used, GAUSSIANS);
        while done < length {
            let one = cost(f64::from(done) / f64::from(length), done);
            (used, all) = (used + one, all + one);
            done += 1;
            if done.is_multiple_of((length / 20).max(1))
                && forecast.affords_evaluation(done, length, all)
            {
                forecast.evaluated(3.0 * one);
                all += 3.0 * one;
            }
            forecast.iterated(done, length, used, GAUSSIANS);
            if let Some(next) = budget.length(done, length, &forecast, all) {
                let n = next.iterations;
                assert!(n > done && n <= most, "{n} of {most} after {done}");
                length = n;
                changes += 1;
            }
        }
        (all + forecast.end(length).unwrap_or(0.0), length, changes)
    }

    /// Longest plan of a run of 2 CPU seconds, an iteration of which takes no, one or six ticks of the clock, with measurements of so many
    /// seconds at least.
    fn longest(shortest: f64) -> u32 {
        let (mut budget, mut forecast) = (Budget::new(2.0, true, 30_000), forecast(2.0));
        forecast.meter = forecast.meter.with_shortest(shortest);
        let (mut used, mut length, mut longest) = (0.5, 30_000, 0);
        for done in 0..150 {
            forecast.iterated(done, length, used, GAUSSIANS);
            used += CPU_TICK * [0.0, 0.0, 0.0, 0.0, 0.0, 6.0, 1.0][done as usize % 7];
            if let Some(next) = budget.length(done, length, &forecast, used) {
                length = next.iterations;
                longest = longest.max(length);
            }
        }
        longest
    }

    #[test]
    fn ticks_of_the_clock_are_not_measured() {
        let all = longest(SHORTEST);
        assert!(all < 400, "{all}");
        assert!(longest(0.0) > 4 * all);
    }

    fn growing(share: f64) -> f64 {
        let size = match share {
            s if s < 0.05 => 0.2,
            s if s < 0.1 => 0.5,
            _ => 1.0,
        };
        size * (0.4 + 1.6 * share)
    }

    #[test]
    fn runs_of_any_growth_end_within_two_percent() {
        let noise = |i: u32| 1.0 + 0.3 * f64::from(i % 7) / 7.0;
        for seconds in [20.0, 60.0, 600.0] {
            for unit in [2e-3, 0.02, 0.1] {
                for (name, (used, length, changes)) in [
                    ("even", end(seconds, 30_000, |_, _| unit)),
                    ("growing", end(seconds, 30_000, |s, _| unit * growing(s))),
                    ("falling", end(seconds, 30_000, |s, _| unit * (1.5 - s))),
                    (
                        "noisy",
                        end(seconds, 30_000, |s, i| unit * growing(s) * noise(i)),
                    ),
                ] {
                    // Two iterations more or less are no fault of the plan.
                    let off = (used - seconds).abs() / seconds - 4.0 * unit / seconds;
                    let what = format!("{name}: {used:.2} of {seconds} s, {length} iterations");
                    assert!(off < 0.02 || (used < seconds && length == 30_000), "{what}");
                    assert!(changes < 200, "{what}");
                }
            }
        }
    }

    /// Whoever shares the machine from the middle of the run on costs iterations and not the end of the schedules.
    #[test]
    fn a_run_that_slows_down_is_shortened() {
        let slower = |s: f64, i: u32| 0.02 * growing(s) * if i > 1000 { 1.7 } else { 1.0 };
        let (used, length, _) = end(60.0, 30_000, slower);
        let (_, alone, _) = end(60.0, 30_000, |s, _| 0.02 * growing(s));
        assert!(
            length < alone && used < 60.0 && used > 58.0,
            "{used} {length} {alone}"
        );
    }

    #[test]
    fn a_budget_that_is_more_than_enough_changes_nothing() {
        let (used, length, changes) = end(600.0, 1500, |_, _| 0.01);
        assert!(length == 1500 && changes == 1 && used < 25.0);
    }

    #[test]
    fn iterations_of_seconds_are_planned_before_twenty() {
        // Smaller photos, with which a run begins, cost less.
        let cost = |share: f64, _| match share {
            s if s < 0.05 => 1.0,
            s if s < 0.1 => 1.3,
            _ => 2.0,
        };
        let (used, length, _) = end(70.0, 30_000, cost);
        assert!(
            (10..=25).contains(&length) && used < 75.0,
            "{length} {used}"
        );
    }

    /// Size of the photos that the first plan chooses of some, and the length, in a run of 20 ms an iteration.
    fn first_plan(
        seconds: f64,
        config: &TrainConfig,
        sizes: &[TrainingSize],
    ) -> (TrainingSize, u32) {
        let config = TrainConfig {
            time_budget: Some(seconds),
            ..config.clone()
        };
        let mut budget = Budget::of(&config, sizes.to_vec()).unwrap();
        let mut forecast = forecast(seconds).at_size(sizes[sizes.len() - 1]);
        forecast.iterated(0, 1000, 0.0, GAUSSIANS);
        forecast.iterated(20, 1000, 0.4, GAUSSIANS);
        let length = budget.length(20, 1000, &forecast, 0.4).unwrap();
        let told = budget.told(&length);
        let smaller = length.size != sizes[0];
        assert_eq!(smaller, told.contains("of the photos' size"), "{told}");
        (length.size, length.iterations)
    }

    #[test]
    fn photos_are_smaller_where_few_iterations_fit() {
        let mut config = TrainConfig::default();
        let all = TrainingSize::ALL;
        let [full, quarters, sixteenths] = all;
        let size = |seconds, config: &TrainConfig| first_plan(seconds, config, &all).0;
        for (seconds, chosen) in [(40.0, full), (20.0, quarters), (8.0, sixteenths)] {
            assert_eq!(size(seconds, &config), chosen, "{seconds} s");
        }
        // Smaller photos leave room for more iterations.
        let [whole, smaller] = [0, 1200].map(|even| {
            config.work.resolution_iterations = even;
            first_plan(20.0, &config, &all).1
        });
        assert!(smaller > whole, "{smaller} {whole}");
        // Nobody gets more than are asked for, nor another size than there is to choose.
        config.iterations = 200;
        assert_eq!(size(20.0, &config), full);
        config.iterations = 30_000;
        for one in all {
            assert_eq!(first_plan(8.0, &config, &[one]).0, one);
        }
        assert_eq!(first_plan(8.0, &config, &all[..2]).0, quarters);
        // Where smaller photos lose more of what is to be learnt.
        config.work.resolution_iterations = 600;
        assert_eq!(size(20.0, &config), full);
        config.work.resolution_iterations = 0;
        assert_eq!(size(8.0, &config), full);
        config.work.resolution_iterations = 100_000;
        assert_eq!(size(60.0, &config), sixteenths);
    }

    #[test]
    fn a_run_that_goes_on_forgets_what_its_start_took() {
        let mut budget = Budget::new(60.0, false, 30_000);
        let mut forecast = forecast(60.0);
        forecast.iterated(300, 1000, 30.0, GAUSSIANS);
        let next = (301..400).find_map(|at| {
            let used = 30.0 + 0.04 * f64::from(at - 300);
            forecast.iterated(at, 1000, used, GAUSSIANS);
            budget.length(at, 1000, &forecast, used)
        });
        assert!((500..1300).contains(&next.unwrap().iterations), "{next:?}");
    }

    /// Without a budget: as many evaluations as cost a twentieth of the run, evenly spread, the same whatever the clock says.
    #[test]
    fn evaluations_without_a_budget_keep_their_share() {
        let made = Made::AsLengthAllows;
        let every = Every { made, ..EVERY };
        let made = |length: u32, views: usize| -> Vec<u32> {
            let sizes = Sizes::at_shares(&[0.01]);
            let mut forecast = Forecast::of(sizes, 0, (views, 0), every, 20.0, PICTURES);
            let due = |of: &Forecast| -> Vec<u32> {
                let due = (1..20).map(|k| k * (length / 20));
                due.filter(|at| of.affords_evaluation(*at, length, 1e9))
                    .collect()
            };
            let first = due(&forecast);
            for done in [0, 100] {
                forecast.iterated(done, length, 0.5 * f64::from(done), 1e6);
            }
            forecast.grown(100, [1_000_000, 500_000], 1.0);
            forecast.evaluated(100.0);
            assert_eq!(due(&forecast), first, "nothing that is measured counts");
            first
        };
        assert_eq!(made(7000, 10).len(), 19, "all are cheap");
        assert_eq!(made(1500, 0).len(), 19, "nothing is held out");
        // 40 views are scored at about the cost of 15 iterations.
        assert_eq!(made(1500, 40), [300, 600, 900, 1200]);
        assert_eq!(made(1500, 4000), [] as [u32; 0]);
        let (made, sizes) = (Made::All, Sizes::default());
        let asked = Forecast::of(sizes, 0, (4000, 0), Every { made, ..EVERY }, 20.0, PICTURES);
        assert!(asked.affords_evaluation(75, 1500, 0.0));
    }

    /// A decision on the way takes a second in which a thousand iterations could be done.
    #[test]
    fn what_takes_time_beside_iterations_is_not_taken_for_them() {
        let left = |disturbed: bool| {
            let mut forecast = forecast(60.0);
            for done in 0..=40 {
                let extra = if done > 30 { 1.0 } else { 0.0 };
                if disturbed && done == 31 {
                    forecast.disturbed();
                }
                forecast.iterated(done, 1000, 1e-3 * f64::from(done) + extra, GAUSSIANS);
            }
            forecast.left(40, 1000).unwrap()
        };
        assert!(
            left(false) > 3.0 * left(true),
            "{} {}",
            left(false),
            left(true)
        );
    }

    #[test]
    fn the_end_is_told_from_what_pictures_take_here() {
        let measured = picture_cost().unwrap();
        let end = |pictures: f64| {
            let (sizes, views) = (Sizes::default(), (8, 2_400_000));
            let mut forecast = Forecast::of(sizes, 0, views, EVERY, 20.0, pictures);
            forecast.iterated(0, 1000, 0.0, GAUSSIANS);
            forecast.iterated(20, 1000, 0.2, GAUSSIANS);
            forecast.end(1000).unwrap()
        };
        assert!(end(1e-12) < end(measured) && end(measured) < end(1e-3));
        // Six of the eight views are shown; whole views cost more than the probe.
        let shown = 6.0 * 300_000.0;
        let each = (end(2e-6) - end(1e-6)) / (1e-6 * shown);
        assert!((1.0..10.0).contains(&each), "{each}");
        assert!((end(3e-6) - end(2e-6) - each * 1e-6 * shown).abs() < 1e-9);
    }
}
