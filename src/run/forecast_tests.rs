//! Tests of [`Forecast`], and what others share with them.

use crate::config::{McmcConfig, Sampler, TrainConfig};
use crate::density::Mcmc;
use crate::run::cost::{TYPICAL, cost};
use crate::run::forecast::{Every, Forecast, Made};
use crate::train::growth::Growth;
use crate::train::schedule::Schedule;
use crate::train::sizes::Sizes;

/// Distances of evaluations and checkpoints.
pub(super) const EVERY: Every = Every {
    evaluation: None,
    made: Made::AsTimeAllows,
    checkpoint: 1000,
};

/// Seconds per pixel of a view's pictures.
pub(super) const PICTURES: f64 = 1e-7;

/// Gaussians of all runs, those that a forecast begins with.
pub(super) const GAUSSIANS: f64 = TYPICAL;

/// Pixels of the photos of [`Forecast::of`].
const PIXELS: f64 = 43_000.0;

/// A forecast of photos whose sizes end at shares of the run, with no views to score.
fn forecast(shares: &[f64]) -> Forecast {
    Forecast::of(Sizes::at_shares(shares), 0, (0, 0), EVERY, 20.0, PICTURES)
}

/// An overflow of tile intersections takes training back: past the end of a window, where photos grow, and both.
#[test]
fn going_back_measures_nothing() {
    let left = |order: &[u32]| {
        let mut forecast = forecast(&[0.021]);
        let mut seconds = 0.0;
        for done in (0..20).chain(order.iter().copied()).chain(23..=60) {
            forecast.iterated(done, 1000, seconds, GAUSSIANS);
            // Those that are repeated take no time.
            seconds += if order.contains(&done) { 0.0 } else { 1.0 };
        }
        forecast.left(60, 1000).unwrap() - forecast.end(1000).unwrap()
    };
    let straight = left(&[20, 21, 22]);
    for order in [
        &[20, 19, 20, 21, 22][..],
        &[20, 21, 20, 19, 20, 21, 22],
        &[20, 21, 22, 21, 20, 21, 22],
    ] {
        let back = left(order);
        assert!((back / straight - 1.0).abs() < 0.1, "{back} {straight}");
    }
}

/// A run that is shortened has larger photos at once: no window has photos of both sizes.
#[test]
fn windows_have_photos_of_one_size() {
    let mut forecast = forecast(&[0.1]);
    let schedule = |iterations: u32| {
        Schedule::new(&TrainConfig {
            iterations,
            ..TrainConfig::default()
        })
    };
    let mut seconds = 0.0;
    for done in 0..=175 {
        let length = if done <= 150 { 2000 } else { 1000 };
        forecast.iterated(done, length, seconds, GAUSSIANS);
        if done == 150 {
            forecast.follow(&schedule(1000), done);
        }
        seconds += if done < 150 { 0.066 } else { 0.1 };
    }
    let left = forecast.left(175, 1000).unwrap() - forecast.end(1000).unwrap();
    assert!((left - 82.5).abs() < 3.0, "{left}");
}

/// Time left after 300 of 1000 iterations of half a second, with density steps of so many seconds each, and the unit of iterations.
fn with_steps(sampler: Sampler, step: f64) -> (f64, f64) {
    let config = TrainConfig {
        sampler,
        iterations: 1000,
        ..TrainConfig::default()
    };
    let schedule = Schedule::new(&config);
    let strategy = std::sync::Arc::new(Mcmc::new(&McmcConfig {
        growth: 1.0,
        ..McmcConfig::default()
    }));
    let mut forecast = forecast(&[]);
    forecast.growth = Some(Growth::new(schedule.clone(), strategy, None));
    let mut seconds = 0.0;
    for done in 0..=300 {
        forecast.iterated(done, 1000, seconds, GAUSSIANS);
        if schedule.density_due(done).is_some() {
            seconds += step;
            forecast.grown(done, [GAUSSIANS as u64, 0], step);
        }
        seconds += 0.5;
    }
    let left = forecast.left(300, 1000).unwrap() - forecast.end(1000).unwrap();
    (left, forecast.meter.unit(1000).unwrap())
}

/// Density steps to come take their time, and iterations cost what they cost without.
#[test]
fn density_steps_are_apart_from_iterations() {
    let (without, unit) = with_steps(Sampler::Mcmc, 0.0);
    let (with, same) = with_steps(Sampler::Mcmc, 40.0);
    assert!((unit / same - 1.0).abs() < 1e-6, "{unit} {same}");
    let schedule = Schedule::new(&TrainConfig {
        sampler: Sampler::Mcmc,
        iterations: 1000,
        ..TrainConfig::default()
    });
    let steps = (301..1000).filter(|at| schedule.density_due(*at).is_some());
    let each = (with - without) / steps.count() as f64;
    // The guess counts as one of those so far.
    assert!((25.0..=40.0).contains(&each), "{each}");
}

/// Largest error of the time left, as a share of it, between two iterations of a run of these times.
fn worst(times: &[f64], [from, to]: [usize; 2]) -> f64 {
    let length = times.len() as u32;
    let mut forecast = forecast(&[0.05, 0.1]);
    let whole: f64 = times.iter().sum();
    let (mut used, mut worst) = (0.0, 0.0_f64);
    for (done, time) in times.iter().enumerate() {
        forecast.iterated(done as u32, length, used, GAUSSIANS);
        let left = forecast.left(done as u32, length);
        if (from..to).contains(&done) {
            let (told, end) = (left.unwrap(), forecast.end(length).unwrap());
            worst = worst.max(((told - end) / (whole - used) - 1.0).abs());
        }
        used += time;
    }
    worst
}

/// Seconds of the iterations of a run, by the share that is done.
fn times(length: usize, each: impl Fn(f64) -> f64) -> Vec<f64> {
    let share = |i| i as f64 / length as f64;
    (0..length).map(|i| each(share(i))).collect()
}

/// From the first tenth on, where the law of costs holds or is off by a seventh at smaller photos.
#[test]
fn time_left_is_told_from_the_first_tenth_on() {
    let by_law = |pixels: f64| cost(pixels, GAUSSIANS) / cost(PIXELS, GAUSSIANS);
    let smaller = |share: f64| match share {
        s if s < 0.05 => by_law(PIXELS / 16.0),
        s if s < 0.1 => by_law(PIXELS / 4.0),
        _ => 1.0,
    };
    for (length, later) in [(1500, 1.0), (7000, 1.416), (30_000, 1.81)] {
        // Iterations of long runs are quick at first.
        let early = |s: f64| 1.0 / (1.0 + (later - 1.0) * (1.0 - s / 0.15).max(0.0));
        let range = [length / 10, length * 9 / 10];
        for off in [0.86, 1.0, 1.14] {
            let each = |s: f64| smaller(s) * early(s) * if s < 0.1 { off } else { 1.0 };
            let worst = worst(&times(length, each), range);
            assert!(worst < 0.25, "{length} {off}: {worst}");
        }
        for change in [|s: f64| 1.2 - 0.4 * s, |s: f64| 0.7 + 1.2 * s * (1.0 - s)] {
            let each = |s: f64| smaller(s) * early(s) * change(s);
            let worst = worst(&times(length, each), range);
            assert!(worst < 0.25, "{length}: {worst}");
        }
    }
}

/// Smaller photos cost what no law says. The first window of larger ones counts half, so that the second tells.
#[test]
fn time_left_is_told_of_costs_that_change() {
    for unit in [2e-3, 0.02, 0.5] {
        for cost in [
            |_: f64| 1.0,
            |s: f64| 1.2 - 0.4 * s,
            |s: f64| 0.7 + 1.2 * s * (1.0 - s),
        ] {
            let size = |s: f64| if s < 0.1 { 0.4 } else { 1.0 };
            let worst = worst(&times(3000, |s| unit * size(s) * cost(s)), [430, 2700]);
            assert!(worst < 0.3, "{worst}");
        }
    }
}
