//! Deaths: until when the dead go instead of being relocated.

use super::Scene;
use super::step::{breaches, context, dying};
use mhsplat::config::MhConfig;
use mhsplat::density::mh::MetropolisHastings;
use mhsplat::density::{DensityControl, Outcome, StepContext};

const N: usize = 7000;
const DEAD: usize = 1000;

fn config() -> MhConfig {
    MhConfig {
        from_iteration: 500,
        deaths_until_iteration: 1500,
        until_iteration: 2500,
        ..MhConfig::paper()
    }
}

fn step(scene: &Scene, context: &StepContext<'_>) -> Outcome {
    let mh = MetropolisHastings::new(&config());
    let outcome = mh.step(context, &scene.state(), &scene.errors()).unwrap();
    assert_eq!(breaches(scene.logits.len(), &outcome), Vec::<String>::new());
    outcome
}

#[test]
fn the_dead_go_first_and_are_relocated_later() {
    let scene = dying(N);
    for (progress, goes) in [(0.0, true), (0.49, true), (0.5, false), (1.0, false)] {
        let outcome = step(&scene, &context(700, progress, 1));
        let dead: Vec<u32> = (0..N as u32).step_by(7).collect();
        let (removed, relocated) = if goes { (dead, 0) } else { (vec![], DEAD) };
        assert_eq!(outcome.removed, removed, "{progress}");
        assert_eq!(outcome.stats.pruned as usize, removed.len());
        assert_eq!(outcome.stats.relocated as usize, relocated);
        let born = outcome.stats.accepted as usize;
        assert!(born > 0);
        assert_eq!(outcome.gaussians(), N + born - removed.len());
        let from_the_dead = |e: &mhsplat::density::Edit| removed.contains(&e.src);
        assert!(!outcome.edits.iter().any(from_the_dead));
    }
}

#[test]
fn a_bound_has_room_for_as_many_as_go() {
    let scene = dying(N);
    for (most, born) in [(N - DEAD, 0), (N - DEAD + 10, 10), (N, DEAD)] {
        let bounded = StepContext {
            max_gaussians: Some(most),
            ..context(700, 0.1, 1)
        };
        let outcome = step(&scene, &bounded);
        assert_eq!(outcome.stats.accepted as usize, born);
        assert_eq!(outcome.gaussians(), most);
    }
}

/// Births are the target's share of the proposals and one for each of the dead, within chance, up to the last step, where the
/// target alone would ask for none; before births begin, and without deaths, there are none to replace.
#[test]
fn births_replace_the_dead() {
    let config = MhConfig {
        target_acceptance: [0.1, 0.1],
        births_from_iteration: 1500,
        pixel_proposals: 0,
        ..MhConfig::default()
    };
    let born = |scene: &Scene, progress: f64| {
        let mh = MetropolisHastings::new(&config);
        let context = context(700, progress, 1);
        let outcome = mh.step(&context, &scene.state(), &scene.errors()).unwrap();
        assert_eq!(breaches(scene.logits.len(), &outcome), Vec::<String>::new());
        assert_eq!(outcome.stats.relocated, 0);
        outcome.stats
    };
    for progress in [0.2, 0.6, 1.0] {
        let stats = born(&dying(N), progress);
        assert_eq!(stats.pruned as usize, DEAD);
        let proposed = stats.proposed as f64;
        let wanted = 0.1 * proposed + DEAD as f64;
        let share = wanted / proposed;
        assert!(share < 0.9, "{progress}: {proposed} proposals are too few");
        let chance = (proposed * share * (1.0 - share)).sqrt();
        let found = stats.accepted as f64;
        assert!(
            (found - wanted).abs() < 4.0 * chance,
            "{progress}: {found} births; {wanted} expected"
        );
        let without = born(&Scene::random(N, 21), progress);
        let wanted = 0.1 * without.proposed as f64;
        assert!((without.accepted as f64) < wanted + 4.0 * wanted.sqrt());
    }
    let early = born(&dying(N), 0.0);
    assert_eq!((early.accepted, early.pruned as usize), (0, DEAD));
}

#[test]
fn the_last_ones_stay() {
    let mut scene = Scene::random(100, 3);
    scene.logits.fill(-6.0);
    let outcome = step(&scene, &context(700, 0.1, 1));
    assert_eq!((outcome.gaussians(), outcome.removed.len()), (100, 0));
}
