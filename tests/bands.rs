//! Bands of spherical harmonics come at their intervals, and Gaussians that no view shows go at the end.

use crate::determinism::{drive, room};
use mhsplat::Plan;
use mhsplat::capture::Dataset;
use mhsplat::config::{Sampler, TrainConfig};
use mhsplat::device::Device;
use mhsplat::pipeline::forward::RenderOptions;
use mhsplat::run::initial_gaussians;
use mhsplat::scene::{Gaussians, Plane};
use mhsplat::train::Trainer;

/// A fixed set, with a band more every 40 iterations.
fn config() -> TrainConfig {
    let mut config = TrainConfig {
        sampler: Sampler::None,
        iterations: 240,
        max_size: 64,
        sh_degree: 2,
        seed: 3,
        ..TrainConfig::default()
    };
    config.optimizer.sh_interval = 5000;
    config.work.resolution_levels = 0;
    config
}

fn trainer(data: &Dataset, config: &TrainConfig, splats: &Gaussians) -> Trainer {
    Trainer::new(
        &Device::open(None).unwrap(),
        data,
        &Plan::new(data, config).unwrap(),
        splats,
    )
    .unwrap()
}

#[test]
fn one_band_after_the_other_comes_at_its_interval() {
    let data = room(64);
    let config = config();
    let splats = initial_gaussians(&data, &Plan::new(&data, &config).unwrap()).unwrap();
    let mut trained = trainer(&data, &config, &splats);
    let mut degrees = Vec::new();
    for until in [40, 41, 80, 81, 200] {
        drive(&mut trained, until).unwrap();
        degrees.push(trained.scene_and_renderer().unwrap().0.sh_degree);
    }
    assert_eq!(degrees, [0, 1, 1, 2, 2]);
    // Saved and taken up again where a band is due: it comes once.
    let mut stopped = trainer(&data, &config, &splats);
    drive(&mut stopped, 40).unwrap();
    let state = stopped.state().unwrap();
    let mut rest = trainer(&data, &config, &state.splats);
    rest.restore(&state).unwrap();
    drive(&mut rest, 200).unwrap();
    assert!(rest.state().unwrap().splats == trained.state().unwrap().splats);
}

#[test]
fn what_no_training_view_shows_goes_at_the_end_and_nothing_else() {
    let data = room(64);
    let seen = initial_gaussians(&data, &Plan::new(&data, &config()).unwrap()).unwrap();
    let n = seen.len();
    let mut planes = seen.planes().to_vec();
    // Three that are too faint to be seen.
    for (k, place) in [[0.1, 0.0, 0.0], [0.0, -0.1, 0.0], [0.0, 0.0, 0.0]]
        .iter()
        .enumerate()
    {
        for (p, plane) in planes.iter_mut().enumerate() {
            plane.push(match p {
                0..3 => place[p],
                3..6 => -6.0,
                6 => 1.0,
                10 => -8.0 - k as f32,
                _ => 0.0,
            });
        }
    }
    let more = Gaussians::new(0, planes).unwrap();
    let mut untrained = trainer(&data, &config(), &more);
    let images = |t: &mut Trainer| {
        let (scene, renderer) = t.scene_and_renderer().unwrap();
        let options = RenderOptions::default();
        let image = |v: &mhsplat::capture::View| renderer.image(scene, &v.camera, &options);
        data.train
            .iter()
            .map(image)
            .collect::<mhsplat::Result<Vec<_>>>()
            .unwrap()
    };
    let before = images(&mut untrained);
    untrained.finish().unwrap();
    let removed = untrained.learned().removed as usize;
    assert!(removed >= 3 && removed < n / 2, "{removed} of {n}");
    assert_eq!(untrained.gaussians(), n + 3 - removed);
    assert!(images(&mut untrained) == before);
    // Once.
    untrained.finish().unwrap();
    assert_eq!(untrained.learned().removed as usize, removed);
    let mut kept = config();
    kept.work.remove_unseen = false;
    let mut everything = trainer(&data, &kept, &more);
    everything.finish().unwrap();
    assert_eq!(everything.gaussians(), n + 3);
}

#[test]
fn what_was_gathered_of_a_gaussian_stays_with_it() {
    let data = room(64);
    let config = TrainConfig {
        sampler: Sampler::Adc,
        ..config()
    };
    let splats = initial_gaussians(&data, &Plan::new(&data, &config).unwrap()).unwrap();
    let mut stopped = trainer(&data, &config, &splats);
    drive(&mut stopped, 90).unwrap();
    let of = |t: &mut Trainer| {
        let state = t.state().unwrap();
        let n = state.splats.len();
        let row = |i: usize| (state.splats.gather::<3>(Plane::POSITION, i), i);
        let cues: Vec<_> = (0..n)
            .map(|i| {
                (
                    row(i).0,
                    state
                        .rows
                        .statistics
                        .iter()
                        .map(|c| c[i])
                        .collect::<Vec<f32>>(),
                )
            })
            .collect();
        cues
    };
    let before = of(&mut stopped);
    stopped.finish().unwrap();
    let after = of(&mut stopped);
    assert!(stopped.learned().removed > 0 && after.len() < before.len());
    let mut rest = before.iter();
    // In the same order, with gaps.
    assert!(after.iter().all(|row| rest.any(|b| b == row)));
    assert!(before.iter().any(|(_, cues)| cues.iter().any(|c| *c > 0.0)));
}
