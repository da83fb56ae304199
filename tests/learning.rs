//! Training learns: held-out PSNR rises, and density control beats a fixed set.

use crate::determinism::{drive, room};
use mhsplat::buffers::ViewSet;
use mhsplat::config::{Background, Sampler, TrainConfig};
use mhsplat::dataset::{Dataset, Photo, PhotoSource};
use mhsplat::evaluate::{Evaluator, mean};
use mhsplat::gpu::tuning::Tuning;
use mhsplat::gpu::{Defines, Device};
use mhsplat::model::Plane;
use mhsplat::photos::Photos;
use mhsplat::run::initial_splats;
use mhsplat::train::Trainer;

/// Held-out PSNR before and after training.
fn psnr(data: &Dataset, config: &TrainConfig) -> [f64; 2] {
    let device = Device::open(None).unwrap();
    let splats = initial_splats(data, config).unwrap();
    let mut trainer = Trainer::new(&device, data, config, &splats).unwrap();
    let views = ViewSet::new(&Photos::new(&device, data.image_budget), data.test.clone()).unwrap();
    let defines = Defines::new(Tuning::for_device(device.info()));
    let evaluator = Evaluator::new(&device, defines, views).unwrap();
    let score = |trainer: &mut Trainer| {
        let (scene, renderer) = trainer.scene_and_renderer();
        mean(
            &evaluator
                .score_all(scene, renderer, [0.0; 3], false)
                .unwrap(),
        )
        .unwrap()
        .0
    };
    let before = score(&mut trainer);
    while trainer.iteration() < config.iterations {
        trainer.step().unwrap();
        trainer.density_step().unwrap();
    }
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

/// Opacities of black fog after training on photos in which there is nothing.
fn fog(background: Background) -> Vec<f32> {
    let mut data = room(64);
    for view in &mut data.train {
        let (w, h) = (view.camera.width, view.camera.height);
        let clear = Photo::from_interleaved(w, h, 4, &vec![0; 4 * (w * h) as usize]).unwrap();
        view.photo = PhotoSource::Memory(clear.into());
    }
    let mut config = TrainConfig {
        sampler: Sampler::None,
        iterations: 150,
        max_size: 64,
        sh_degree: 0,
        background,
        ..TrainConfig::default()
    };
    (config.loss.lambda_opacity, config.loss.lambda_scale) = (0.0, 0.0);
    let mut splats = initial_splats(&data, &config).unwrap();
    for c in 0..3 {
        // Far below black, so that no gradient of the colour moves it.
        splats.plane_mut(Plane::SH + c).fill(-4.0);
    }
    splats.plane_mut(Plane::OPACITY).fill(0.0);
    let device = Device::open(None).unwrap();
    let mut trainer = Trainer::new(&device, &data, &config, &splats).unwrap();
    drive(&mut trainer, config.iterations).unwrap();
    trainer.state().unwrap().splats.planes()[Plane::OPACITY].clone()
}

/// Over one background a scene keeps fog of its colour in front of what is transparent, which other views would show.
#[test]
fn fog_of_the_backgrounds_colour_does_not_last() {
    assert!(fog(Background::Black).iter().all(|logit| *logit == 0.0));
    let changing = fog(Background::Auto);
    let lasting = changing.iter().filter(|logit| **logit > -1.0).count();
    println!("{lasting} of {} last", changing.len());
    assert!(lasting < changing.len() / 2);
}
