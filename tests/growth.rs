//! Expected numbers of Gaussians.

use mhsplat::Plan;
use mhsplat::TrainConfig;
use mhsplat::config::{MhConfig, Sampler};
use mhsplat::device::Device;
use mhsplat::run::initial_gaussians;
use mhsplat::train::growth::Growth;
use mhsplat::train::{Event, Trainer};

use crate::determinism::room;

const ITERATIONS: u32 = 450;

/// Density steps of a run, as expected before it and as they were: iterations done and Gaussians.
fn steps(sampler: Sampler) -> (usize, [Vec<(u32, f64)>; 2]) {
    let data = room(64);
    let config = TrainConfig {
        iterations: ITERATIONS,
        max_size: 64,
        sampler,
        // The set grows.
        mh: MhConfig {
            pair_pixels: 0.0,
            ..MhConfig::default()
        },
        ..TrainConfig::default()
    };
    let plan = Plan::new(&data, &config).unwrap();
    let splats = initial_gaussians(&data, &plan).unwrap();
    let mut trainer = Trainer::new(&Device::open(None).unwrap(), &data, &plan, &splats).unwrap();
    let first = trainer.gaussians();
    let growth = Growth::new(
        trainer.schedule().clone(),
        plan.strategy(),
        plan.most_gaussians.value,
    );
    let expected = growth.steps(0, first as f64, ITERATIONS);
    let longer = growth.steps(0, first as f64, 4 * ITERATIONS);
    assert!(longer.last() > expected.last(), "{longer:?}");
    let mut made = Vec::new();
    while trainer.iteration() < ITERATIONS {
        if let Event::Density(step) = trainer.advance().unwrap() {
            made.push((step.iteration, step.gaussians as f64));
        }
    }
    // What is left once some steps are over.
    let (at, n) = made[made.len() / 2];
    let rest = growth.steps(at, n, ITERATIONS);
    assert_eq!(rest.len(), made.len() - made.len() / 2 - 1);
    (first, [expected, made])
}

#[test]
fn steps_are_expected_when_they_come_and_about_the_size_of_the_scene() {
    let (first, [expected, made]) = steps(Sampler::Mh);
    let at = |steps: &[(u32, f64)]| steps.iter().map(|(at, _)| *at).collect::<Vec<_>>();
    assert_eq!(at(&expected), at(&made));
    let most = |steps: &[(u32, f64)]| steps.iter().map(|(_, n)| *n).fold(0.0, f64::max);
    let off = [
        most(&expected) / most(&made),
        expected.last().unwrap().1 / made.last().unwrap().1,
    ];
    assert!(off.iter().all(|o| (0.5..2.0).contains(o)), "{off:?}");
    // A set that stayed as it is would have been wrong.
    assert!(most(&made) > 2.0 * first as f64, "{first} {made:?}");
}

#[test]
fn growth_by_a_rate_is_expected_to_the_number() {
    let (_, [expected, made]) = steps(Sampler::Mcmc);
    assert_eq!(expected, made);
}

#[test]
fn a_fixed_set_stays() {
    let config = TrainConfig {
        sampler: Sampler::None,
        ..TrainConfig::default()
    };
    let plan = Plan::new(&room(64), &config).unwrap();
    let growth = Growth::new(plan.schedule(), plan.strategy(), None);
    assert_eq!(growth.steps(0, 10.0, 30_000), []);
}
