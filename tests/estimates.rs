//! First-order estimates of births in training: those of the instrument, and that they repeat.

use crate::determinism::{drive, room, trained};
use mhsplat::Plan;
use mhsplat::TrainConfig;
use mhsplat::base::constants::ALPHA_MIN;
use mhsplat::config::Surrogate;
use mhsplat::density::Edit;
use mhsplat::device::Device;
use mhsplat::lab::surrogate::{Birth, Instrument, Setting, Shape};
use mhsplat::pipeline::buffers::ViewSet;
use mhsplat::pipeline::forward::{Quantity, RenderOptions};
use mhsplat::pipeline::photos::Photos;
use mhsplat::run::checkpoint;
use mhsplat::scene::{Gaussians, OptionalColor, Plane};
use mhsplat::train::Trainer;

fn config() -> TrainConfig {
    let mut config = TrainConfig {
        iterations: 120,
        max_size: 64,
        sh_degree: 2,
        seed: 5,
        ..TrainConfig::default()
    };
    config.mh.surrogate = Surrogate::Probe;
    // While a band is on trial other views are taken in the place of those set aside.
    config
}

/// Copies of rows spread over the scene, beside their sources.
fn candidates(splats: &Gaussians) -> Vec<Edit> {
    let stride = splats.len() as u32 / 80;
    let birth = |k: u32| {
        let src = k * stride;
        let at = |plane| splats.gather::<3>(plane, src as usize);
        Edit {
            src,
            dst: src,
            position: at(Plane::POSITION).map(|x| x + 0.01),
            log_scale: at(Plane::LOG_SCALE),
            opacity_logit: splats.planes()[Plane::OPACITY][src as usize],
            color: OptionalColor::NONE,
        }
    };
    (0..80).map(birth).collect()
}

/// What the instrument of the surrogate's check, which is itself held against differences of the loss, says of them in double
/// precision over the views that training takes next.
fn estimated(trainer: &Trainer, splats: &Gaussians, candidates: &[Edit]) -> Vec<f64> {
    let data = room(64);
    let device = Device::open(None).unwrap();
    let (schedule, done) = (trainer.schedule(), trainer.iteration());
    let next = schedule.upcoming(done, 4, data.train.len());
    let photos = Photos::new(&device, data.image_budget);
    let chosen = next.iter().map(|v| data.train[*v].clone());
    let views = ViewSet::<f64>::new(&photos, chosen).unwrap();
    let setting = Setting {
        render: RenderOptions {
            sh_degree: splats.sh_degree(),
            background: trainer.schedule().fixed_background(),
            quantity: Quantity::Color,
            active_only: false,
        },
        lambda_ssim: 0.2,
        alpha_min: ALPHA_MIN,
        epsilon: 1e-6,
    };
    let mut instrument =
        Instrument::new(&device, views, splats.clone(), setting, candidates.len()).unwrap();
    let birth = |e: &Edit| Birth {
        source: e.src,
        position: e.position,
        shape: Shape {
            log_scale: e.log_scale,
            opacity_logit: e.opacity_logit,
        },
    };
    let births: Vec<Birth> = candidates.iter().map(birth).collect();
    let estimates = instrument.estimate(&births).unwrap();
    estimates.iter().map(|p| p.change).collect()
}

#[test]
fn training_estimates_what_the_instrument_does() {
    let (data, config) = (room(64), config());
    let (mut trainer, splats) = trained(&data, &config, 60);
    let candidates = candidates(&splats);
    let got = trainer.estimate(&candidates).unwrap();
    let want = estimated(&trainer, &splats, &candidates);
    let most = want.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let pairs: Vec<(f64, f64)> = got.iter().copied().zip(want.iter().copied()).collect();
    let unseen = |p: &&(f64, f64)| p.0.is_nan();
    assert!(pairs.iter().filter(unseen).all(|p| p.1 == 0.0));
    let seen: Vec<_> = pairs.iter().filter(|p| !p.0.is_nan()).collect();
    assert!(seen.len() > 40, "{} are seen", seen.len());
    let gap = seen.iter().map(|p| (p.0 - p.1).abs()).fold(0.0, f64::max) / most;
    println!("largest difference {gap:.1e} of the largest");
    assert!(gap < 2e-2, "{seen:?}");
    // The others' figures are no match.
    let apart = |k: usize| (got[(k + 1) % 80] - want[k]).abs();
    assert!((0..80).map(apart).fold(0.0, f64::max) > 0.1 * most);
    // Asking changes nothing.
    assert!(trainer.state().unwrap().splats == splats);
    assert_eq!(trainer.estimate(&[]).unwrap(), [0.0; 0]);
    let again = trainer.estimate(&candidates).unwrap();
    let bits = |all: &[f64]| all.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    assert_eq!(
        bits(&again),
        bits(&got),
        "nor does a step that proposes nothing"
    );
}

#[test]
fn runs_with_estimates_repeat_and_resume() {
    let (data, config) = (room(64), config());
    let (trainer, whole) = trained(&data, &config, 120);
    let s = *trainer.stats();
    assert!(s.accepted > 0 && s.accepted < s.proposed, "{s:?}");
    assert!(whole == trained(&data, &config, 120).1);
    let mut by_importance = config.clone();
    by_importance.mh.surrogate = Surrogate::Importance;
    assert!(whole != trained(&data, &by_importance, 120).1);
    let times = trainer.stage_times();
    let probe = times.iter().find(|(name, _)| *name == "probe").unwrap().1;
    assert!(probe.calls > 0 && probe.seconds > 0.0);

    let (mut half, _) = trained(&data, &config, 48);
    let folder = tempfile::tempdir().unwrap();
    let saved = crate::determinism::saved(&mut half, &config, &data);
    checkpoint::write(folder.path(), &saved).unwrap();
    let saved = checkpoint::read(folder.path()).unwrap();
    assert_eq!(saved.config, config);
    let device = Device::open(None).unwrap();
    let mut resumed = Trainer::new(
        &device,
        &data,
        &Plan::new(&data, &config).unwrap(),
        &saved.state.splats,
    )
    .unwrap();
    resumed.restore(&saved.state).unwrap();
    drive(&mut resumed, 120).unwrap();
    assert!(whole == resumed.state().unwrap().splats);

    // Pairs that do not fit are repeated in the pass of estimates as elsewhere.
    let splats =
        mhsplat::run::initial_gaussians(&data, &Plan::new(&data, &config).unwrap()).unwrap();
    let mut tight =
        Trainer::new(&device, &data, &Plan::new(&data, &config).unwrap(), &splats).unwrap();
    while tight.iteration() < 120 {
        tight.shrink_intersections(1024).unwrap();
        let next = tight.iteration() + 20;
        drive(&mut tight, next).unwrap();
    }
    assert!(tight.overflows() > 0);
    assert!(whole == tight.state().unwrap().splats);
}
