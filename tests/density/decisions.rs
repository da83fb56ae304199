//! The decision on each proposed birth, those that are refused included, against the definition as printed.
//!
//! Every source is drawn, so that a proposal without a birth is one that was refused. A step records nothing else of it, but its
//! place reaches the estimator and its D the mean over all.

use std::collections::BTreeMap;

use super::Scene;
use super::chain::printed;
use super::step::{context, dying};
use mhsplat::base::math::sigmoid;
use mhsplat::base::rng::{Philox, Stream};
use mhsplat::config::{Acceptance, MhConfig, Surrogate};
use mhsplat::density::mh::{MetropolisHastings, importance::importance};
use mhsplat::density::{BirthKind, DensityControl, Edit};
use mhsplat::pipeline::reference::{rotation, unit_quaternion};

const ROWS: usize = 2000;
const SEED: u64 = (1 << 40) | 3;
const ITERATION: u32 = 700;
const ETA: f64 = 0.3;
/// Bound of the difference of ln ρ^{1/T}: rounding of a few logarithms of at most 20.
const ROUNDING: f64 = 1e-12;
/// Relative bound of T where it is solved for: 40 halvings of its logarithm's range, ln 1e8 / 2⁴⁰.
const HALVED: f64 = 1.7e-11;

/// Place of an accepted birth, Gaussians in its voxel, importance of its source, ln ρ^{1/T}.
type Birth = ([f32; 3], u32, f64, f64);

/// The decisions of a step.
#[derive(Default)]
struct Decided {
    /// Places of all proposals; empty where no estimator was asked.
    places: Vec<[f32; 3]>,
    /// Mean of D over all proposals.
    prior: f64,
    /// Births by phase and row of the source.
    births: BTreeMap<(usize, u32), Birth>,
}

/// The forms of ρ, and Eq. 20 with estimates.
fn forms(target: [f64; 2]) -> [MhConfig; 5] {
    use Acceptance::{Alg1, Centred, Eq20, ExactPrior};
    let drawn = |acceptance| MhConfig {
        acceptance,
        lambda_voxel: 0.7,
        temperature: [0.6, 2.0],
        target_acceptance: target,
        relocation: false,
        coarse_proposals: 400_000,
        fine_proposals: 400_000,
        ..MhConfig::paper()
    };
    let [eq20, alg1, centred, exact] = [Eq20, Alg1, Centred, ExactPrior].map(drawn);
    let surrogate = Surrogate::Probe;
    let probe = MhConfig { surrogate, ..eq20 };
    [eq20, alg1, centred, exact, probe]
}

/// The estimated change of the loss by proposal k.
fn change(k: usize) -> f64 {
    ((k * 7919 % 101) as f64 - 40.0) * 1e-6
}

fn step(config: &MhConfig, scene: &Scene) -> Decided {
    let mut found = Decided::default();
    let mut estimate = |all: &[Edit]| {
        found.places.extend(all.iter().map(|birth| birth.position));
        Ok((0..all.len()).map(change).collect())
    };
    let (at, errors) = (context(ITERATION, ETA, SEED), scene.errors());
    let control = MetropolisHastings::new(config);
    let outcome = control.step_estimated(&at, &scene.state(), &errors, &mut estimate);
    let outcome = outcome.unwrap();
    let alive = ROWS as u64 - outcome.stats.pruned;
    assert_eq!([outcome.stats.coarse[0], outcome.stats.fine[0]], [alive; 2]);
    assert_eq!(outcome.births.len(), outcome.edits.len());
    for (b, edit) in outcome.births.iter().zip(&outcome.edits) {
        assert_eq!(b.dst, edit.dst);
        let from = (usize::from(b.kind == BirthKind::Fine), b.source.unwrap());
        let birth = (edit.position, b.voxel_count, b.importance, b.ln_ratio);
        assert!(found.births.insert(from, birth).is_none(), "born twice");
    }
    found.prior = outcome.stats.mean_prior;
    found
}

/// x + R·(k·s ⊙ ξ), ξ the first three normal numbers of the row.
fn place(scene: &Scene, row: usize, spread: f64, stream: Stream) -> [f32; 3] {
    let normal = Philox::normal(SEED, stream.stream(ITERATION), row as u64);
    let quaternion = scene.rotations.each_ref().map(|p| f64::from(p[row]));
    let axes = rotation(unit_quaternion(quaternion).0);
    let scale = |k: usize| f64::from(scene.log_scales[k][row]).exp();
    let own = [0, 1, 2].map(|k| spread * scale(k) * normal[k]);
    let moved = |j: usize| (0..3).map(|k| axes[j][k] * own[k]).sum::<f64>();
    [0, 1, 2].map(|j| (f64::from(scene.positions[j][row]) + moved(j)) as f32)
}

/// The T at which the mean of ρ^{1/T} is a share, by bisection until it stands still.
fn temperature(rhos: &[f64], share: f64) -> f64 {
    let (mut low, mut high) = (1e-4, 1e4);
    for _ in 0..100 {
        let middle = 0.5 * (low + high);
        let mean = rhos.iter().map(|r| r.powf(1.0 / middle)).sum::<f64>() / rhos.len() as f64;
        *if mean < share { &mut low } else { &mut high } = middle;
    }
    high
}

/// The decisions by the definition: a proposal is accepted if u < ρ^{1/T}.
fn defined(c: &MhConfig, scene: &Scene) -> Decided {
    let now = |[start, end]: [f64; 2]| start + (end - start) * ETA;
    let voxel = |p: [f32; 3]| p.map(|x| (f64::from(x) / now(c.voxel_edge)).floor());
    let alive: Vec<u32> = (0..ROWS as u32).filter(|i| i % 7 != 0).collect();
    let own = |&i: &u32| voxel(scene.positions.each_ref().map(|p| p[i as usize]));
    let mut held: Vec<[f64; 3]> = alive.iter().map(own).collect();
    let cues = [c.weight_opacity, c.weight_ssim, c.weight_l1];
    let importance = importance(&scene.logits, &scene.cues(), cues);
    let all = 2 * alive.len();
    let size = (0..all).map(|k| change(k).abs()).sum::<f64>() / all as f64;
    let mut wanted = Decided::default();
    use Stream::{CoarseAccept, CoarseOffset, FineAccept, FineOffset};
    let coarse = (c.coarse_spread, CoarseOffset, CoarseAccept);
    let fine = (c.fine_spread, FineOffset, FineAccept);
    for (phase, (spread, offset, accept)) in [coarse, fine].into_iter().enumerate() {
        let mut rated = Vec::new();
        for &row in &alive {
            let i = importance[row as usize];
            let at = place(scene, row as usize, now(spread), offset);
            let count = held.iter().filter(|v| **v == voxel(at)).count() as u32;
            // With estimates σ(−ΔL/s) takes the place of σ(I): its product with D has the form of Alg. 1.
            let (form, gain) = match c.surrogate {
                Surrogate::Probe => {
                    let change = change(wanted.places.len());
                    (Acceptance::Alg1, sigmoid(-change / size))
                }
                _ => (c.acceptance, i),
            };
            let rho = printed(form, gain, c.lambda_voxel, count);
            rated.push((row, rho, (at, count, i)));
            wanted.prior += 1.0 / (1.0 + c.lambda_voxel * f64::from(count)) / all as f64;
            wanted.places.push(at);
        }
        let rhos: Vec<f64> = rated.iter().map(|r| r.1).collect();
        let t = match now(c.target_acceptance) {
            0.0 => now(c.temperature),
            share => temperature(&rhos, share),
        };
        for (row, rho, (at, count, i)) in rated {
            let u = Philox::uniform(SEED, accept.stream(ITERATION), u64::from(row))[0];
            if u < rho.powf(1.0 / t) {
                let birth = (at, count, i, rho.ln() / t);
                wanted.births.insert((phase, row), birth);
                held.push(voxel(at));
            }
        }
    }
    wanted
}

/// Numbers of proposals that are decided in two ways, of births by both that differ, of places that differ, and of means of D
/// (0 or 1); T may be off by a relative `solved`.
fn differences(a: &Decided, b: &Decided, solved: f64) -> [usize; 4] {
    let of_both = |(from, birth)| Some((birth, b.births.get(from)?));
    let both: Vec<(&Birth, &Birth)> = a.births.iter().filter_map(of_both).collect();
    let alike = |(a, b): &(&Birth, &Birth)| {
        let close = (a.3 - b.3).abs() <= ROUNDING + solved * b.3.abs();
        (a.0, a.1, a.2) == (b.0, b.1, b.2) && close
    };
    let unlike = both.iter().filter(|pair| !alike(pair)).count();
    let decided = a.births.len() + b.births.len() - 2 * both.len();
    let places = a.places.iter().zip(&b.places).filter(|(a, b)| a != b);
    let same_prior = (a.prior - b.prior).abs() < ROUNDING;
    [decided, unlike, places.count(), usize::from(!same_prior)]
}

#[test]
fn each_proposal_is_decided_as_defined() {
    let scene = dying(ROWS);
    for (target, solved) in [([0.0, 0.0], 0.0), ([0.4, 0.7], HALVED)] {
        for config in forms(target) {
            let (found, wanted) = (step(&config, &scene), defined(&config, &scene));
            let form = format!("{:?}, {:?}", config.acceptance, config.surrogate);
            assert_eq!(differences(&found, &wanted, solved), [0; 4], "{form}");
            let estimated = config.surrogate == Surrogate::Probe;
            let places = if estimated { wanted.places.len() } else { 0 };
            assert_eq!(found.places.len(), places);
            // Some of each phase are accepted and some refused, and births meet voxels of all kinds.
            for phase in [0, 1] {
                let born = || found.births.iter().filter(|b| b.0.0 == phase);
                assert!((100..1600).contains(&born().count()), "{form}");
                assert!(born().any(|b| b.1.1 == 0) && born().any(|b| b.1.1 > 2));
            }
        }
    }
}

#[test]
fn a_wrong_prior_or_temperature_is_found() {
    let scene = dying(ROWS);
    let differ = |right: &MhConfig, wrong: &MhConfig, solved| {
        let found = differences(&step(right, &scene), &defined(wrong, &scene), solved);
        assert!(found[0] > 0 && found[1] > 100, "{found:?}: {wrong:?}");
        found
    };
    for right in forms([0.0, 0.0]) {
        let (mut prior, mut warm) = (right, right);
        prior.lambda_voxel *= 1.05;
        warm.temperature = right.temperature.map(|t| 1.01 * t);
        assert_eq!(differ(&right, &prior, 0.0)[2..], [0, 1]);
        differ(&right, &warm, 0.0);
    }
    for right in forms([0.4, 0.7]) {
        let (mut warm, mut wide) = (right, right);
        warm.target_acceptance = [0.41, 0.71];
        differ(&right, &warm, HALVED);
        wide.fine_spread = right.fine_spread.map(|k| 1.01 * k);
        let places = differ(&right, &wide, HALVED)[2];
        assert_eq!(places > ROWS / 2, right.surrogate == Surrogate::Probe);
    }
}
