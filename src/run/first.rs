//! [`First`]: the cost of a run's first iterations, by the Gaussians that it begins with.

use crate::config::Init;
use crate::train::Plan;

/// Cost of an iteration at the beginning of a run over what pixels and the root of the number of Gaussians make of a later one, and
/// the share of the run after which nothing is left of that: sparse points are faint and far apart (docs/results/budgets.md).
const BEGINNING: f64 = 0.625;
pub(super) const GROWN: f64 = 0.2;

/// The same of random Gaussians, which are large, and the share after which they are like others.
const RANDOM: f64 = 1.8;
const SHRUNK: f64 = 0.03;

/// Gaussians that a run begins with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum First {
    /// A scene's.
    Trained,
    /// Sparse points.
    Points,
    /// Random ones.
    Random,
}

impl First {
    /// The first Gaussians of a plan.
    pub fn of(plan: &Plan) -> Self {
        match plan.config.init {
            _ if plan.random_start => Self::Random,
            Init::Points => Self::Points,
            _ => Self::Trained,
        }
    }

    /// Cost of an iteration at a share of the run over that of a later one of as many Gaussians.
    pub fn cost(self, share: f64) -> f64 {
        let grown = |share: f64| BEGINNING + (1.0 - BEGINNING) * (share / GROWN).min(1.0);
        match self {
            Self::Trained => 1.0,
            Self::Random if share < SHRUNK => {
                RANDOM * (grown(SHRUNK) / RANDOM).powf(share / SHRUNK)
            }
            Self::Points | Self::Random => grown(share),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{First, GROWN, SHRUNK};
    use crate::run::budget::Budget;
    use crate::run::forecast::{Every, Forecast, Made};
    use crate::train::sizes::Sizes;

    const EVERY: Every = Every {
        evaluation: None,
        made: Made::AsTimeAllows,
        checkpoint: 0,
    };

    /// Lengths that a budget plans of a run whose iterations take 10 ms after a beginning that costs what is known of one.
    fn lengths(seconds: f64, expected: First, real: First) -> Vec<u32> {
        let mut budget = Budget::new(seconds, false, 30_000);
        let mut forecast = Forecast::of(Sizes::default(), 0, (0, 0), EVERY, 0.1 * seconds, 1e-7);
        forecast.first = expected;
        let (mut used, mut length, mut lengths, mut done) = (0.0, 30_000, Vec::new(), 0);
        while done < length {
            forecast.iterated(done, length, used, 1.0);
            if let Some(next) = budget.length(done, length, &forecast, used) {
                length = next.iterations;
                lengths.push(length);
            }
            used += 0.01 * real.cost(f64::from(done) / (100.0 * seconds));
            done += 1;
        }
        lengths
    }

    #[test]
    fn the_first_plan_knows_what_later_iterations_cost() {
        for first in [First::Points, First::Random] {
            for seconds in [15.0, 60.0, 180.0] {
                let told = lengths(seconds, first, first);
                let (begun, end) = (f64::from(told[0]), f64::from(told[told.len() - 1]));
                assert!(
                    (begun / end - 1.0).abs() < 0.15,
                    "{first:?}, {seconds} s: {told:?}"
                );
                let untold = lengths(seconds, First::Trained, first);
                assert!((f64::from(untold[0]) / end - 1.0).abs() > 0.3, "{untold:?}");
            }
        }
    }

    #[test]
    fn costs_of_the_beginning_end_in_those_of_later() {
        for first in [First::Trained, First::Points, First::Random] {
            assert_eq!(first.cost(GROWN), 1.0);
            assert_eq!(first.cost(1.0), 1.0);
        }
        let [before, after] = [-1e-9, 1e-9].map(|by| First::Random.cost(SHRUNK + by));
        assert!((before - after).abs() < 1e-6);
        assert!(First::Random.cost(0.0) > 1.0 && First::Points.cost(0.0) < 1.0);
    }
}
