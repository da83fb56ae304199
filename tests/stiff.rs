//! Training from starts that plain settings do not survive: finite throughout, and it ends with the best it had.

use crate::determinism::room;
use mhsplat::Plan;
use mhsplat::base::rng::{Philox, Stream};
use mhsplat::capture::Dataset;
use mhsplat::config::{AdcConfig, Sampler, TrainConfig};
use mhsplat::device::Device;
use mhsplat::run::initial_gaussians;
use mhsplat::scene::{Gaussians, Plane};
use mhsplat::train::Trainer;

const ITERATIONS: u32 = 240;

fn config(sampler: Sampler) -> TrainConfig {
    TrainConfig {
        sampler,
        iterations: ITERATIONS,
        max_size: 64,
        sh_degree: 1,
        max_gaussians: Some(6000),
        adc: AdcConfig {
            // Short as the run is, a reset would leave no time to recover.
            reset_interval: 1_000_000,
            ..AdcConfig::default()
        },
        ..TrainConfig::default()
    }
}

/// Losses after every tenth of the run, and the scene at its end.
fn train(data: &Dataset, config: &TrainConfig, start: &Gaussians) -> (Vec<f64>, Gaussians) {
    let device = Device::open(None).unwrap();
    let mut trainer =
        Trainer::new(&device, data, &Plan::new(data, config).unwrap(), start).unwrap();
    let mut losses = Vec::new();
    for tenth in 1..=10 {
        trainer.advance_to(tenth * ITERATIONS / 10).unwrap();
        losses.push(trainer.recent_loss().unwrap().unwrap());
    }
    assert_eq!(trainer.non_finite(), 0);
    (losses, trainer.state().unwrap().splats)
}

/// Trains with every sampler; every loss is finite, the last is close to the best, and less than the first where there is
/// something to learn from.
fn survives(name: &str, data: &Dataset, change: impl Fn(&mut Gaussians)) {
    for sampler in [Sampler::Mh, Sampler::Mcmc, Sampler::Adc, Sampler::None] {
        let config = config(sampler);
        let mut start = initial_gaussians(data, &Plan::new(data, &config).unwrap()).unwrap();
        change(&mut start);
        let (losses, scene) = train(data, &config, &start);
        let finite = |p: &Vec<f32>| p.iter().all(|v| v.is_finite());
        assert!(scene.planes().iter().all(finite), "{name}, {sampler:?}");
        let best = losses.iter().copied().fold(f64::INFINITY, f64::min);
        let last = losses[losses.len() - 1];
        println!(
            "{name}, {sampler:?}: loss {:.4} -> {last:.4}, best {best:.4}, {} Gaussians",
            losses[0],
            scene.len()
        );
        assert!(losses.iter().all(|l| l.is_finite()), "{name}, {sampler:?}");
        assert!(last <= 1.1 * best, "{name}, {sampler:?}: {losses:?}");
        assert!(last < losses[0], "{name}, {sampler:?}: {losses:?}");
    }
}

fn shift_scales(by: f64) -> impl Fn(&mut Gaussians) {
    move |s: &mut Gaussians| {
        for p in Plane::LOG_SCALE..Plane::ROTATION {
            s.plane_mut(p).iter_mut().for_each(|l| *l += by.ln() as f32);
        }
    }
}

#[test]
fn initial_scales_wrong_by_a_hundred() {
    survives("scales x 100", &room(64), shift_scales(100.0));
    survives("scales / 100", &room(64), shift_scales(0.01));
}

#[test]
fn scales_over_six_orders_of_magnitude() {
    survives("scale variance 1e6", &room(64), |s| {
        for i in 0..s.len() {
            let u = Philox::uniform(3, Stream::Synthetic.stream(5), i as u64);
            let scale = |k: usize| (3e-7f64.ln() + u[k] * 1e6f64.ln()) as f32;
            s.scatter(Plane::LOG_SCALE, i, [scale(0), scale(1), scale(2)]);
        }
    });
}

#[test]
fn a_cloud_in_one_point_or_on_a_line() {
    survives("one point", &room(64), |s| {
        for i in 0..s.len() {
            s.scatter(Plane::POSITION, i, [0.0, 0.0, 0.0]);
        }
    });
    survives("a line", &room(64), |s| {
        for i in 0..s.len() {
            s.scatter(Plane::POSITION, i, [1e-3 * i as f32 - 2.0, 0.0, 0.0]);
        }
    });
}

#[test]
fn one_view_and_the_same_view_again_and_again() {
    let mut one = room(64);
    one.train.truncate(1);
    survives("one view", &one, |_| {});
    let mut again = room(64);
    let first = again.train[0].clone();
    again.train = vec![first; 12];
    survives("twelve times the same view", &again, |_| {});
}

#[test]
fn opacities_at_both_ends() {
    survives("opacity logits of 12 and -12", &room(64), |s| {
        for i in 0..s.len() {
            s.scatter(Plane::OPACITY, i, [if i % 2 == 0 { 12.0 } else { -12.0 }]);
        }
    });
}
