//! Births after relocation: they start from what it has left.

use std::collections::HashMap;

use super::Scene;
use super::step::{breaches, context, dying};
use mhsplat::base::rng::{Philox, Stream};
use mhsplat::config::MhConfig;
use mhsplat::density::draw::birth_position;
use mhsplat::density::mh::MetropolisHastings;
use mhsplat::density::{BirthKind, DensityControl, Edit, Outcome};

const N: usize = 700;
const DEAD: usize = 100;

fn step(config: &MhConfig, scene: &Scene) -> Outcome {
    let mh = MetropolisHastings::new(config);
    let context = context(700, 0.0, 3);
    let outcome = mh.step(&context, &scene.state(), &scene.errors()).unwrap();
    assert_eq!(breaches(N, &outcome), Vec::<String>::new());
    outcome
}

/// A source that relocation has split bears by the scale that it has then.
#[test]
fn births_spread_by_the_scale_after_relocation() {
    let config = MhConfig {
        lambda_voxel: 0.0,
        temperature: [1e9, 1e9],
        ..MhConfig::paper()
    };
    let scene = dying(N);
    let outcome = step(&config, &scene);
    assert_eq!(outcome.stats.relocated as usize, DEAD);
    let in_place = outcome.edits.iter().filter(|e| e.src == e.dst);
    let split: HashMap<u32, &Edit> = in_place.map(|e| (e.src, e)).collect();
    let mut seen = [0, 0];
    for record in &outcome.births {
        let birth = outcome.edits.iter().find(|e| e.dst == record.dst).unwrap();
        let Some(source) = split.get(&birth.src) else {
            continue;
        };
        let (stream, spread, kind) = match record.kind {
            BirthKind::Coarse => (Stream::CoarseOffset, config.coarse_spread[0], 0),
            _ => (Stream::FineOffset, config.fine_spread[0], 1),
        };
        let [x, y, z, _] = Philox::normal(3, stream.stream(700), u64::from(birth.src));
        let row = birth.src as usize;
        let place =
            |log_scale: [f32; 3]| birth_position(&scene.state(), row, log_scale, spread, [x, y, z]);
        assert_eq!(Some(birth.position), place(source.log_scale));
        let before = scene.log_scales.each_ref().map(|plane| plane[row]);
        assert_ne!(Some(birth.position), place(before));
        seen[kind] += 1;
    }
    assert!(seen[0] > 20 && seen[1] > 20, "{seen:?}");
}

/// A relocated row is in the voxel of its new place, and no longer in that of the old one.
#[test]
fn births_meet_the_relocated_in_their_new_voxels() {
    let mut scene = dying(N);
    for plane in &mut scene.positions {
        for (i, x) in plane.iter_mut().enumerate() {
            // The dead are in a voxel of their own, and so are the others, with what they bear.
            *x = match i % 7 {
                0 => -1e3 + 0.1 * x.clamp(-1.0, 1.0),
                _ => 1e3 + *x,
            };
        }
    }
    let config = MhConfig {
        voxel_edge: [1e6, 1e6],
        temperature: [10.0, 10.0],
        ..MhConfig::paper()
    };
    let counts = |config: &MhConfig| {
        let outcome = step(config, &scene);
        let first = |b: &&mhsplat::density::BirthRecord| b.kind == BirthKind::Coarse;
        let counts: Vec<u32> = outcome
            .births
            .iter()
            .filter(first)
            .map(|b| b.voxel_count)
            .collect();
        assert!(counts.len() > 5);
        (counts, outcome.stats.occupied_voxels)
    };
    let (moved, voxels) = counts(&config);
    assert!(moved.iter().all(|c| *c as usize == N));
    assert_eq!(voxels, 1);
    // Where the dead are removed they are nowhere.
    let removing = MhConfig {
        relocation: false,
        ..config
    };
    let (removed, _) = counts(&removing);
    assert!(removed.iter().all(|c| *c as usize == N - DEAD));
}
