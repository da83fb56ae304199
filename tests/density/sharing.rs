//! What relocation and births make of the opacity they share.

use std::collections::HashMap;

use super::step::{breaches, context, dying, step_with};
use mhsplat::base::math::sigmoid;
use mhsplat::config::Birth;
use mhsplat::density::Edit;

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

#[test]
fn births_share_the_opacity_of_their_source() {
    let scene = dying(7000);
    let at = context(700, 0.1, 1);
    let (copied, shared) = (
        step_with(Birth::Copy, &scene, &at),
        step_with(Birth::Split, &scene, &at),
    );
    assert_eq!(breaches(7000, &shared), Vec::<String>::new());
    assert_eq!(
        copied.stats, shared.stats,
        "the form changes what is born, not whether"
    );
    // Before the births: the logit of each source as relocation left it.
    let pass = |l: f32| sigmoid(-f64::from(l));
    let mut families: HashMap<u32, Vec<&Edit>> = HashMap::new();
    for e in shared.edits.iter().filter(|e| e.dst as usize >= 7000) {
        families.entry(e.src).or_default().push(e);
    }
    assert!(
        families.values().any(|f| f.len() == 2),
        "coarse and fine birth"
    );
    for (src, births) in &families {
        let before = copied
            .edits
            .iter()
            .find(|e| e.dst == *src)
            .map_or(scene.logits[*src as usize], |e| e.opacity_logit);
        let source = shared.edits.iter().find(|e| e.dst == *src).unwrap();
        assert_eq!(
            source.position,
            [0, 1, 2].map(|k| scene.positions[k][*src as usize])
        );
        let after: f64 = births
            .iter()
            .map(|e| pass(e.opacity_logit))
            .product::<f64>()
            * pass(source.opacity_logit);
        assert!((after - pass(before)).abs() < 1e-6, "{after} {before}");
        for e in births {
            assert_eq!(
                (e.opacity_logit, e.log_scale),
                (source.opacity_logit, source.log_scale)
            );
            assert!(e.position != source.position);
        }
    }
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
