//! MCMC density control: relocation and growth against the printed formulas, counts, caps.

use std::collections::HashMap;

use super::parts::alternating_sum;
use super::step::{breaches, context, dying};
use super::{Scene, on_threads};
use mhsplat::base::math::sigmoid;
use mhsplat::config::McmcConfig;
use mhsplat::density::{DensityControl, Edit, Mcmc, Outcome, Statistics, StepContext};

fn step_of(config: &McmcConfig, scene: &Scene, context: &StepContext) -> Outcome {
    Mcmc::new(config)
        .step(context, &scene.state(), &Statistics::Nothing)
        .unwrap()
}

fn step(scene: &Scene, context: &StepContext) -> Outcome {
    step_of(&McmcConfig::default(), scene, context)
}

/// [MCMC] Eq. 9 as printed, in f64: opacity and factor on the scales of each of N copies.
fn printed_split(opacity: f64, copies: u32) -> (f64, f64) {
    let each = 1.0 - (1.0 - opacity).powf(1.0 / f64::from(copies));
    (each, opacity / alternating_sum(each, copies))
}

/// Whether an edit is what so many copies of a Gaussian of this opacity and log-scale are to be.
fn is_split(e: &Edit, opacity: f64, log_scale: [f64; 3], copies: u32) -> bool {
    let (each, factor) = printed_split(opacity, copies);
    let close = |a: f64, b: f64| (a - b).abs() < 2e-5 * b.abs().max(1e-3);
    close(sigmoid(f64::from(e.opacity_logit)), each)
        && (0..3).all(|k| close(f64::from(e.log_scale[k]), log_scale[k] + factor.ln()))
}

fn of_row(scene: &Scene, row: u32) -> (f64, [f64; 3]) {
    let i = row as usize;
    let log_scale = [0, 1, 2].map(|k| f64::from(scene.log_scales[k][i]));
    (sigmoid(f64::from(scene.logits[i])), log_scale)
}

fn by_source<'a>(edits: impl Iterator<Item = &'a Edit>) -> HashMap<u32, Vec<&'a Edit>> {
    let mut groups: HashMap<u32, Vec<&Edit>> = HashMap::new();
    for e in edits {
        groups.entry(e.src).or_default().push(e);
    }
    groups
}

#[test]
fn relocation_is_the_printed_equation() {
    let scene = dying(3000);
    let still = McmcConfig {
        growth: 1.0,
        ..McmcConfig::default()
    };
    let outcome = step_of(&still, &scene, &context(700, 0.1, 1));
    assert_eq!((outcome.rows, outcome.stats.relocated), (3000, 429));
    assert_eq!(outcome.stats.accepted, 0);
    let groups = by_source(outcome.edits.iter());
    assert!(groups.values().any(|g| g.len() >= 3));
    for (source, group) in groups {
        let (opacity, log_scale) = of_row(&scene, source);
        let copies = group.len() as u32;
        for e in group {
            assert!(is_split(e, opacity, log_scale, copies), "{copies}: {e:?}");
            assert!(!is_split(e, opacity, log_scale, copies + 1));
        }
    }
}

#[test]
fn growth_is_the_printed_equation_with_multiplicity() {
    let scene = Scene::random(2000, 5);
    let outcome = step(&scene, &context(700, 0.1, 1));
    assert_eq!((outcome.rows, outcome.stats.relocated), (2100, 0));
    let groups = by_source(outcome.edits.iter());
    assert!(
        groups.values().any(|g| g.len() >= 3),
        "a source drawn twice is wanted here"
    );
    for (source, group) in groups {
        let (opacity, log_scale) = of_row(&scene, source);
        assert_eq!(group.iter().filter(|e| e.dst == source).count(), 1);
        for e in &group {
            assert!(is_split(e, opacity, log_scale, group.len() as u32));
            assert_eq!(
                e.position,
                [0, 1, 2].map(|k| scene.positions[k][source as usize])
            );
        }
    }
}

#[test]
fn growth_after_relocation_splits_what_relocation_left() {
    let mut scene = dying(3000);
    // One Gaussian outweighs all others, so that the same row is drawn by the dead and by growth.
    scene
        .logits
        .iter_mut()
        .skip(1)
        .for_each(|l| *l = l.min(-5.2));
    scene.logits[100] = 4.0;
    let outcome = step(&scene, &context(700, 0.1, 1));
    assert_eq!(breaches(3000, &outcome), Vec::<String>::new());
    assert_eq!(outcome.rows, 3150);
    assert!(outcome.edits.iter().filter(|e| e.src == 100).count() > 20);
    // Whatever the order of the splits: a family together is as transparent as its source was.
    for (source, group) in by_source(outcome.edits.iter()) {
        let logs = |l: f64| -> f64 { sigmoid(-l).ln() };
        let before = logs(f64::from(scene.logits[source as usize]));
        let rest = group.iter().map(|e| logs(f64::from(e.opacity_logit)));
        let after: f64 = rest.sum();
        assert!(
            (after / before - 1.0).abs() < 1e-4,
            "{source}: {after} {before}"
        );
    }
}

#[test]
fn sources_of_growth_follow_opacity() {
    let mut scene = Scene::random(20_000, 4);
    for i in 0..20_000 {
        scene.logits[i] = [-2.0, 0.0, 2.0][i % 3];
    }
    let double = McmcConfig {
        growth: 2.0,
        ..McmcConfig::default()
    };
    let outcome = step_of(&double, &scene, &context(700, 0.5, 1));
    let born = outcome.edits.iter().filter(|e| e.dst >= 20_000);
    let mut tally = [0.0; 3];
    born.for_each(|e| tally[e.src as usize % 3] += 1.0);
    assert_eq!(tally.iter().sum::<f64>(), 20_000.0);
    let total: f64 = [-2.0, 0.0, 2.0].map(sigmoid).iter().sum();
    for (k, logit) in [-2.0, 0.0, 2.0].into_iter().enumerate() {
        // Five standard errors of a share of 20,000 draws.
        assert!((tally[k] / 20_000.0 - sigmoid(logit) / total).abs() < 0.018);
    }
}

#[test]
fn counts_grow_by_five_per_cent_to_the_cap() {
    let counts = |n: usize, max_gaussians: Option<usize>| {
        let bounded = StepContext {
            max_gaussians,
            ..context(600, 0.1, 1)
        };
        let outcome = step(&Scene::random(n, 1), &bounded);
        assert_eq!(breaches(n, &outcome), Vec::<String>::new());
        assert_eq!(outcome.stats.accepted as usize, outcome.rows - n);
        assert!(outcome.removed.is_empty() && outcome.logit_limit.is_none());
        outcome.rows
    };
    // ⌊1.05 n⌋, by hand.
    for (n, want) in [
        (1, 1),
        (19, 19),
        (20, 21),
        (39, 40),
        (40, 42),
        (100, 105),
        (1000, 1050),
    ] {
        assert_eq!(counts(n, None), want, "{n}");
    }
    assert_eq!(counts(1000, Some(1049)), 1049);
    assert_eq!(counts(1000, Some(1000)), 1000);
    assert_eq!(counts(1000, Some(10)), 1000, "the cap removes nothing");
    // Where nothing else is said there is a cap, too.
    let capped = McmcConfig {
        cap: 102,
        ..McmcConfig::default()
    };
    assert_eq!(
        step_of(&capped, &Scene::random(100, 1), &context(600, 0.1, 1)).rows,
        102
    );
}

#[test]
fn with_everything_dead_or_nothing_there_nothing_happens() {
    let mut scene = Scene::random(50, 1);
    scene.logits.fill(-9.0);
    for n in [50, 0] {
        let scene = if n == 0 {
            Scene::random(0, 1)
        } else {
            scene.clone()
        };
        let outcome = step(&scene, &context(600, 0.0, 0));
        assert!(outcome.edits.is_empty() && outcome.rows == n);
        assert_eq!((outcome.stats.accepted, outcome.stats.relocated), (0, 0));
    }
    scene.logits[7] = 1.0;
    let outcome = step(&scene, &context(600, 0.0, 0));
    assert_eq!((outcome.rows, outcome.stats.relocated), (52, 49));
    assert_eq!(breaches(50, &outcome), Vec::<String>::new());
    assert!(outcome.edits.iter().all(|e| e.src == 7));
}

#[test]
fn same_seed_same_edits_on_any_number_of_threads() {
    let scene = dying(20_000);
    let run = |seed: u64, iteration: u32| step(&scene, &context(iteration, 0.3, seed)).edits;
    let one = on_threads(1, || run(5, 900));
    assert!(one == on_threads(2, || run(5, 900)));
    assert!(run(6, 900) != one && run(5, 1000) != one);
}
