//! What interpreters of kernels can be given (oclgrind, for data races and reads out of bounds): every stage, and a training with
//! density control, of the smallest scenes.

use crate::determinism::drive;
use mhsplat::Plan;
use mhsplat::capture::{Dataset, LoadOptions, load};
use mhsplat::config::{Sampler, TrainConfig};
use mhsplat::device::Device;
use mhsplat::device::tuning::Tuning;
use mhsplat::device::{DeviceInfo, DeviceKind};
use mhsplat::lab::synth::{SynthLayout, SynthOptions, generate};
use mhsplat::lab::verify::{other_style, tiny};
use mhsplat::run::initial_gaussians;
use mhsplat::train::Trainer;

/// Iterations, with density control after every third.
const ITERATIONS: u32 = 9;

#[test]
fn every_stage_agrees_with_the_reference() {
    let outcome = tiny(&Device::open(None).unwrap()).unwrap();
    assert_eq!(outcome.failed, 0, "{outcome:#?}");
    assert!(outcome.passed > 100, "{}", outcome.passed);
}

/// Three views of two tiles of a synthetic room with 30 points.
fn dataset() -> Dataset {
    let dir = tempfile::tempdir().unwrap();
    let options = SynthOptions {
        layout: SynthLayout::Colmap,
        views: 3,
        width: 24,
        height: 16,
        points: 30,
        samples: 1,
        ..SynthOptions::for_scene("room")
    };
    generate("room", dir.path(), &options).unwrap();
    load(dir.path(), &LoadOptions::default()).unwrap()
}

fn config(sampler: Sampler) -> TrainConfig {
    let mut config = TrainConfig {
        sampler,
        iterations: ITERATIONS,
        sh_degree: 1,
        seed: 4,
        ..TrainConfig::default()
    };
    (
        config.mh.interval,
        config.mcmc.interval,
        config.adc.interval,
    ) = (3, 3, 3);
    (config.mh.births_from_iteration, config.mh.pixel_proposals) = (Some(500), 10);
    (config.mh.coarse_proposals, config.mh.fine_proposals) = (10, 10);
    config
}

#[test]
fn every_sampler_trains() {
    let data = dataset();
    let device = Device::open(None).unwrap();
    for sampler in [Sampler::Mh, Sampler::Mcmc, Sampler::Adc, Sampler::None] {
        let config = config(sampler);
        let splats = initial_gaussians(&data, &Plan::new(&data, &config).unwrap()).unwrap();
        let mut trainer =
            Trainer::new(&device, &data, &Plan::new(&data, &config).unwrap(), &splats).unwrap();
        drive(&mut trainer, ITERATIONS).unwrap();
        let stats = *trainer.stats();
        let grown = stats.accepted + stats.cloned + stats.split;
        assert_eq!(
            grown > 0,
            sampler != Sampler::None,
            "{sampler:?}: {stats:?}"
        );
        let state = trainer.state().unwrap();
        let finite = |p: &Vec<f32>| p.iter().all(|v| v.is_finite());
        assert!(state.splats.planes().iter().all(finite), "{sampler:?}");
    }
}

#[test]
fn a_gpu_is_checked_in_the_style_that_it_trains_in() {
    let cpu = Device::open(None).unwrap().info().clone();
    let gpu = DeviceInfo {
        kind: DeviceKind::Gpu,
        ..cpu.clone()
    };
    assert!(other_style(Tuning::CPU, &cpu).unwrap().group_style);
    assert_eq!(other_style(Tuning::GPU, &cpu), Some(Tuning::CPU));
    assert_eq!(other_style(Tuning::GPU, &gpu), None);
    // Somebody has asked for the style of CPUs.
    assert!(other_style(Tuning::CPU, &gpu).unwrap().group_style);
    let small = DeviceInfo {
        max_work_group: 64,
        ..gpu
    };
    assert_eq!(other_style(Tuning::CPU, &small), None);
}
