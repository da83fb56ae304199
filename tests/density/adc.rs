//! Adaptive density control on a toy scene whose fates are worked out by hand.

use super::Scene;
use super::step::{breaches, context};
use mhsplat::base::math::sigmoid;
use mhsplat::config::AdcConfig;
use mhsplat::density::{
    Adaptive, DensityControl, Outcome, ScreenGradient, Statistics, StepContext,
};

/// (largest scale, opacity, sum of norms, iterations); τ = 2e-4, clones up to 0.01, prunes below 0.005 and, after the first
/// reset, above 0.1.
const TOY: [(f64, f64, f32, u32); 10] = [
    (0.005, 0.5, 3e-4, 1),    // 0 small, pulled: cloned
    (0.005, 0.5, 1e-4, 1),    // 1 small, not pulled
    (0.05, 0.5, 3e-4, 1),     // 2 large, pulled: split
    (0.005, 0.004, 9.0, 1),   // 3 pulled, but transparent: pruned
    (0.15, 0.5, 1e-4, 1),     // 4 too large: pruned after the first reset
    (0.15, 0.5, 9.0, 1),      // 5 too large, but its halves (0.094) are not: split
    (0.2, 0.5, 9.0, 1), // 6 too large, and so are its halves (0.125): split, then pruned after the first reset
    (0.005, 0.5, 0.0, 0), // 7 never seen
    (0.005, 0.5, 1e-3, 10), // 8 pulled in sum, not in the mean
    (0.005, 0.006, 3e-3, 10), // 9 faint, pulled in the mean: cloned
];

/// The toy, its gradients and how often each row was seen.
fn toy() -> (Scene, Vec<f32>, Vec<u32>) {
    let mut scene = Scene::random(TOY.len(), 1);
    for (i, (scale, opacity, _, _)) in TOY.into_iter().enumerate() {
        for (k, shorter) in [1.0, 0.5, 0.25].into_iter().enumerate() {
            scene.log_scales[(k + i) % 3][i] = (scale * shorter).ln() as f32;
        }
        scene.logits[i] = (opacity / (1.0 - opacity)).ln() as f32;
    }
    let (norms, views) = (TOY.map(|t| t.2), TOY.map(|t| t.3));
    (scene, norms.to_vec(), views.to_vec())
}

fn step_on(toy: &(Scene, Vec<f32>, Vec<u32>), context: &StepContext) -> Outcome {
    let (scene, norms, views) = toy;
    let gradient = ScreenGradient { norms, views };
    Adaptive::new(&AdcConfig::default())
        .step(
            context,
            &scene.state(),
            &Statistics::ScreenGradient(gradient),
        )
        .unwrap()
}

/// A step with so many resets due before and by it, and this bound.
fn step(opacity_resets: [u32; 2], max_gaussians: Option<usize>) -> Outcome {
    let [before, by_now] = opacity_resets;
    let context = StepContext {
        opacity_resets: before,
        resets_opacity: by_now > before,
        max_gaussians,
        ..context(600, 0.0, 3)
    };
    let outcome = step_on(&toy(), &context);
    assert_eq!(breaches(TOY.len(), &outcome), Vec::<String>::new());
    outcome
}

/// Cloned, split, removed, Gaussians afterwards.
fn counts(o: &Outcome) -> [u64; 4] {
    let s = &o.stats;
    assert_eq!(s.accepted, s.cloned + s.split);
    assert_eq!(s.pruned as usize, o.removed.len());
    [s.cloned, s.split, s.pruned, o.gaussians() as u64]
}

#[test]
fn counts_are_those_worked_out_by_hand() {
    let before = step([0, 0], None);
    assert_eq!(counts(&before), [2, 3, 1, 14]);
    assert_eq!(before.removed, [3]);
    let after = step([1, 1], None);
    assert_eq!(counts(&after), [2, 2, 3, 11]);
    assert_eq!(after.removed, [3, 4, 6]);
    assert_eq!([before.rows, after.rows], [15, 14]);
}

#[test]
fn clones_are_copies_and_splits_are_two_smaller_ones_inside() {
    let (scene, ..) = toy();
    let outcome = step([0, 0], None);
    let of = |row: u32| -> Vec<_> { outcome.edits.iter().filter(|e| e.src == row).collect() };
    let position = |i: usize| [0, 1, 2].map(|k| scene.positions[k][i]);
    let log_scale = |i: usize| [0, 1, 2].map(|k| scene.log_scales[k][i]);
    for row in [0u32, 9] {
        let i = row as usize;
        let [clone] = of(row)[..] else {
            panic!("the source of a clone is not written")
        };
        assert!(clone.dst >= 10);
        assert_eq!(
            (clone.position, clone.log_scale),
            (position(i), log_scale(i))
        );
        assert_eq!(clone.opacity_logit, scene.logits[i]);
    }
    for row in [2u32, 5, 6] {
        let i = row as usize;
        let halves = of(row);
        assert_eq!(halves.len(), 2);
        assert!(halves[0].dst == row && halves[1].dst >= 10);
        assert!(halves[0].position != halves[1].position);
        for half in halves {
            assert_eq!(half.opacity_logit, scene.logits[i]);
            for k in 0..3 {
                let shrunk = f64::from(log_scale(i)[k]) - 1.6f64.ln();
                assert!((f64::from(half.log_scale[k]) - shrunk).abs() < 1e-6);
                // The largest of three normal numbers beyond six would be one in 10⁸.
                let reach = 6.0 * TOY[i].0 as f32;
                assert!((half.position[k] - position(i)[k]).abs() < reach);
            }
        }
    }
}

#[test]
fn samples_of_a_split_follow_the_gaussian() {
    let n = 3000;
    let mut scene = Scene::random(n, 8);
    let half = std::f32::consts::FRAC_1_SQRT_2;
    // A turn by 90° about z: the first axis, the longest, is the scene's y.
    for (plane, q) in scene.rotations.iter_mut().zip([half, 0.0, 0.0, half]) {
        plane.fill(q);
    }
    for (plane, s) in scene.log_scales.iter_mut().zip([0.4f32, 0.1, 0.02]) {
        plane.fill(s.ln());
    }
    let toy = (scene, vec![1.0; n], vec![1; n]);
    let outcome = step_on(&toy, &context(600, 0.0, 3));
    assert_eq!(outcome.stats.split, n as u64);
    for (axis, want) in [(1, 0.4), (0, 0.1), (2, 0.02)] {
        let offsets = outcome
            .edits
            .iter()
            .map(|e| f64::from(e.position[axis] - toy.0.positions[axis][e.src as usize]));
        let sum: f64 = offsets.map(|d| d * d).sum();
        let deviation = (sum / (2 * n) as f64).sqrt();
        // Five standard errors of a deviation from 6,000 samples.
        assert!(
            (deviation / want - 1.0).abs() < 0.046,
            "{axis}: {deviation}"
        );
    }
}

#[test]
fn the_bound_takes_the_largest_gradients_first() {
    // One is pruned: 9 are left, and 14 would be without a bound.
    let within = |most: usize| {
        let outcome = step([0, 0], Some(most));
        let mut rows: Vec<u32> = outcome.edits.iter().map(|e| e.src).collect();
        rows.dedup();
        (outcome.gaussians(), rows)
    };
    assert_eq!(within(14), (14, vec![0, 2, 5, 6, 9]));
    // Means: 0 and 2 3e-4, 5 and 6 9, 9 3e-4; ties by row.
    assert_eq!(within(12), (12, vec![0, 5, 6]));
    assert_eq!(within(11), (11, vec![5, 6]));
    assert_eq!(within(10), (10, vec![5]));
    assert_eq!(within(9), (9, vec![]));
    // After the first reset three go, and 5, which is too large, goes too if it is not split. What its going leaves free is
    // not given away in the same step.
    let after = step([1, 1], Some(7));
    assert_eq!((after.removed, after.stats.split), (vec![3, 4, 5, 6], 0));
    let after = step([1, 1], Some(8));
    assert_eq!((after.removed, after.stats.split), (vec![3, 4, 6], 1));
    assert_eq!(within(1), (9, vec![]), "the bound removes nothing");
}

#[test]
fn opacity_is_reset_when_due() {
    assert_eq!(step([0, 0], None).logit_limit, None);
    assert_eq!(step([2, 2], None).logit_limit, None);
    for due in [[0, 1], [2, 4]] {
        let outcome = step(due, None);
        let limit = f64::from(outcome.logit_limit.unwrap());
        assert!((sigmoid(limit) - 0.01).abs() < 1e-8);
        assert_eq!(outcome.stats.opacity_resets, 1);
    }
}

#[test]
fn a_scene_is_never_emptied() {
    let (mut scene, norms, views) = toy();
    scene.logits.fill(-9.0);
    let outcome = step_on(&(scene, norms, views), &context(600, 0.0, 3));
    assert_eq!(counts(&outcome), [0, 0, 0, 10]);
    let nothing = (Scene::random(0, 1), Vec::new(), Vec::new());
    assert_eq!(step_on(&nothing, &context(600, 0.0, 3)).rows, 0);
}

#[test]
fn what_broke_goes_and_a_broken_gradient_pulls_nothing() {
    let (mut scene, mut norms, views) = toy();
    scene.positions[1][1] = f32::NAN;
    scene.logits[7] = f32::NAN;
    scene.log_scales[2][8] = f32::INFINITY;
    norms[0] = f32::NAN;
    let outcome = step_on(&(scene, norms, views), &context(600, 0.0, 3));
    assert_eq!(outcome.removed, [1, 3, 7, 8]);
    assert_eq!(counts(&outcome), [1, 3, 4, 10]);
}

#[test]
fn evidence_of_another_length_is_refused() {
    let (scene, norms, views) = toy();
    let short = ScreenGradient {
        norms: &norms[1..],
        views: &views,
    };
    let result = Adaptive::new(&AdcConfig::default()).step(
        &context(600, 0.0, 0),
        &scene.state(),
        &Statistics::ScreenGradient(short),
    );
    let said = result.unwrap_err().to_string();
    assert!(said.contains("9 values; 10 expected"), "{said}");
}
