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

/// An overflow of tile intersections takes training back: over the end of a window, where photos grow, and both.
#[test]
fn going_back_measures_nothing() {
    let left = |order: &[u32]| {
        let mut forecast = forecast(&[0.021]);
        let mut seconds = 0.0;
        for done in (0..20).chain(order.iter().copied()).chain(23..=60) {
            forecast.iterated(done, 1000, seconds, GAUSSIANS);
            // All of these together take no time, however often they are done.
            seconds += if order.contains(&done) { 0.0 } else { 1.0 };
        }
        forecast.left(60, 1000).unwrap() - forecast.end(1000).unwrap()
    };
    let straight = left(&[20, 21, 22]);
    assert!((1000.0..1200.0).contains(&straight), "{straight}");
    for order in [
        &[20, 19, 20, 21, 22][..],
        &[20, 21, 20, 19, 20, 21, 22],
        &[20, 21, 22, 21, 20, 21, 22],
    ] {
        let back = left(order);
        assert!((back / straight - 1.0).abs() < 0.04, "{back} {straight}");
    }
    let mut forecast = forecast(&[0.05, 0.1]);
    for (seconds, done) in [0, 20, 19, 18, 19, 20, 21, 40].into_iter().enumerate() {
        forecast.iterated(done, 1000, seconds as f64, GAUSSIANS);
    }
    let left = forecast.left(40, 1000).unwrap();
    assert!((10.0..600.0).contains(&left), "{left}");
}

/// The schedule of a run of so many iterations.
fn schedule(iterations: u32, sampler: Sampler) -> Schedule {
    Schedule::new(&TrainConfig {
        sampler,
        iterations,
        ..TrainConfig::default()
    })
}

/// A run that is shortened, be it told before the iteration or after it, has larger photos at once: no window has photos of both sizes.
#[test]
fn windows_have_photos_of_one_size() {
    for last in [149, 150] {
        let mut forecast = forecast(&[0.1]);
        let mut seconds = 0.0;
        for done in 0..=175 {
            let length = if done <= last { 2000 } else { 1000 };
            forecast.iterated(done, length, seconds, GAUSSIANS);
            if done == 150 && last == 150 {
                forecast.follow(&schedule(1000, Sampler::Mh), done);
            }
            seconds += if done < 150 { 0.066 } else { 0.1 };
        }
        let left = forecast.left(175, 1000).unwrap() - forecast.end(1000).unwrap();
        assert!((left - 82.5).abs() < 3.0, "{left}");
    }
}

/// A run is shortened when a window is long enough to be closed; the first iteration of larger photos takes ten seconds.
#[test]
fn the_first_iteration_of_larger_photos_is_in_no_window_of_smaller_ones() {
    let mut forecast = forecast(&[0.1]);
    for done in 0..=120 {
        forecast.iterated(done, 1300, 0.066 * f64::from(done), GAUSSIANS);
    }
    let unit = forecast.meter.unit(1150).unwrap();
    forecast.follow(&schedule(1150, Sampler::Mh), 120);
    forecast.iterated(121, 1150, 0.066 * 120.0 + 10.0, GAUSSIANS);
    assert_eq!(forecast.meter.unit(1150), Some(unit));
}

/// Time left after 300 of 1000 iterations of half a second, with density steps of so many seconds each, and the unit of iterations. The
/// schedule may be told anew right before each step.
fn with_steps(step: f64, follows: bool) -> (f64, f64) {
    let schedule = schedule(1000, Sampler::Mcmc);
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
            if follows {
                forecast.follow(&schedule, done);
            }
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
    let schedule = schedule(1000, Sampler::Mcmc);
    let steps = (301..1000).filter(|at| schedule.density_due(*at).is_some());
    let steps = steps.count() as f64;
    for follows in [false, true] {
        let (without, unit) = with_steps(0.0, follows);
        let (with, same) = with_steps(40.0, follows);
        assert!((unit / same - 1.0).abs() < 1e-6, "{unit} {same}");
        // The guess counts as one of those so far.
        let each = (with - without) / steps;
        assert!((25.0..=40.0).contains(&each), "{each}");
    }
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
