//! Tests of the values that the trainer passes to stages and strategies: numbers of steps, rates, seeds, progress.

mod definitions;
mod statistics;
mod steps;

use mhsplat::config::{Length, Sampler};
use mhsplat::device::Device;
use mhsplat::evaluate::{Scores, ViewScore};
use mhsplat::run::{FinalRecord, initial_gaussians};
use mhsplat::scene::{Gaussians, Plane};
use mhsplat::train::Event;
use mhsplat::train::Trainer;
use mhsplat::train::schedule::Schedule;
use mhsplat::{Plan, TrainConfig};

use crate::determinism::room;

pub fn config(iterations: u32, seed: u64, noise_rate: f64) -> TrainConfig {
    let mut config = TrainConfig {
        sampler: Sampler::Mcmc,
        iterations,
        max_size: 64,
        sh_degree: 1,
        seed,
        ..TrainConfig::default()
    };
    config.work.resolution_levels = 0;
    config.mcmc.noise_rate = noise_rate;
    config
}

/// The scene after one iteration on one view; all begin with the same Gaussians, as faint as the noise's gate needs.
pub fn after_one(config: &TrainConfig) -> (Gaussians, Gaussians) {
    let mut data = room(64);
    data.train.truncate(1);
    let first = TrainConfig {
        seed: 0,
        ..config.clone()
    };
    let mut start = initial_gaussians(&data, &Plan::new(&data, &first).unwrap()).unwrap();
    start.plane_mut(Plane::OPACITY).fill(-4.0);
    let plan = Plan::new(&data, config).unwrap();
    let mut trainer = Trainer::new(&Device::open(None).unwrap(), &data, &plan, &start).unwrap();
    trainer.advance_to(1).unwrap();
    (start, trainer.state().unwrap().splats)
}

/// Largest difference of the positions of two scenes.
fn apart(a: &Gaussians, b: &Gaussians) -> f64 {
    let pairs = (0..3).flat_map(|k| a.planes()[k].iter().zip(&b.planes()[k]));
    pairs
        .map(|(x, y)| f64::from((x - y).abs()))
        .fold(0.0, f64::max)
}

#[test]
fn the_first_step_of_training_is_the_learning_rate() {
    let config = config(2000, 0, 0.0);
    let (before, after) = after_one(&config);
    let rate = Schedule::new(&config).rates(0).opacity;
    let moved = before.planes()[Plane::OPACITY]
        .iter()
        .zip(&after.planes()[Plane::OPACITY])
        .map(|(a, b)| f64::from((a - b).abs()));
    let largest = moved.fold(0.0, f64::max);
    assert!((largest / rate - 1.0).abs() < 1e-3, "{largest} of {rate}");
}

/// A run of 30,000 iterations that is planned anew, as one of 1500, after six: the bias of the second moment is that of the decays that there were; by the present one alone steps were 1.48 times as large.
#[test]
fn steps_after_another_length_correct_the_bias_that_there_is() {
    let mut config = config(30_000, 0, 0.0);
    config.set_length(Length::new(6, 1500));
    let data = room(64);
    let plan = Plan::new(&data, &config).unwrap();
    let start = initial_gaussians(&data, &plan).unwrap();
    let mut trainer = Trainer::new(&Device::open(None).unwrap(), &data, &plan, &start).unwrap();
    let states = [9, 10].map(|iteration| {
        trainer.advance_to(iteration).unwrap();
        trainer.state().unwrap()
    });
    let beta1: f64 = config.optimizer.beta1;
    let decays = [0.999_f64.powi(6), 0.984_f64.powi(4)];
    let bias = [beta1.powi(10), decays[0] * decays[1]].map(|left| 1.0 - left);
    let rate = Schedule::new(&config).rates(9).opacity;
    let [before, after] = [0, 1].map(|k| &states[k].splats.planes()[Plane::OPACITY]);
    let rows = &states[1].rows;
    let [m, v] = [&rows.moment1, &rows.moment2].map(|planes| &planes[Plane::OPACITY]);
    let steps = (0..start.len()).filter(|i| v[*i] > 1e-12).map(|i| {
        let [m, v] = [m[i], v[i]].map(f64::from);
        let wanted = rate * (m / bias[0]) / (v / bias[1]).sqrt();
        (f64::from(before[i] - after[i]), wanted)
    });
    let steps: Vec<_> = steps
        .filter(|(_, wanted)| wanted.abs() > 0.3 * rate)
        .collect();
    assert!(steps.len() > 100);
    for (step, wanted) in steps {
        assert!((step / wanted - 1.0).abs() < 1e-3, "{step} of {wanted}");
    }
}

#[test]
fn noise_depends_on_the_seed() {
    let scenes = [0, 0, 1].map(|seed| after_one(&config(2000, seed, 5e5)).1);
    assert_eq!(apart(&scenes[0], &scenes[1]), 0.0);
    assert!(apart(&scenes[0], &scenes[2]) > 0.0);
    // Nothing else of one iteration does.
    let scenes = [0, 1].map(|seed| after_one(&config(2000, seed, 0.0)).1);
    assert_eq!(apart(&scenes[0], &scenes[1]), 0.0);
}

#[test]
fn noise_of_a_short_run_is_that_of_a_long_one() {
    let noise = [2000, 30_000].map(|iterations| {
        let [with, without] = [5e5, 0.0].map(|rate| after_one(&config(iterations, 0, rate)).1);
        apart(&with, &without)
    });
    assert!(noise[0] > 0.0);
    // It follows the covariances after Adam's step, which is larger in the short run; with that step's rate it were 7 times as large.
    assert!((noise[0] / noise[1] - 1.0).abs() < 0.2, "{noise:?}");
}

#[test]
fn progress_runs_from_the_first_density_step_to_the_end_of_the_span() {
    let data = room(64);
    let config = TrainConfig {
        sampler: Sampler::Mh,
        ..config(300, 0, 0.0)
    };
    let plan = Plan::new(&data, &config).unwrap();
    let start = initial_gaussians(&data, &plan).unwrap();
    let mut trainer = Trainer::new(&Device::open(None).unwrap(), &data, &plan, &start).unwrap();
    let mut steps = 0;
    loop {
        match trainer.advance().unwrap() {
            Event::Density(event) => {
                // From 500 to 20,000 of 30,000.
                let expected = f64::from(event.iteration - 5) / 195.0;
                assert!((event.progress - expected).abs() < 1e-12, "{event:?}");
                steps += 1;
            }
            Event::Finished => break,
            _ => (),
        }
    }
    assert!(steps > 4);
}

#[test]
fn scores_are_means_over_views_and_not_of_pooled_errors() {
    let view = |psnr: f64| ViewScore {
        scores: Scores {
            psnr,
            ssim: psnr / 100.0,
            ..Scores::default()
        },
        ..ViewScore::default()
    };
    let scores = FinalRecord::of(vec![view(20.0), view(40.0)]).unwrap().mean;
    assert_eq!(scores.psnr, 30.0);
    assert!((scores.ssim - 0.3).abs() < 1e-12);
}
