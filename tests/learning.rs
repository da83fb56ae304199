//! Training learns: held-out PSNR rises, and density control beats a fixed set.

use crate::determinism::room;
use mhsplat::Plan;
use mhsplat::capture::Dataset;
use mhsplat::config::{Sampler, TrainConfig};
use mhsplat::device::tuning::Tuning;
use mhsplat::device::{Defines, Device};
use mhsplat::evaluate::Evaluator;
use mhsplat::pipeline::buffers::ViewSet;
use mhsplat::pipeline::photos::Photos;
use mhsplat::run::{FinalRecord, initial_gaussians};
use mhsplat::train::Trainer;

/// Held-out PSNR before and after training.
pub fn psnr(data: &Dataset, config: &TrainConfig) -> [f64; 2] {
    let device = Device::open(None).unwrap();
    let splats = initial_gaussians(data, &Plan::new(data, config).unwrap()).unwrap();
    let mut trainer =
        Trainer::new(&device, data, &Plan::new(data, config).unwrap(), &splats).unwrap();
    let views = ViewSet::new(&Photos::new(&device, data.image_budget), data.test.clone()).unwrap();
    let defines = Defines::new(Tuning::for_device(device.info()));
    let evaluator = Evaluator::new(&device, defines, views).unwrap();
    let score = |trainer: &mut Trainer| {
        let scores = evaluator.score_all(trainer, [0.0; 3], false);
        FinalRecord::of(scores.unwrap()).unwrap().mean.psnr
    };
    let before = score(&mut trainer);
    trainer.advance_to(config.iterations).unwrap();
    trainer.settle().unwrap();
    assert_eq!(trainer.non_finite(), 0);
    [before, score(&mut trainer)]
}

#[test]
fn a_room_is_learned_and_density_control_helps() {
    let data = room(128);
    let config = TrainConfig {
        iterations: 800,
        max_size: 128,
        ..TrainConfig::default()
    };
    let [before, with] = psnr(&data, &config);
    let [_, without] = psnr(
        &data,
        &TrainConfig {
            sampler: Sampler::None,
            ..config
        },
    );
    println!(
        "held-out PSNR: {before:.2} dB at the start, {without:.2} dB fixed set, {with:.2} dB Metropolis-Hastings"
    );
    assert!(with > before + 6.0);
    assert!(with > without);
}
