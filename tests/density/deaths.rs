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

/// Births are the target's share of the proposals that the progress asks for, and one for each that dies, within chance; before
/// births begin, at the last step, and without deaths, there are none to replace.
#[test]
fn births_replace_the_dead() {
    for turnover in [0.0, 0.2] {
        let config = MhConfig {
            target_acceptance: [0.1, 0.1],
            births_from_iteration: 1500,
            pixel_proposals: 0,
            turnover,
            ..MhConfig::default()
        };
        let born = |scene: &Scene, progress: f64, last: bool| {
            let mh = MetropolisHastings::new(&config);
            let context = StepContext {
                last,
                before: last.then_some(0.9),
                ..context(700, progress, 1)
            };
            let outcome = mh.step(&context, &scene.state(), &scene.errors()).unwrap();
            assert_eq!(breaches(scene.logits.len(), &outcome), Vec::<String>::new());
            assert_eq!(outcome.stats.relocated, 0);
            outcome.stats
        };
        let dead = DEAD + (turnover * (N - DEAD) as f64) as usize;
        for progress in [0.2, 0.6, 0.95] {
            let stats = born(&dying(N), progress, false);
            assert_eq!(stats.pruned as usize, dead);
            let proposed = stats.proposed as f64;
            let asked = ((1.0 - progress) * 10_000.0).min(proposed);
            let wanted = 0.1 * asked + dead as f64;
            let share = wanted / proposed;
            assert!(share < 0.9, "{progress}: {proposed} proposals are too few");
            let chance = (proposed * share * (1.0 - share)).sqrt();
            let found = stats.accepted as f64;
            assert!(
                (found - wanted).abs() < 4.0 * chance,
                "{progress}: {found} births; {wanted} expected"
            );
        }
        let early = born(&dying(N), 0.0, false);
        assert_eq!((early.accepted, early.pruned as usize), (0, DEAD));
        let last = born(&dying(N), 0.95, true);
        assert_eq!((last.proposed, last.pruned as usize), (0, dead));
    }
}

/// Those that die besides the dead are the share of least opacity, ties by row; they are no source of births.
#[test]
fn the_faintest_die_at_every_step_with_births() {
    let mut scene = Scene::random(N, 21);
    let many = 10;
    scene.logits.iter_mut().for_each(|l| *l = l.max(-4.0));
    for row in (0..N).step_by(N / many) {
        scene.logits[row] = -4.5;
    }
    let step = |turnover: f64, relocation: bool| {
        let config = MhConfig {
            births_from_iteration: 500,
            turnover,
            relocation,
            ..MhConfig::default()
        };
        let mh = MetropolisHastings::new(&config);
        let context = context(700, 0.3, 1);
        mh.step(&context, &scene.state(), &scene.errors()).unwrap()
    };
    let faint: Vec<u32> = (0..N as u32).step_by(N / many).collect();
    let outcome = step(faint.len() as f64 / N as f64 + 1e-9, false);
    assert_eq!(outcome.removed, faint);
    assert!(!outcome.edits.iter().any(|e| faint.contains(&e.src)));
    assert_eq!(step(3.0 / N as f64 + 1e-9, false).removed, faint[..3]);
    assert_eq!(step(0.0, false).removed, Vec::<u32>::new());
    assert_eq!(step(0.5, true).removed, Vec::<u32>::new());
}

/// Nothing but the dead goes if nothing sets the number of births, or nothing is proposed; a step that is the first with births and
/// the last has births, too.
#[test]
fn nothing_dies_that_nothing_replaces() {
    let scene = dying(N);
    let step = |config: MhConfig, before: Option<f64>| {
        let context = StepContext {
            last: true,
            before,
            ..context(700, 0.3, 1)
        };
        let mh = MetropolisHastings::new(&config);
        let outcome = mh.step(&context, &scene.state(), &scene.errors());
        outcome.unwrap().stats
    };
    let config = MhConfig {
        births_from_iteration: 500,
        ..MhConfig::default()
    };
    let unset = MhConfig {
        target_acceptance: [0.0, 0.0],
        ..config
    };
    let unproposed = MhConfig {
        coarse_proposals: 0,
        fine_proposals: 0,
        pixel_proposals: 0,
        ..config
    };
    assert_eq!(step(unset, Some(0.2)).pruned as usize, DEAD);
    assert_eq!(step(unproposed, Some(0.2)).pruned as usize, DEAD);
    let later = MhConfig {
        births_from_iteration: 5000,
        ..config
    };
    let all =
        |stats: mhsplat::density::DensityStats| (stats.pruned as usize > DEAD, stats.accepted > 0);
    assert_eq!(all(step(config, Some(0.2))), (true, false));
    assert_eq!(all(step(config, None)), (true, true));
    assert_eq!(all(step(later, Some(0.2))), (true, true));
}

#[test]
fn the_last_ones_stay() {
    let mut scene = Scene::random(100, 3);
    scene.logits.fill(-6.0);
    let outcome = step(&scene, &context(700, 0.1, 1));
    assert_eq!((outcome.gaussians(), outcome.removed.len()), (100, 0));
}
