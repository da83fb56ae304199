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

/// Rate of turnover at which a step at progress η, the first, removes a share.
fn rate(share: f64, progress: f64) -> f64 {
    -(-share).ln_1p() / progress
}

/// Births are the target's share of the proposals, within chance, whatever dies; before births begin and at the last step
/// there are none.
#[test]
fn births_are_the_share_that_is_asked_for() {
    for share in [0.0, 0.1] {
        let born = |progress: f64, last: bool| {
            let config = MhConfig {
                target_acceptance: [0.1, 0.4],
                births_from_iteration: Some(1500),
                pixel_proposals: 0,
                turnover: rate(share, progress.max(0.1)),
                ..MhConfig::default()
            };
            let mh = MetropolisHastings::new(&config);
            let context = StepContext {
                last,
                before: last.then_some(0.2),
                ..context(700, progress, 1)
            };
            let scene = dying(N);
            let outcome = mh.step(&context, &scene.state(), &scene.errors()).unwrap();
            assert_eq!(breaches(scene.logits.len(), &outcome), Vec::<String>::new());
            assert_eq!(outcome.stats.relocated, 0);
            outcome.stats
        };
        let dead = DEAD + (share * (N - DEAD) as f64) as usize;
        for progress in [0.2, 0.6, 0.95] {
            let stats = born(progress, false);
            assert!(dead.abs_diff(stats.pruned as usize) <= 1, "{stats:?}");
            let (proposed, target) = (stats.proposed as f64, 0.1 + 0.3 * progress);
            let chance = (proposed * target * (1.0 - target)).sqrt();
            let (found, wanted) = (stats.accepted as f64, proposed * target);
            assert!(
                (found - wanted).abs() < 4.0 * chance,
                "{progress}: {found} births; {wanted} expected"
            );
        }
        let early = born(0.0, false);
        assert_eq!((early.accepted, early.pruned as usize), (0, DEAD));
        let last = born(0.95, true);
        assert_eq!(last.proposed > 0, share == 0.0);
        assert_eq!(last.pruned as usize > DEAD, share > 0.0);
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
    let step = |share: f64, relocation: bool| {
        let config = MhConfig {
            births_from_iteration: Some(500),
            turnover: rate(share, 0.3),
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
    assert_eq!(step(0.1, true).removed, Vec::<u32>::new());
}

/// A span of progress removes the same share in one step as in three, so that runs of more steps keep as many.
#[test]
fn more_steps_remove_no_more() {
    let config = MhConfig {
        births_from_iteration: Some(500),
        dead_opacity: 0.0,
        ..MhConfig::default()
    };
    let left = |gaussians: usize, before: f64, progress: f64| {
        let scene = Scene::random(gaussians, 4);
        let context = StepContext {
            before: Some(before),
            ..context(700, progress, 1)
        };
        let mh = MetropolisHastings::new(&config);
        let outcome = mh.step(&context, &scene.state(), &scene.errors()).unwrap();
        gaussians - outcome.removed.len()
    };
    let once = left(N, 0.2, 0.29);
    let ends = [0.2, 0.23, 0.26, 0.29];
    let thrice = ends.windows(2).fold(N, |n, w| left(n, w[0], w[1]));
    let expected = N as f64 * (-config.turnover * 0.09).exp();
    assert!((once as f64 - expected).abs() <= 1.0, "{once}");
    assert!(once.abs_diff(thrice) <= 3, "{once}, {thrice}");
}

#[test]
fn no_step_removes_most_of_the_living() {
    let config = MhConfig {
        births_from_iteration: Some(500),
        turnover: 1e9,
        ..MhConfig::default()
    };
    let scene = dying(N);
    let mh = MetropolisHastings::new(&config);
    let outcome = mh.step(&context(700, 0.3, 1), &scene.state(), &scene.errors());
    let stats = outcome.unwrap().stats;
    assert_eq!(
        stats.pruned as usize,
        DEAD + (0.15 * (N - DEAD) as f64) as usize
    );
    assert!(stats.accepted > 0);
}

/// Births of all kinds share what room a bound leaves.
#[test]
fn no_kind_of_birth_takes_all_the_room() {
    let scene = dying(N);
    let pictures = [super::pixels::picture()];
    let bounded = StepContext {
        max_gaussians: Some(N - DEAD + 1000),
        pictures: &pictures,
        ..context(700, 0.3, 1)
    };
    let config = MhConfig {
        births_from_iteration: Some(500),
        coarse_proposals: 4_500,
        turnover: 0.0,
        ..MhConfig::default()
    };
    let mh = MetropolisHastings::new(&config);
    let outcome = mh.step(&bounded, &scene.state(), &scene.errors()).unwrap();
    let stats = outcome.stats;
    assert!(outcome.gaussians() <= N - DEAD + 1000);
    let all = 1000.0 / stats.proposed as f64;
    for [proposed, accepted] in [stats.coarse, stats.fine, stats.pixel] {
        let (proposed, accepted) = (proposed as f64, accepted as f64);
        let chance = (proposed * all).sqrt();
        assert!(
            proposed > 100.0 && (accepted - proposed * all).abs() < 5.0 * chance,
            "{stats:?}"
        );
    }
}

/// Nothing but the dead goes where nothing is proposed; a step that is the first with births and the last has births, too.
#[test]
fn nothing_dies_where_nothing_is_born() {
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
        births_from_iteration: Some(500),
        ..MhConfig::default()
    };
    let unproposed = MhConfig {
        coarse_proposals: 0,
        fine_proposals: 0,
        pixel_proposals: 0,
        ..config
    };
    assert_eq!(step(unproposed, Some(0.2)).pruned as usize, DEAD);
    let later = MhConfig {
        births_from_iteration: Some(5000),
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
