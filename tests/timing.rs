//! Times of the stages: of a sample of the iterations, and of all where that is asked for.

use crate::determinism::{drive, room};
use mhsplat::config::{Sampler, TrainConfig};
use mhsplat::{Device, Plan, Trainer};

/// A trainer under which every iteration has the same launches.
fn trainer(device: &Device) -> Trainer {
    let data = room(64);
    let mut config = TrainConfig {
        sampler: Sampler::None,
        sh_degree: 0,
        ..TrainConfig::default()
    };
    config.work.resolution_levels = 0;
    let plan = Plan::new(&data, &config).unwrap();
    let splats = mhsplat::run::initial_gaussians(&data, &plan).unwrap();
    Trainer::new(device, &data, &plan, &splats).unwrap()
}

#[test]
fn a_sample_of_the_iterations_stands_for_all() {
    let device = Device::open(None).unwrap();
    let mut sampled = trainer(&device);
    drive(&mut sampled, 1).unwrap();
    assert!(sampled.stage_times().is_empty());
    // Short runs have times, too.
    drive(&mut sampled, 2).unwrap();
    let calls = |trainer: &Trainer| -> Vec<(&str, u64)> {
        let times = trainer.stage_times().into_iter();
        times.map(|(stage, t)| (stage, t.calls)).collect()
    };
    let early = calls(&sampled);
    assert!(early.contains(&("splat", 2)), "{early:?}");
    drive(&mut sampled, 150).unwrap();

    let mut whole = trainer(&device);
    whole.time_every_iteration();
    drive(&mut whole, 150).unwrap();
    assert_eq!(calls(&sampled), calls(&whole));
    let seconds = |trainer: &Trainer| -> f64 {
        let times = trainer.stage_times().into_iter();
        times.map(|(_, t)| t.seconds).sum()
    };
    assert!(seconds(&sampled) > 0.0 && seconds(&whole) > 0.0);
    assert!(sampled.splats().unwrap() == whole.splats().unwrap());
}

#[test]
fn launches_are_timed_where_that_is_asked_for_alone() {
    let device = Device::open(None).unwrap();
    let mut trainer = trainer(&device);
    let launched = |trainer: &mut Trainer| {
        trainer.advance().unwrap();
        device.enqueued().len()
    };
    assert_eq!(launched(&mut trainer), 0);
    // That iteration is timed, and its times are taken.
    assert_eq!(launched(&mut trainer), 0);
    trainer.time_every_iteration();
    assert!(launched(&mut trainer) > 10);
    trainer.settle().unwrap();
    assert!(device.enqueued().is_empty());
    let result = device.timed(|| {
        trainer.splats()?;
        device.time_launches(true)
    });
    assert!(result.unwrap(), "it was timed within");
    assert!(device.time_launches(false).unwrap(), "and before");
}
