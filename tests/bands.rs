//! Bands of spherical harmonics come and go by what they are worth, and what no view shows goes at the end.

use crate::determinism::{drive, room};
use mhsplat::capture::{Alpha, Dataset, Photo, PhotoSource};
use mhsplat::config::{Sampler, TrainConfig};
use mhsplat::device::Device;
use mhsplat::pipeline::forward::{RenderOptions, Renderer};
use mhsplat::run::initial_splats;
use mhsplat::scene::refit::{Sight, with_fewer_bands};
use mhsplat::scene::{Plane, Splats, sh};
use mhsplat::train::{BAND_WORTH, TRIAL_WORTH, Trainer, TrainerState};

/// A fixed set, with the bands looked after every 40 iterations.
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

fn trainer(data: &Dataset, config: &TrainConfig, splats: &Splats) -> Trainer {
    Trainer::new(&Device::open(None).unwrap(), data, config, splats).unwrap()
}

/// The room's cameras, with photos of its points whose colours depend on the view by a first band of this size.
fn shining(size: f32) -> (Dataset, Splats) {
    let mut data = room(64);
    let mut splats = initial_splats(&data, &config()).unwrap();
    splats.plane_mut(Plane::OPACITY).fill(2.0);
    let plain = splats.clone();
    let mut truth = splats.with_sh_degree(1).unwrap();
    for p in Plane::SH + 3..Plane::count(1) {
        for (i, v) in truth.plane_mut(p).iter_mut().enumerate() {
            *v = size * ((i * 7 + p * 3) as f32).sin();
        }
    }
    let device = Device::open(None).unwrap();
    let mut renderer = Renderer::<f32>::for_display(&device, 1).unwrap();
    let scene = mhsplat::pipeline::buffers::Scene::upload(&device, &truth, 0).unwrap();
    let options = RenderOptions {
        sh_degree: 1,
        ..RenderOptions::default()
    };
    for view in data.train.iter_mut().chain(&mut data.test) {
        let image = renderer.image(&scene, &view.camera, &options).unwrap();
        let [w, h] = [image.width as u32, image.height as u32];
        view.photo = PhotoSource::Memory(
            Photo::from_interleaved(w, h, Alpha::None, &image.rgb8())
                .unwrap()
                .into(),
        );
    }
    (data, plain)
}

#[test]
fn a_band_is_kept_where_colours_depend_on_the_view() {
    let (data, plain) = shining(0.4);
    let mut trained = trainer(&data, &config(), &plain);
    drive(&mut trained, 90).unwrap();
    // The second band comes without a trial of its own.
    assert_eq!(trained.scene_and_renderer().0.sh_degree, 2);
    assert!(!trained.findings().bands.on_trial);
    drive(&mut trained, 240).unwrap();
    trained.finish().unwrap();
    let bands = trained.findings().bands.clone();
    assert!(trained.scene_and_renderer().0.sh_degree >= 1, "{bands:?}");
    assert!(
        bands.trials[0].kept && bands.trials[0].gain > 0.1,
        "{bands:?}"
    );
    let [_, second, ..] = &bands.trials[..] else {
        panic!("{bands:?}");
    };
    assert_eq!((second.iteration, second.degree), (240, 2));
}

#[test]
fn no_band_is_kept_where_they_do_not() {
    let (data, plain) = shining(0.0);
    let config = config();
    let mut trained = trainer(&data, &config, &plain);
    drive(&mut trained, 240).unwrap();
    let state = trained.state().unwrap();
    let bands = &state.findings.bands;
    // Tried at 40, judged at 80, not tried at 120, tried again at 160.
    let judged: Vec<(u32, bool)> = bands.trials.iter().map(|t| (t.iteration, t.kept)).collect();
    assert_eq!(judged, [(80, false), (200, false)], "{bands:?}");
    assert_eq!(state.splats.sh_degree(), 0);
    // Off, one band after the other comes and stays.
    let mut all = config.clone();
    all.work.sh_by_need = false;
    let mut trained = trainer(&data, &all, &plain);
    drive(&mut trained, 100).unwrap();
    trained.finish().unwrap();
    assert_eq!(trained.state().unwrap().splats.sh_degree(), 2);
}

/// The wait after a trial in vain is doubled once: the first band may be worth something later in the run.
#[test]
fn the_first_band_is_tried_again_as_long_as_the_run_lasts() {
    let (data, plain) = shining(0.0);
    let mut config = config();
    (config.iterations, config.optimizer.sh_interval) = (640, 1875);
    let mut trained = trainer(&data, &config, &plain);
    drive(&mut trained, 610).unwrap();
    let bands = &trained.findings().bands;
    let judged: Vec<u32> = bands.trials.iter().map(|t| t.iteration).collect();
    assert_eq!(judged, [80, 200, 400, 600], "{bands:?}");
}

/// A band learns little in its first interval, so that little is asked of it there, and more at the end.
#[test]
fn a_band_of_little_worth_passes_its_trial_and_goes_at_the_end() {
    let (data, plain) = shining(0.05);
    let mut trained = trainer(&data, &config(), &plain);
    drive(&mut trained, 90).unwrap();
    let first = trained.findings().bands.trials[0];
    assert!(
        first.kept && (TRIAL_WORTH..BAND_WORTH).contains(&first.gain),
        "{first:?}"
    );
    trained.finish().unwrap();
    assert_eq!(trained.scene_and_renderer().0.sh_degree, 0);
    let last = trained.findings().bands.trials.last();
    assert!(last.is_some_and(|t| !t.kept && t.degree == 1), "{last:?}");
}

/// The state of a run after `until` iterations that was saved and taken up again after each of `at`.
fn interrupted(data: &Dataset, plain: &Splats, at: &[u32], until: u32) -> TrainerState {
    let mut trained = trainer(data, &config(), plain);
    for &at in at {
        drive(&mut trained, at).unwrap();
        let state = trained.state().unwrap();
        trained = trainer(data, &config(), &state.splats);
        trained.restore(&state).unwrap();
    }
    drive(&mut trained, until).unwrap();
    trained.state().unwrap()
}

#[test]
fn a_run_goes_on_in_the_middle_of_a_trial_with_the_same_bits() {
    // A band that is kept, and one that is let go.
    for (size, stops) in [(0.4, [40, 60, 80]), (0.0, [60, 80, 130])] {
        let (data, plain) = shining(size);
        let whole = interrupted(&data, &plain, &[], 140);
        assert_eq!(whole.findings.bands.trials[0].kept, size > 0.0);
        for at in stops {
            let rest = interrupted(&data, &plain, &[at], 140);
            assert!(
                whole.splats == rest.splats && whole.findings == rest.findings,
                "from {at}"
            );
        }
    }
}

/// A run that its time budget ended in the middle of a trial is finished there, goes on, and is finished again.
#[test]
fn a_finished_run_goes_on() {
    let (data, plain) = shining(0.4);
    let mut early = trainer(&data, &config(), &plain);
    drive(&mut early, 60).unwrap();
    assert!(early.findings().bands.on_trial);
    early.finish().unwrap();
    let state = early.state().unwrap();
    assert_eq!(state.findings.finished, Some(60));
    let mut late = trainer(&data, &config(), &state.splats);
    late.restore(&state).unwrap();
    drive(&mut late, 240).unwrap();
    late.finish().unwrap();
    let findings = late.findings().clone();
    assert_eq!(findings.finished, Some(240));
    assert!(
        !findings.bands.on_trial && late.scene_and_renderer().0.sh_degree >= 1,
        "{findings:?}"
    );
}

/// A camera at `center` that looks along z, or back if that is below.
fn sight(center: [f64; 3]) -> Sight {
    let z = if center[2] > 0.0 { -1.0 } else { 1.0 };
    Sight {
        rotation: [[z, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, z]],
        center,
        intrinsics: [50.0, 50.0, 50.0, 50.0],
        size: [100.0, 100.0],
    }
}

/// One Gaussian at the origin, with coefficients of degree 3 in red.
fn glint() -> Splats {
    let mut splats = Splats::zeros(3, 1);
    for k in 0..16 {
        splats.plane_mut(Plane::SH + 3 * k)[0] = 0.3 * (k as f32 + 1.0).sin();
    }
    splats
}

/// Red, without the half that is added, of the Gaussian seen from `center`.
fn red(splats: &Splats, center: [f64; 3]) -> f64 {
    let norm = center.iter().map(|c| c * c).sum::<f64>().sqrt();
    let basis = sh::basis(center.map(|c| -c / norm));
    let coefficients = mhsplat::scene::sh_coefficients(splats.sh_degree());
    let term = |k: usize| basis[k] * f64::from(splats.planes()[Plane::SH + 3 * k][0]);
    (0..coefficients).map(term).sum()
}

#[test]
fn lower_bands_take_over_what_they_can() {
    let splats = glint();
    let centers = [
        [0.0, 0.0, -2.0],
        [1.0, 0.5, -2.0],
        [-0.5, 1.0, -2.0],
        [0.3, -0.4, 2.0],
    ];
    let sights = centers.map(sight);
    // Four directions, four coefficients: the same colours from there.
    let fewer = with_fewer_bands(&splats, 1, &sights).unwrap();
    for center in centers {
        assert!((red(&fewer, center) - red(&splats, center)).abs() < 1e-3);
    }
    // One coefficient: their mean.
    let flat = with_fewer_bands(&splats, 0, &sights).unwrap();
    let mean = centers.iter().map(|c| red(&splats, *c)).sum::<f64>() / 4.0;
    assert!((red(&flat, centers[0]) - mean).abs() < 1e-4);
    // Cut off without that they are others.
    let cut = splats.clone().with_sh_degree(0).unwrap();
    assert!((red(&cut, centers[0]) - mean).abs() > 0.05);
    // Seen by no camera: cut off.
    let behind = [Sight {
        center: [0.0, 0.0, 3.0],
        ..sights[0]
    }];
    assert_eq!(with_fewer_bands(&splats, 0, &behind).unwrap(), cut);
}

#[test]
fn what_no_training_view_shows_goes_at_the_end_and_nothing_else() {
    let data = room(64);
    let seen = initial_splats(&data, &config()).unwrap();
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
    let more = Splats::new(0, planes).unwrap();
    let mut untrained = trainer(&data, &config(), &more);
    let images = |t: &mut Trainer| {
        let (scene, renderer) = t.scene_and_renderer();
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
    let removed = untrained.findings().removed as usize;
    assert!(removed >= 3 && removed < n / 2, "{removed} of {n}");
    assert_eq!(untrained.gaussians(), n + 3 - removed);
    assert!(images(&mut untrained) == before);
    // Once.
    untrained.finish().unwrap();
    assert_eq!(untrained.findings().removed as usize, removed);
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
    let splats = initial_splats(&data, &config).unwrap();
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
                    state.cues.iter().map(|c| c[i]).collect::<Vec<f32>>(),
                )
            })
            .collect();
        cues
    };
    let before = of(&mut stopped);
    stopped.finish().unwrap();
    let after = of(&mut stopped);
    assert!(stopped.findings().removed > 0 && after.len() < before.len());
    let mut rest = before.iter();
    // In the same order, with gaps.
    assert!(after.iter().all(|row| rest.any(|b| b == row)));
    assert!(before.iter().any(|(_, cues)| cues.iter().any(|c| *c > 0.0)));
}
