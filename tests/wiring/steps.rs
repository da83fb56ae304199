//! Iterations and a density step of the trainer beside the definitions in f64.

use mhsplat::base::rng::{Philox, Stream};
use mhsplat::capture::Dataset;
use mhsplat::config::{AntiAliasing, Background, Birth, MhConfig, OptimizerConfig, ViewSubset};
use mhsplat::device::Device;
use mhsplat::run::initial_gaussians;
use mhsplat::scene::{Gaussians, Plane};
use mhsplat::train::{Event, Trainer, TrainerState};
use mhsplat::{Plan, TrainConfig};

use super::definitions::{Definitions, Wrong};
use crate::determinism::room;

/// A change of the definitions that makes them wrong.
type Mistake = fn(&mut Wrong);

/// Bound on the difference of a parameter, relative to its size or to 1.
const BOUND: f64 = 1e-5;

/// A run of 30 iterations whose first density step, with births of all kinds, comes after three. Every rate changes from one
/// iteration to the next, and a band of spherical harmonics comes before the third.
///
/// With the ε of training, Adam's first steps are signs of gradients, and a gradient that is 0 but for rounding decides for
/// itself; with this one a step is a smooth function of the gradients.
pub fn config(relocation: bool) -> TrainConfig {
    let mut config = TrainConfig {
        iterations: 30,
        max_size: 48,
        sh_degree: 1,
        seed: (3 << 32) | 7,
        background: Background::Random,
        anti_aliasing: match relocation {
            true => AntiAliasing::On,
            false => AntiAliasing::Off,
        },
        optimizer: OptimizerConfig {
            beta1: 0.9_f32.into(),
            beta2: 0.999_f32.into(),
            epsilon: 1e-4,
            lr_settle_from: 0,
            sh_interval: 2000,
            ..OptimizerConfig::default()
        },
        mh: MhConfig {
            relocation,
            // One form each; births that split change rows that are there.
            birth: Some(match relocation {
                true => Birth::Faint,
                false => Birth::Split,
            }),
            deaths_until_iteration: 0,
            view_subset: match relocation {
                true => ViewSubset::Fixed(2),
                false => ViewSubset::Shrinking,
            },
            from_iteration: 1000,
            births_from_iteration: Some(1000),
            interval: 3,
            // A source splits once: those that are drawn are left out of the fine phase.
            coarse_proposals: match relocation {
                true => 60,
                false => 20,
            },
            fine_proposals: 100,
            pixel_proposals: 40,
            target_acceptance: [0.4, 0.4],
            ..MhConfig::default()
        },
        ..TrainConfig::default()
    };
    config.work.resolution_levels = 0;
    config
}

/// Four views of the bundled scene.
pub fn views() -> Dataset {
    let mut data = room(48);
    data.train.truncate(4);
    data
}

/// Gaussians of all shapes at some of the points: every sixth is dead, and every sixth faint enough for the noise.
pub fn start(data: &Dataset) -> Gaussians {
    let few = TrainConfig {
        max_gaussians: Some(48),
        ..TrainConfig::default()
    };
    let mut splats = initial_gaussians(data, &Plan::new(data, &few).unwrap()).unwrap();
    for i in 0..splats.len() {
        let uniform = |k: u32| Philox::uniform(5, Stream::Synthetic.stream(90 + k), i as u64);
        let (u, q) = (uniform(0), uniform(1));
        let logit = match i % 6 {
            0 => -6.0,
            1 => -4.2,
            _ => 3.0 * u[3] - 1.5,
        };
        let scales = [0, 1, 2].map(|k| (u[k] - 2.9) as f32);
        splats.scatter(Plane::LOG_SCALE, i, scales);
        splats.scatter(Plane::ROTATION, i, q.map(|v| (v - 0.4) as f32));
        splats.scatter(Plane::OPACITY, i, [logit as f32]);
    }
    splats
}

pub fn trainer(data: &Dataset, config: &TrainConfig) -> Trainer {
    let plan = Plan::new(data, config).unwrap();
    let device = Device::open(None).unwrap();
    Trainer::new(&device, data, &plan, &start(data)).unwrap()
}

/// Advances until the next iteration or density step is done.
pub fn next(trainer: &mut Trainer) -> TrainerState {
    while !matches!(
        trainer.advance().unwrap(),
        Event::Iteration { .. } | Event::Density(_)
    ) {}
    trainer.state().unwrap()
}

/// Largest difference of two sets of planes, of a value relative to its size or to 1; infinite if they have other shapes or
/// there is no number.
fn apart(got: &[Vec<f32>], want: &[Vec<f64>]) -> f64 {
    let shape = |lengths: &mut dyn Iterator<Item = usize>| lengths.collect::<Vec<_>>();
    let shapes = [
        shape(&mut got.iter().map(Vec::len)),
        shape(&mut want.iter().map(Vec::len)),
    ];
    if shapes[0] != shapes[1] {
        return f64::INFINITY;
    }
    let pairs = got.iter().flatten().zip(want.iter().flatten());
    let errors = pairs.map(|(g, w)| (f64::from(*g) - w).abs() / w.abs().max(1.0));
    errors.fold(0.0, |most, e| match e.is_nan() {
        true => f64::INFINITY,
        false => e.max(most),
    })
}

/// Differences of parameters after three iterations, the density step, and more iterations.
fn differences<const N: usize>(
    data: &Dataset,
    config: &TrainConfig,
    states: &[TrainerState],
    wrong: Wrong,
) -> [f64; N] {
    let aliased = config.anti_aliasing == AntiAliasing::On;
    let mut defined = Definitions::new(data, config, &start(data), aliased, wrong);
    std::array::from_fn(|k| {
        if k == 3 {
            defined.density_step();
        } else {
            defined.iterate();
        }
        apart(states[k].splats.planes(), &defined.scene.planes)
    })
}

/// States of the trainer after three iterations, the density step, and so many more iterations.
fn states(data: &Dataset, config: &TrainConfig, more: usize) -> Vec<TrainerState> {
    let mut trainer = trainer(data, config);
    let states: Vec<_> = (0..4 + more).map(|_| next(&mut trainer)).collect();
    assert_eq!([2, 3, 4].map(|k| states[k].iteration), [3, 3, 4]);
    assert_eq!(states[1].splats.sh_degree(), 0);
    assert_eq!(states[2].splats.sh_degree(), 1);
    let s = *trainer.stats();
    for [proposed, accepted] in [s.coarse, s.fine, s.pixel] {
        assert!(accepted > 3 && accepted < proposed, "{s:?}");
    }
    assert_eq!(trainer.non_finite(), 0);
    let moved = if config.mh.relocation {
        [s.relocated, s.pruned]
    } else {
        [s.pruned, s.relocated]
    };
    assert!(moved[0] > 3 && moved[1] == 0, "{s:?}");
    states
}

#[test]
fn training_follows_its_definitions() {
    let data = views();
    for relocation in [false, true] {
        let config = config(relocation);
        let states = states(&data, &config, 1);
        let found: [f64; 5] = differences(&data, &config, &states, Wrong::default());
        println!("relocation {relocation}: {found:?}");
        assert!(found.iter().all(|e| *e <= BOUND), "{found:?}");
    }
}

#[test]
fn planes_that_differ_are_told_apart() {
    let got = [vec![1.0, 2.0], vec![3.0, 400.0]];
    let want = [vec![1.0, 2.0], vec![3.0, 400.0]];
    assert_eq!(apart(&got, &want), 0.0);
    let of = |plane: usize, row: usize, value: f64| {
        let mut other = want.clone();
        other[plane][row] = value;
        apart(&got, &other)
    };
    assert!((of(0, 0, 1.0 + 1e-4) - 1e-4).abs() < 1e-7);
    assert!((of(1, 1, 400.0 + 0.04) - 1e-4).abs() < 1e-7);
    assert_eq!(of(0, 1, f64::NAN), f64::INFINITY);
    assert_eq!(apart(&got[..1], &want), f64::INFINITY);
    let longer = [vec![1.0, 2.0, 0.0], vec![3.0, 400.0, 0.0]];
    assert_eq!(apart(&got, &longer), f64::INFINITY);
}

#[test]
fn losses_on_record_are_those_of_the_iterations() {
    let (data, config) = (views(), config(false));
    let mut trainer = trainer(&data, &config);
    let mut defined = Definitions::new(&data, &config, &start(&data), false, Wrong::default());
    for k in 0..3 {
        let state = next(&mut trainer);
        defined.iterate();
        let close = |at: usize| {
            let recorded = state.losses[2 * at..2 * at + 2].iter();
            let pairs = recorded.zip(&defined.losses[k]);
            pairs.fold(0.0, |m: f64, (g, w)| m.max((f64::from(*g) - w).abs())) < 1e-5
        };
        assert!(close(k), "{k}: {:?}", &state.losses[..6]);
        assert!(
            k == 0 || !close(k - 1),
            "the comparison must be able to fail"
        );
    }
}

/// Every mistake is found, and no later than it can be.
#[test]
fn mistakes_are_found() {
    let data = views();
    let config = config(false);
    let states = states(&data, &config, 1);
    let cases: [(&str, usize, Mistake); 16] = [
        ("number of Adam's step", 0, |w| w.step = 1),
        ("memory of the second moment", 1, |w| w.long_memory = true),
        ("rates", 0, |w| w.rates = 1),
        ("rate of the noise", 0, |w| w.boosted_noise = true),
        ("seed of the noise", 0, |w| w.noise_seed = 1),
        ("upper half of that seed", 0, |w| w.noise_seed = 1 << 32),
        ("iteration of the noise", 0, |w| w.noise_iteration = 1),
        ("seed of the views' order", 0, |w| w.view_seed = 1),
        ("seed of the backgrounds", 0, |w| w.background_seed = 1),
        ("bands", 1, |w| w.band = 1),
        ("window of errors", 3, |w| w.window = 1),
        ("seed of the density step", 3, |w| w.density_seed = 1),
        ("its iteration", 3, |w| w.density_iteration = 1),
        ("its progress", 3, |w| w.progress = 0.05),
        ("its pictures", 3, |w| w.pictures = 1),
        ("moments of its rows", 4, |w| w.kept_moments = true),
    ];
    for (what, first, mistake) in cases {
        let mut wrong = Wrong::default();
        mistake(&mut wrong);
        let found: [f64; 5] = differences(&data, &config, &states, wrong);
        let at = found.iter().position(|e| *e > BOUND);
        assert_eq!(at, Some(first), "{what}: {found:?}");
    }
}

/// A batch of three views before the density step, amidst which a band is added, and one after it.
#[test]
fn batches_follow_their_definitions_and_mistakes_are_found() {
    let data = views();
    for relocation in [false, true] {
        let config = TrainConfig {
            batch: 3,
            ..config(relocation)
        };
        let states = states(&data, &config, 3);
        assert!(states[0].splats.planes()[0] == states[1].splats.planes()[0]);
        assert!(states[1].splats.planes()[0] != states[2].splats.planes()[0]);
        let found: [f64; 7] = differences(&data, &config, &states, Wrong::default());
        println!("relocation {relocation}: {found:?}");
        assert!(found.iter().all(|e| *e <= BOUND), "{found:?}");
        let cases: [(&str, usize, Mistake); 5] = [
            ("number of Adam's step", 2, |w| w.step = 1),
            ("rates", 2, |w| w.batch_rates = true),
            ("sum of gradients", 2, |w| w.batch_sum = true),
            ("last view alone", 2, |w| w.batch_last = true),
            ("powers of the decays", 6, |w| w.batch_moments = true),
        ];
        for (what, first, mistake) in cases {
            let mut wrong = Wrong::default();
            mistake(&mut wrong);
            let found: [f64; 7] = differences(&data, &config, &states, wrong);
            let at = found.iter().position(|e| *e > BOUND);
            assert_eq!(at, Some(first), "{what}: {found:?}");
        }
    }
}
