//! Opacity and shape that relocation and births leave.

use std::collections::{HashMap, HashSet};

use super::step::{breaches, context, dying, step_with};
use mhsplat::base::math::sigmoid;
use mhsplat::config::{Birth, MhConfig};
use mhsplat::density::mh::MetropolisHastings;
use mhsplat::density::{DensityControl, Edit, Outcome};
use mhsplat::pipeline::reference::{rotation, unit_quaternion};

#[test]
fn relocation_keeps_the_rendered_opacity_and_shares_it() {
    let scene = dying(7000);
    let outcome = step_with(Birth::Copy, &scene, &context(700, 0.1, 1));
    let mut groups: HashMap<u32, Vec<&Edit>> = HashMap::new();
    for e in outcome.edits.iter().filter(|e| (e.dst as usize) < 7000) {
        groups.entry(e.src).or_default().push(e);
    }
    assert!(
        groups.values().any(|g| g.len() > 2),
        "a source drawn twice is wanted here"
    );
    for (src, group) in &groups {
        let i = *src as usize;
        assert!(!i.is_multiple_of(7), "a dead row was drawn as a source");
        assert!(
            group.iter().any(|e| e.dst == *src),
            "the source itself keeps the old opacity"
        );
        let pass = |l: f32| sigmoid(-f64::from(l));
        let after: f64 = group.iter().map(|e| pass(e.opacity_logit)).product();
        assert!((after - pass(scene.logits[i])).abs() < 1e-6);
        for e in group {
            assert_eq!(e.position, [0, 1, 2].map(|k| scene.positions[k][i]));
            let offset: Vec<f32> = (0..3)
                .map(|k| e.log_scale[k] - scene.log_scales[k][i])
                .collect();
            assert!(
                offset
                    .iter()
                    .all(|o| *o < 0.0 && (o - offset[0]).abs() < 1e-5)
            );
        }
    }
    // Births copy what relocation left, not what was there before.
    let births: Vec<&Edit> = outcome
        .edits
        .iter()
        .filter(|e| e.dst as usize >= 7000)
        .collect();
    let of_split = births
        .iter()
        .filter(|b| groups.contains_key(&b.src))
        .count();
    assert!(of_split > 0);
    for b in births {
        assert!(!b.src.is_multiple_of(7), "a dead row gave birth");
        let logit = groups
            .get(&b.src)
            .map_or(scene.logits[b.src as usize], |g| g[0].opacity_logit);
        assert_eq!(b.opacity_logit, logit);
    }
}

/// Integral over the plane of what two parts of this opacity paint, a distance either side of the centre and of this scale along one axis, over
/// that of the source, of opacity `o` and scale 1.
fn painted(part: f64, scale: f64, distance: f64, o: f64) -> f64 {
    const STEP: f64 = 0.02;
    let cells = |to: f64| (-(to / STEP) as i32..=(to / STEP) as i32).map(|k| f64::from(k) * STEP);
    let footprint = |x: f64, y: f64| (-0.5 * (x * x + y * y)).exp();
    let sums = cells(7.0).flat_map(|x| cells(7.0).map(move |y| (x, y)));
    let [two, one] = sums.fold([0.0; 2], |[two, one], (x, y)| {
        let pass = |side: f64| 1.0 - part * footprint((x + side * distance) / scale, y);
        [
            two + 1.0 - pass(1.0) * pass(-1.0),
            one + o * footprint(x, y),
        ]
    });
    two / one
}

/// Two parts have together the mean and the covariance of what was split, as relocation left it, and paint as much.
#[test]
fn a_split_keeps_mean_covariance_and_what_is_painted() {
    for distance in [0.5, MhConfig::default().split_distance] {
        parts_at(distance);
    }
}

fn parts_at(distance: f64) {
    let mut scene = dying(7000);
    scene.log_scales[1].iter_mut().for_each(|s| *s += 0.5);
    let [copied, split] = [Birth::Copy, Birth::Split].map(|birth| {
        let config = MhConfig {
            birth: Some(birth),
            split_distance: distance,
            target_acceptance: [0.9, 0.9],
            ..MhConfig::paper()
        };
        MetropolisHastings::new(&config)
            .step(&context(700, 0.1, 1), &scene.state(), &scene.errors())
            .unwrap()
    });
    assert_eq!(breaches(7000, &split), Vec::<String>::new());
    let written = |outcome: &Outcome, row: u32| -> Option<Edit> {
        outcome.edits.iter().find(|e| e.dst == row).copied()
    };
    let births: Vec<&Edit> = split.edits.iter().filter(|e| e.dst >= 7000).collect();
    let distinct: HashSet<u32> = births.iter().map(|e| e.src).collect();
    assert!(births.len() > 1000 && distinct.len() == births.len());
    let (mut axes, mut expected, mut right, mut relocated) = ([0.0; 3], [0.0; 3], 0.0, 0);
    let (mut painting, mut opaque) = (0, 0);
    let number = births.len() as f64;
    for birth in births {
        let i = birth.src as usize;
        let before = written(&copied, birth.src);
        relocated += usize::from(before.is_some());
        let (own_scale, own_logit) = match before {
            Some(edit) => (edit.log_scale, edit.opacity_logit),
            None => ([0, 1, 2].map(|k| scene.log_scales[k][i]), scene.logits[i]),
        };
        let source = written(&split, birth.src).unwrap();
        let shape = |e: &Edit| (e.log_scale, e.opacity_logit);
        assert_eq!(shape(&source), shape(birth));
        let quaternion = scene.rotations.each_ref().map(|p| f64::from(p[i]));
        let turn = rotation(unit_quaternion(quaternion).0);
        let centre = [0, 1, 2].map(|k| f64::from(scene.positions[k][i]));
        let apart = [0, 1, 2].map(|k| f64::from(birth.position[k]) - centre[k]);
        for k in 0..3 {
            let mean = 0.5 * (f64::from(birth.position[k]) + f64::from(source.position[k]));
            assert!((mean - centre[k]).abs() < 1e-5, "{mean} {centre:?}");
        }
        // Along the axes of the source.
        let along = [0, 1, 2].map(|axis| (0..3).map(|k| turn[k][axis] * apart[k]).sum::<f64>());
        let variance = |s: f32| (2.0 * f64::from(s)).exp();
        let all: f64 = own_scale.iter().map(|s| variance(*s)).sum();
        for axis in 0..3 {
            let together = variance(birth.log_scale[axis]) + along[axis] * along[axis];
            let ratio = together / variance(own_scale[axis]);
            assert!((ratio - 1.0).abs() < 1e-3, "{ratio}");
            expected[axis] += variance(own_scale[axis]) / all;
        }
        let other = |a: &usize| birth.log_scale[*a] != own_scale[*a];
        let axis = (0..3).find(other).unwrap();
        axes[axis] += 1.0;
        right += f64::from(u8::from(along[axis] > 0.0));
        let o = sigmoid(f64::from(own_logit));
        let part = sigmoid(f64::from(birth.opacity_logit));
        assert!(part <= 0.99 + 1e-6);
        opaque += usize::from(part > 0.98999);
        // Of opaque ones the two hide much of each other.
        if part < 0.98999 && o > 0.6 && painting < 4 {
            let scale = (1.0 - distance * distance).sqrt();
            let ratio = painted(part, scale, distance, o);
            assert!((ratio - 1.0).abs() < 1e-4, "{ratio} of {o}");
            painting += 1;
        }
    }
    assert!(painting == 4 && relocated > 50, "{painting} {relocated}");
    assert_eq!(opaque > 0, distance > 0.85, "{opaque}");
    for (found, wanted) in axes
        .into_iter()
        .zip(expected)
        .chain([(right, number / 2.0)])
    {
        assert!(
            (found - wanted).abs() < 4.0 * number.sqrt(),
            "{found} {wanted}"
        );
    }
    // Axes drawn evenly would be refused.
    let uneven = expected.map(|n| (n - number / 3.0).abs());
    assert!(
        uneven.iter().any(|gap| *gap > 4.0 * number.sqrt()),
        "{expected:?}"
    );
}

#[test]
fn a_faint_birth_leaves_its_source_and_is_no_more_opaque_than_said() {
    let scene = dying(7000);
    let at = context(700, 0.1, 1);
    let [copied, faint] = [Birth::Copy, Birth::Faint].map(|form| step_with(form, &scene, &at));
    assert_eq!(breaches(7000, &faint), Vec::<String>::new());
    assert_eq!(copied.stats, faint.stats);
    let most = (0.1f64 / 0.9).ln() as f32;
    let mut limited = 0;
    for (a, b) in copied.edits.iter().zip(&faint.edits) {
        let born = a.dst as usize >= 7000;
        limited += usize::from(born && a.opacity_logit > most);
        let mut expected = *a;
        if born {
            expected.opacity_logit = a.opacity_logit.min(most);
            expected.log_scale = a.log_scale.map(|s| s + 0.6f64.ln() as f32);
        }
        assert_eq!(*b, expected);
    }
    assert!(limited > 100 && copied.edits.len() == faint.edits.len());
}
