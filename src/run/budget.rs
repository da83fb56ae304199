//! Length of a run that fits a time budget: planned from the cost of an iteration, and corrected on the way.

use crate::config::{Length, TrainConfig};
use crate::train::Trainer;

/// Share of the budget that is planned for; the rest is left for what the plan does not foresee.
const PLANNED: f64 = 0.99;

/// Iterations before the first plan.
const FIRST: u32 = 20;

/// Share of the budget after which the first plan is made, if fewer have been done by then.
const LATEST: f64 = 0.1;

/// A run is planned anew after this share of its iterations.
const AGAIN: u32 = 50;

/// Cost of an iteration of photos at full size over its largest one, at the middle of each tenth of the run: it grows with the
/// births and falls with the deaths. Means of six datasets (plush, fox, lego, toys, tankard, outdoor; mh, 1500 and 3000
/// iterations, 200 and 240 px, CPU), which differ by a quarter from each other. What a run differs by from it is corrected on the way.
const COST: [f64; 10] = [0.6, 0.72, 0.9, 1.0, 0.98, 0.92, 0.8, 0.7, 0.68, 0.7];

/// Cost of an iteration at half and at a quarter of the photos' size over one at full size, of the same six datasets (0.3 to 0.5 and
/// 0.2 to 0.39).
const SMALLER: [f64; 2] = [0.42, 0.3];

/// Cost of showing a view at the end, to find the Gaussians that none shows, over that of an iteration then.
const SEEN: f64 = 0.15;

/// Configuration of a new run, and the lengths that it is to have later: those that it repeats, whatever its time budget.
pub(super) fn begin(mut config: TrainConfig) -> (TrainConfig, Vec<Length>) {
    let to_come = std::mem::take(&mut config.lengths);
    if !to_come.is_empty() {
        config.time_budget = None;
    }
    (config, to_come)
}

/// Configuration of a run that goes on after so many iterations, and the lengths that it is to have later.
pub(super) fn go_on(mut config: TrainConfig, done: u32) -> (TrainConfig, Vec<Length>) {
    let past = config.lengths.partition_point(|l| l.from <= done);
    let to_come = config.lengths.split_off(past);
    match config.time_budget {
        Some(_) => (config, Vec::new()),
        None => (config, to_come),
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
    /// The pace of a run that begins or goes on.
    pub fn new(trainer: &Trainer, to_come: Vec<Length>) -> Self {
        let config = &trainer.plan().config;
        if let Some(seconds) = config.time_budget {
            let length = f64::from(config.last_iterations());
            let share = f64::from(trainer.full_size_from()) / length;
            let halvings = trainer.plan().halvings.value;
            let ends = (1..=halvings).map(|k| share * f64::from(k) / f64::from(halvings));
            let views = match config.work.remove_unseen {
                true => trainer.views(),
                false => 0,
            };
            let budget = Budget::new(seconds, config.iterations, ends.collect(), views);
            return Self::Budget(budget);
        }
        match to_come.is_empty() {
            true => Self::Fixed,
            false => Self::Repeats(to_come.into_iter().rev().collect()),
        }
    }

    /// Another length for the run, if it is to have one from now on.
    pub fn length(&mut self, done: u32, length: u32, used: f64) -> Option<u32> {
        match self {
            Self::Fixed => None,
            Self::Budget(budget) => budget.length(done, length, used),
            Self::Repeats(to_come) => {
                let due = to_come.pop_if(|next| next.from <= done);
                due.map(|length| length.iterations)
            }
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

/// Plan of a run's length.
#[derive(Debug, Clone)]
pub(super) struct Budget {
    /// Training time, seconds.
    seconds: f64,
    /// Largest number of iterations.
    most: u32,
    /// Shares of the run at which the photos' sizes below the full one end.
    smaller: Vec<f64>,
    /// Views to be shown at the end.
    views: usize,
    /// Seconds of an iteration of cost 1; `None` before the first plan.
    unit: Option<f64>,
    /// Iterations and seconds at the last plan, at first when the run began or went on.
    mark: Option<(u32, f64)>,
    /// Iterations at the next one.
    next: u32,
}

impl Budget {
    /// A budget for a run that begins or goes on.
    pub fn new(seconds: f64, most: u32, smaller: Vec<f64>, views: usize) -> Self {
        Self {
            seconds,
            most,
            smaller,
            views,
            unit: None,
            mark: None,
            next: 0,
        }
    }

    /// The length of the run if another than `length` fits better: asked between two iterations, answered now and then.
    pub fn length(&mut self, done: u32, length: u32, used: f64) -> Option<u32> {
        let Some((before, then)) = self.mark else {
            // What came before, reading photos and building kernels, is no cost of iterations.
            self.mark = Some((done, used));
            self.next = done.saturating_add(FIRST);
            return None;
        };
        let first = self.unit.is_none();
        // Where an iteration takes seconds there is no time for so many.
        let late = first && used - then >= LATEST * (self.seconds - then);
        if done == before || (done < self.next && !late) || used >= self.seconds {
            return None;
        }
        let share = |at: u32| f64::from(at) / f64::from(length);
        let cost = f64::from(length) * self.cost(share(before), share(done));
        let unit = (used - then).max(1e-9) / cost.max(1e-9);
        // Half of what the last plan went by: a window is short, and other programs run beside it.
        let unit = self.unit.map_or(unit, |old| (old * unit).sqrt());
        self.unit = Some(unit);
        self.mark = Some((done, used));
        let left = self.seconds.mul_add(PLANNED, -used) / unit;
        let after = SEEN * self.views as f64 * COST[COST.len() - 1];
        let needs = |n: u32| f64::from(n) * self.cost(f64::from(done) / f64::from(n), 1.0) + after;
        // The longest run that fits, by bisection: it needs the more the longer it is.
        let (mut low, mut high) = (done + 1, self.most.max(done + 1));
        while low < high {
            let middle = low + (high - low).div_ceil(2);
            if needs(middle) <= left {
                low = middle;
            } else {
                high = middle - 1;
            }
        }
        self.next = done + (low / AGAIN).max(1);
        let little = (length.saturating_sub(done) / 200).max(1);
        // The first plan is recorded whatever it is: who repeats the run need not plan.
        (first || low.abs_diff(length) > little).then_some(low)
    }

    /// Mean cost of an iteration between two shares of a run, times their difference.
    fn cost(&self, from: f64, to: f64) -> f64 {
        let tenths = COST.len() as f64;
        let mut edges: Vec<f64> = (0..=COST.len()).map(|k| k as f64 / tenths).collect();
        edges.extend(&self.smaller);
        edges.extend([from, to]);
        edges.retain(|e| (from..=to).contains(e));
        edges.sort_by(f64::total_cmp);
        let piece = |pair: &[f64]| {
            let middle = 0.5 * (pair[0] + pair[1]);
            let tenth = ((middle * tenths) as usize).min(COST.len() - 1);
            let halvings = self.smaller.iter().filter(|end| middle < **end).count();
            let size = match halvings.min(SMALLER.len()) {
                0 => 1.0,
                k => SMALLER[k - 1],
            };
            (pair[1] - pair[0]) * COST[tenth] * size
        };
        edges.windows(2).map(piece).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::{Budget, SEEN};

    /// Seconds of a run in which an iteration takes `cost` of its share of the run and its number, the last length, and how often
    /// it was changed.
    fn end(seconds: f64, most: u32, cost: impl Fn(f64, u32) -> f64) -> (f64, u32, usize) {
        let mut budget = Budget::new(seconds, most, vec![0.05, 0.1], 50);
        let (mut used, mut length, mut done, mut changes) = (0.5, most, 0, 0);
        assert_eq!(budget.length(done, length, used), None);
        while done < length {
            used += cost(f64::from(done) / f64::from(length), done);
            done += 1;
            if let Some(n) = budget.length(done, length, used) {
                assert!(n > done && n <= most, "{n} of {most} after {done}");
                length = n;
                changes += 1;
            }
        }
        // The views that are shown at the end.
        used += 50.0 * SEEN * cost(1.0, done);
        (used, length, changes)
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
                    let off = used / seconds - 1.0;
                    let what = format!("{name}: {used:.2} of {seconds} s, {length} iterations");
                    assert!(
                        off.abs() < 0.02 || (off < 0.0 && length == 30_000),
                        "{what}"
                    );
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
        assert!(length == 1500 && changes == 1 && used < 20.0);
    }

    #[test]
    fn iterations_of_seconds_are_planned_before_twenty() {
        let (used, length, _) = end(50.0, 30_000, |_, _| 2.0);
        assert!(
            (10..=25).contains(&length) && used < 56.0,
            "{length} {used}"
        );
    }

    #[test]
    fn a_run_that_goes_on_forgets_what_its_start_took() {
        let mut budget = Budget::new(60.0, 30_000, vec![0.05, 0.1], 50);
        assert_eq!(budget.length(300, 1000, 30.0), None);
        let next =
            (301..400).find_map(|at| budget.length(at, 1000, 30.0 + 0.04 * f64::from(at - 300)));
        assert!((700..1300).contains(&next.unwrap()), "{next:?}");
    }
}
