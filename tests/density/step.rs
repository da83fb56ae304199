//! The whole density step, its contract and its reproducibility.

use std::collections::{HashMap, HashSet};

use super::{Scene, on_threads};
use mhsplat::base::math::sigmoid;
use mhsplat::config::{Birth, MhConfig, Sampler, TrainConfig};
use mhsplat::density::mh::MetropolisHastings;
use mhsplat::density::{
    DensityControl, DensityStats, Edit, ErrorStatistics, Fixed, Outcome, Statistics,
    StatisticsKind, StepContext, make,
};

pub fn context(iteration: u32, progress: f64, seed: u64) -> StepContext<'static> {
    StepContext::at(iteration, progress, seed)
}

pub fn step(scene: &Scene, context: &StepContext<'_>) -> Outcome {
    step_with(Birth::Split, scene, context)
}

pub fn step_with(birth: Birth, scene: &Scene, context: &StepContext<'_>) -> Outcome {
    let config = MhConfig {
        birth: Some(birth),
        ..MhConfig::paper()
    };
    MetropolisHastings::new(&config)
        .step(context, &scene.state(), &scene.errors())
        .unwrap()
}

/// What the documentation of [`Edit`] promises, as a list of breaches.
pub fn breaches(n: usize, outcome: &Outcome) -> Vec<String> {
    let mut found = Vec::new();
    let mut dst = HashSet::new();
    let changed: HashMap<u32, u32> = outcome.edits.iter().map(|e| (e.dst, e.src)).collect();
    for e in &outcome.edits {
        let values = e
            .position
            .iter()
            .chain(&e.log_scale)
            .chain([&e.opacity_logit]);
        if !values.into_iter().all(|v| v.is_finite()) {
            found.push(format!("not finite: {e:?}"));
        }
        if e.src as usize >= n || e.dst as usize >= outcome.rows {
            found.push(format!("outside: {e:?}"));
        }
        if !dst.insert(e.dst) {
            found.push(format!("written twice: {}", e.dst));
        }
        if changed.get(&e.src).is_some_and(|src| *src != e.src) {
            found.push(format!("source {} is overwritten", e.src));
        }
    }
    if !(n..outcome.rows).all(|row| dst.contains(&(row as u32))) {
        found.push("a gap in the appended rows".into());
    }
    found
}

/// A scene in which every seventh Gaussian is dead, two of them because they are broken.
pub fn dying(n: usize) -> Scene {
    let mut scene = Scene::random(n, 21);
    for i in (0..n).step_by(7) {
        scene.logits[i] = -6.0;
    }
    scene.logits[0] = f32::NAN;
    scene.positions[1][7] = f32::INFINITY;
    scene
}

#[test]
fn edits_obey_their_contract() {
    for (scene, dead) in [(dying(7000), 1000), (Scene::random(7000, 3), 0)] {
        let outcome = step(&scene, &context(700, 0.1, 1));
        assert_eq!(breaches(7000, &outcome), Vec::<String>::new());
        assert_eq!(outcome.stats.relocated, dead);
        let s = outcome.stats;
        assert_eq!(s.proposed, s.coarse[0] + s.fine[0]);
        assert_eq!(s.accepted, s.coarse[1] + s.fine[1]);
        assert_eq!(outcome.rows as u64, 7000 + s.accepted);
        assert!(s.coarse[1] > 0 && s.fine[1] > 0 && s.accepted < s.proposed);
        assert!(s.mean_prior > 0.0 && s.mean_prior < 1.0 && s.occupied_voxels > 0);
    }
}

#[test]
fn a_breach_of_the_contract_is_noticed() {
    let good = step_with(Birth::Copy, &dying(700), &context(700, 0.1, 1));
    let broken = |change: &dyn Fn(&mut Vec<Edit>)| {
        let mut outcome = good.clone();
        change(&mut outcome.edits);
        breaches(700, &outcome)
    };
    assert!(broken(&|_| ()).is_empty());
    assert!(!broken(&|e| e.push(e[0])).is_empty());
    assert!(
        !broken(&|e| {
            e.pop();
        })
        .is_empty()
    );
    assert!(!broken(&|e| e[0].position[0] = f32::NAN).is_empty());
    assert!(!broken(&|e| e[0].src = 700).is_empty());
    let moved = good.edits.iter().find(|e| e.src != e.dst).unwrap().dst;
    assert!(!broken(&|e| e[0].src = moved).is_empty());
}

#[test]
fn sources_of_relocation_follow_opacity() {
    let mut scene = Scene::random(20_000, 4);
    for i in 0..20_000 {
        scene.logits[i] = [-9.0, -2.0, 2.0][i % 3];
    }
    let outcome = step(&scene, &context(700, 0.5, 1));
    let moved = outcome
        .edits
        .iter()
        .filter(|e| e.dst % 3 == 0 && (e.dst as usize) < 20_000);
    let sources: Vec<u32> = moved.map(|e| e.src % 3).collect();
    let share = sources.iter().filter(|s| **s == 2).count() as f64 / sources.len() as f64;
    let (low, high) = (sigmoid(-2.0), sigmoid(2.0));
    assert_eq!(sources.len(), 6667);
    // Five standard errors of a share of 6,667 draws.
    assert!((share - high / (low + high)).abs() < 0.02, "{share}");
}

#[test]
fn with_everything_dead_nothing_happens() {
    let mut scene = Scene::random(50, 1);
    scene.logits.fill(-9.0);
    let outcome = step(&scene, &context(500, 0.0, 0));
    assert!(outcome.edits.is_empty());
    assert_eq!(
        (
            outcome.rows,
            outcome.stats.proposed,
            outcome.stats.relocated
        ),
        (50, 0, 0)
    );
    let empty = step(&Scene::random(0, 1), &context(500, 0.0, 0));
    assert_eq!((empty.edits.len(), empty.rows), (0, 0));
}

#[test]
fn one_survivor_takes_all() {
    let mut scene = Scene::random(300, 1);
    scene.logits.fill(-9.0);
    scene.logits[123] = 3.0;
    let outcome = step(&scene, &context(500, 0.0, 0));
    assert_eq!(breaches(300, &outcome), Vec::<String>::new());
    assert_eq!(outcome.stats.relocated, 299);
    assert!(outcome.edits.iter().all(|e| e.src == 123));
    // One source, which splits once, whatever was drawn.
    assert_eq!((outcome.stats.coarse[0], outcome.stats.fine[0]), (1, 0));
}

/// Once few are alive and they are faint, sharing their opacity among all of the dead would kill them, too, and the next
/// step would find nothing alive: seen on objects before a white background, where fog has to go first.
#[test]
fn the_faint_host_no_more_than_they_can_bear() {
    let mut scene = Scene::random(2000, 8);
    let alive = |i: usize| i.is_multiple_of(20);
    for i in 0..2000 {
        scene.logits[i] = if alive(i) { -3.0 } else { -7.0 };
    }
    let outcome = step_with(Birth::Copy, &scene, &context(700, 0.9, 1));
    let moved = outcome
        .edits
        .iter()
        .filter(|e| (e.dst as usize) < 2000 && e.src != e.dst);
    // 1900 dead on 100 sources of opacity 0.047: three more copies each keep twice 0.005.
    assert_eq!(outcome.stats.relocated, moved.count() as u64);
    assert!((200..=300).contains(&outcome.stats.relocated));
    for e in &outcome.edits {
        assert!(sigmoid(f64::from(e.opacity_logit)) >= 2.0 * 0.005);
    }
    assert_eq!(breaches(2000, &outcome), Vec::<String>::new());
}

#[test]
fn the_upper_bound_holds() {
    let scene = dying(3000);
    for form in [Birth::Copy, Birth::Split] {
        let free = step_with(form, &scene, &context(700, 0.1, 1));
        for limit in [3000 + 10, 3000, 100, free.rows, free.rows + 1] {
            let bounded = StepContext {
                max_gaussians: Some(limit),
                ..context(700, 0.1, 1)
            };
            let outcome = step_with(form, &scene, &bounded);
            assert_eq!(outcome.rows, limit.min(free.rows).max(3000));
            assert_eq!(outcome.stats.accepted as usize, outcome.rows - 3000);
            assert_eq!(breaches(3000, &outcome), Vec::<String>::new());
        }
    }
}

#[test]
fn room_for_some_births_is_drawn_among_all_of_them() {
    let scene = Scene::random(20_000, 21);
    let free = step_with(Birth::Copy, &scene, &context(700, 0.1, 1));
    let coarse = free.stats.coarse[1] as usize;
    let source = |outcome: &Outcome| -> Vec<f64> {
        let births = &outcome.edits[outcome.edits.len() - (outcome.rows - 20_000)..];
        births.iter().map(|e| f64::from(e.src)).collect()
    };
    let all = source(&free)[..coarse].to_vec();
    let bounded = StepContext {
        max_gaussians: Some(20_000 + coarse / 4),
        ..context(700, 0.1, 1)
    };
    let some = source(&step_with(Birth::Copy, &scene, &bounded));
    assert_eq!(some.len(), coarse / 4);
    let mean = |rows: &[f64]| rows.iter().sum::<f64>() / rows.len() as f64;
    // Rows are spread evenly, with a standard deviation of 20,000/√12.
    let deviation = 20_000.0 / (12.0 * some.len() as f64).sqrt();
    assert!(
        (mean(&some) - mean(&all)).abs() < 4.0 * deviation,
        "{} against {}: the first rows come first",
        mean(&some),
        mean(&all)
    );
    assert!(some.iter().all(|row| all.contains(row)));
    // The first ones would fail this.
    assert!((mean(&all[..coarse / 4]) - mean(&all)).abs() > 4.0 * deviation);
}

#[test]
fn same_seed_same_edits_on_any_number_of_threads() {
    let scene = dying(20_000);
    let run = |seed: u64, iteration: u32| step(&scene, &context(iteration, 0.3, seed)).edits;
    let one = on_threads(1, || run(5, 900));
    let two = on_threads(2, || run(5, 900));
    let four = on_threads(4, || run(5, 900));
    assert!(one == two && two == four);
    assert!(run(6, 900) != one, "another seed must differ");
    assert!(run(5, 1000) != one, "another iteration must differ");
}

#[test]
fn crowded_voxels_take_fewer_births() {
    let spread = Scene::random(20_000, 8);
    let mut crowded = spread.clone();
    for plane in &mut crowded.positions {
        plane.iter_mut().for_each(|x| *x *= 1e-3);
    }
    for plane in &mut crowded.log_scales {
        plane.fill(-12.0);
    }
    let [a, b] =
        [&spread, &crowded].map(|scene| step_with(Birth::Copy, scene, &context(700, 0.0, 1)).stats);
    assert!(b.mean_prior < 0.01 && a.mean_prior > 0.1, "{a:?} {b:?}");
    assert!(b.accepted * 10 < a.accepted);
}

#[test]
fn proposals_fade_with_progress() {
    let scene = Scene::random(30_000, 8);
    let stats = |iteration, progress| {
        let at = context(iteration, progress, 1);
        step_with(Birth::Copy, &scene, &at).stats
    };
    let (first, last) = (stats(500, 0.0), stats(15_000, 1.0));
    assert!(
        first.coarse[0] > 3500 && first.coarse[0] <= 4500,
        "{first:?}"
    );
    assert!(first.fine[0] > 9000 && first.fine[0] <= 16_000, "{first:?}");
    assert_eq!((last.coarse[0], last.fine[0]), (1, 1));
}

#[test]
fn fewer_views_are_wanted_as_the_run_goes_on() {
    let mh = MetropolisHastings::new(&MhConfig::paper());
    let wanted = [0.0, 0.5, 0.6, 1.0].map(|eta| mh.wanted(10, eta));
    assert_eq!(
        wanted,
        [10, 5, 4, 1].map(|views| StatisticsKind::Errors { views })
    );
    assert_eq!(mh.wanted(0, 0.5), StatisticsKind::Errors { views: 0 });
}

#[test]
fn bad_input_is_an_error_that_names_it() {
    let scene = Scene::random(10, 1);
    let mh = MetropolisHastings::new(&MhConfig::paper());
    let short = Statistics::Errors(ErrorStatistics {
        l1: &scene.l1[..9],
        ..scene.cues()
    });
    let said = mh
        .step(&context(1, 0.0, 0), &scene.state(), &short)
        .unwrap_err()
        .to_string();
    assert!(said.contains("9 values; 10 expected"), "{said}");
    assert!(
        mh.step(&context(1, f64::NAN, 0), &scene.state(), &scene.errors())
            .is_err()
    );
    let bad = MhConfig {
        voxel_edge: [0.0, 0.0],
        ..MhConfig::paper()
    };
    let said = MetropolisHastings::new(&bad)
        .step(&context(1, 0.0, 0), &scene.state(), &scene.errors())
        .unwrap_err()
        .to_string();
    assert!(said.contains("voxel-edge"), "{said}");
}

#[test]
fn a_fixed_set_stays() {
    let scene = dying(100);
    let outcome = Fixed
        .step(&context(1, 0.0, 0), &scene.state(), &scene.errors())
        .unwrap();
    assert!(outcome.edits.is_empty() && outcome.rows == 100);
    assert_eq!(Fixed.wanted(9, 0.0), StatisticsKind::Nothing);
}

#[test]
fn a_configuration_names_its_strategy() {
    let of = |sampler| {
        let config = TrainConfig {
            sampler,
            ..TrainConfig::default()
        };
        let made = make(&config);
        (made.wanted(4, 0.0), made.noise().is_some())
    };
    assert_eq!(of(Sampler::Mh), (StatisticsKind::Nothing, true));
    let paper = TrainConfig {
        mh: MhConfig::paper(),
        ..TrainConfig::default()
    };
    assert!(make(&paper).noise().is_none());
    assert_eq!(
        make(&paper).wanted(4, 0.0),
        StatisticsKind::Errors { views: 4 }
    );
    assert_eq!(of(Sampler::Mcmc), (StatisticsKind::Nothing, true));
    assert_eq!(of(Sampler::Adc), (StatisticsKind::ScreenGradient, false));
    assert_eq!(of(Sampler::None), (StatisticsKind::Nothing, false));
    // Statistics of another kind is refused, not guessed at.
    let scene = dying(10);
    for sampler in [Sampler::Mh, Sampler::Mcmc, Sampler::Adc] {
        let config = TrainConfig {
            sampler,
            ..TrainConfig::default()
        };
        let evidence = match sampler {
            Sampler::Mh => Statistics::Nothing,
            _ => scene.errors(),
        };
        let result = make(&config).step(&context(600, 0.5, 0), &scene.state(), &evidence);
        assert!(result.unwrap_err().to_string().contains("another kind"));
    }
}

#[test]
fn statistics_add_up() {
    let scene = dying(2000);
    let first = step(&scene, &context(500, 0.0, 1)).stats;
    let second = step(&scene, &context(600, 0.5, 1)).stats;
    let mut sum = DensityStats::default();
    sum.add(&first);
    sum.add(&second);
    assert_eq!(sum.proposed, first.proposed + second.proposed);
    assert_eq!(sum.accepted, first.accepted + second.accepted);
    assert_eq!(sum.relocated, first.relocated + second.relocated);
    assert_eq!(
        sum.coarse,
        [0, 1].map(|k| first.coarse[k] + second.coarse[k])
    );
    assert_eq!(sum.fine, [0, 1].map(|k| first.fine[k] + second.fine[k]));
    assert_eq!(sum.occupied_voxels, second.occupied_voxels);
    assert_eq!(sum.mean_prior, second.mean_prior);
}

/// Importance by the rows after the edits: relocated Gaussians and births have that of where they come from.
#[test]
fn importance_goes_with_what_is_written() {
    let scene = dying(700);
    let outcome = step(&scene, &context(700, 0.1, 1));
    let importance = &outcome.importance;
    assert_eq!(importance.len(), outcome.rows);
    assert!(!outcome.births.is_empty() && outcome.stats.relocated > 50);
    for birth in &outcome.births {
        assert_eq!(importance[birth.dst as usize], birth.importance);
    }
    let written = outcome.edits.iter().filter(|e| e.src != e.dst);
    for edit in written.clone() {
        let [to, from] = [edit.dst, edit.src].map(|row| importance[row as usize]);
        assert_eq!(to, from, "{edit:?}");
    }
    // Not all alike, so that another row's would be seen.
    let first = importance[written.clone().next().unwrap().src as usize];
    assert!(
        written
            .into_iter()
            .any(|e| importance[e.src as usize] != first)
    );
}
