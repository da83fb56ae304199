//! The switches of Metropolis–Hastings density control, one by one.

use std::collections::HashMap;

use super::step::{breaches, context, dying};
use super::{Scene, on_threads};
use mhsplat::config::{Acceptance, Birth, MhConfig, ViewSubset};
use mhsplat::density::mh::MetropolisHastings;
use mhsplat::density::{
    BirthKind, DensityControl, Expected, Outcome, Statistics, StatisticsKind, StepContext,
};

const N: usize = 20_000;

fn with(config: &MhConfig, scene: &Scene) -> Outcome {
    at(config, scene, &context(700, 0.1, 1))
}

fn at(config: &MhConfig, scene: &Scene, context: &StepContext<'_>) -> Outcome {
    let outcome = MetropolisHastings::new(config)
        .step(context, &scene.state(), &scene.errors())
        .unwrap();
    assert_eq!(breaches(scene.logits.len(), &outcome), Vec::<String>::new());
    outcome
}

/// Accepted over proposed.
fn rate(outcome: &Outcome) -> f64 {
    outcome.stats.accepted as f64 / outcome.stats.proposed as f64
}

/// With turnover a step of sixty has a quarter of the proposals of one of fifteen, whatever step came before; without it a step has all.
#[test]
fn more_steps_propose_fewer_at_each() {
    let scene = Scene::random(N, 8);
    // Draws about Gaussians, and births that are expected among so many that hardly any is drawn twice.
    let proposed = |turnover: f64, spacing: f64, before: Option<f64>| {
        let config = MhConfig {
            turnover,
            fine_proposals: 3000,
            births_from_iteration: Some(0),
            ..MhConfig::default()
        };
        let context = StepContext {
            before,
            spacing,
            ..context(700, 0.5, 1)
        };
        let set = Expected {
            gaussians: 1e7,
            born: 0.0,
        };
        let expected = MetropolisHastings::new(&config).expected(&context, set);
        let drawn = at(&config, &scene, &context).stats.fine[0] as f64;
        [drawn, expected.unwrap().born]
    };
    let fifteen = proposed(1.6, 1.0 / 15.0, Some(0.45));
    let near = |turnover: f64, spacing: f64, before: Option<f64>, wanted: f64| {
        let found = proposed(turnover, spacing, before);
        for (found, all) in found.into_iter().zip(fifteen) {
            // Draws that repeat are fewer among fewer.
            let ratio = found / all;
            assert!((ratio / wanted - 1.0).abs() < 0.05, "{spacing}: {ratio}");
        }
    };
    near(1.6, 1.0 / 60.0, Some(0.48), 0.25);
    near(1.6, 1.0 / 60.0, None, 0.25);
    // Where another length has just been planned the step before may lie ahead.
    near(1.6, 1.0 / 60.0, Some(0.55), 0.25);
    near(1.6, 0.3, Some(0.2), 1.0);
    near(0.0, 1.0 / 60.0, Some(0.48), 1.0);
}

#[test]
fn without_the_prior_voxels_do_not_matter() {
    let mut scene = Scene::random(N, 8);
    for plane in &mut scene.positions {
        plane.iter_mut().for_each(|x| *x *= 1e-3);
    }
    for plane in &mut scene.log_scales {
        plane.fill(-12.0);
    }
    let on = with(&MhConfig::paper(), &scene);
    for acceptance in [Acceptance::Eq20, Acceptance::ExactPrior] {
        let off = MhConfig {
            lambda_voxel: 0.0,
            acceptance,
            ..MhConfig::paper()
        };
        let off = with(&off, &scene);
        assert_eq!(off.stats.mean_prior, 1.0);
        assert!(rate(&off) > 0.5 && rate(&on) < 0.2);
    }
}

#[test]
fn the_exact_form_accepts_by_counts_alone() {
    let exact = MhConfig {
        acceptance: Acceptance::ExactPrior,
        ..MhConfig::paper()
    };
    let mut scene = Scene::random(N, 8);
    // Far apart: every voxel that a birth may reach is empty.
    for plane in &mut scene.positions {
        plane.iter_mut().for_each(|x| *x *= 1e5);
    }
    let outcome = with(&exact, &scene);
    let fine = outcome.stats.fine;
    // Fine births stay in the voxel of their source or next to it: (1/2)^5 or (2/3)^5.
    let share = fine[1] as f64 / fine[0] as f64;
    assert!(share > 0.03 && share < 0.14, "{share}");
}

#[test]
fn without_importance_sources_are_uniform_and_nothing_is_watched() {
    let off = MhConfig {
        importance: false,
        ..MhConfig::paper()
    };
    let mh = MetropolisHastings::new(&off);
    assert_eq!(mh.wanted(10, 0.0), StatisticsKind::Nothing);
    let mut scene = Scene::random(N, 4);
    for (i, l) in scene.logits.iter_mut().enumerate() {
        *l = [-3.0, 3.0][i % 2];
    }
    let share = |config: &MhConfig, evidence: &Statistics<'_>| {
        let outcome = MetropolisHastings::new(config)
            .step(&context(700, 0.5, 1), &scene.state(), evidence)
            .unwrap();
        let sources: Vec<u32> = outcome
            .edits
            .iter()
            .filter(|e| e.dst as usize >= N)
            .map(|e| e.src % 2)
            .collect();
        sources.iter().sum::<u32>() as f64 / sources.len() as f64
    };
    // Some thousand births: five standard errors are 0.05.
    let uniform = share(&off, &Statistics::Nothing);
    assert!((uniform - 0.5).abs() < 0.05, "{uniform}");
    assert!(share(&MhConfig::paper(), &scene.errors()) > 0.55);
    // The opacity alone needs no error maps; with an error's weight they are not to be missing.
    let opacity = MhConfig {
        weight_ssim: 0.0,
        weight_l1: 0.0,
        ..MhConfig::paper()
    };
    assert!(share(&opacity, &Statistics::Nothing) > 0.55);
    assert!(
        MetropolisHastings::new(&MhConfig::paper())
            .step(&context(700, 0.5, 1), &scene.state(), &Statistics::Nothing)
            .is_err()
    );
}

#[test]
fn without_relocation_the_dead_go() {
    let off = MhConfig {
        relocation: false,
        ..MhConfig::paper()
    };
    let scene = dying(7000);
    let outcome = with(&off, &scene);
    assert_eq!((outcome.stats.relocated, outcome.stats.pruned), (0, 1000));
    assert!(outcome.stats.accepted > 100);
    for e in &outcome.edits {
        assert!(!e.src.is_multiple_of(7), "a dead row gave birth");
        assert!(e.dst as usize >= 7000 || e.src == e.dst);
    }
    assert!(with(&MhConfig::paper(), &scene).stats.relocated > 0);
}

#[test]
fn phases_can_be_left_out() {
    let scene = Scene::random(N, 8);
    let of = |coarse_proposals: u32, fine_proposals: u32| {
        let config = MhConfig {
            coarse_proposals,
            fine_proposals,
            ..MhConfig::paper()
        };
        let s = with(&config, &scene).stats;
        [s.coarse[0] > 0, s.fine[0] > 0]
    };
    assert_eq!(of(100, 0), [true, false]);
    assert_eq!(of(0, 100), [false, true]);
    assert_eq!(of(0, 0), [false, false]);
}

#[test]
fn the_view_subset_is_the_one_asked_for() {
    let wanted = |view_subset: ViewSubset, eta: f64| {
        let config = MhConfig {
            view_subset,
            ..MhConfig::paper()
        };
        match MetropolisHastings::new(&config).wanted(10, eta) {
            StatisticsKind::Errors { views } => views,
            _ => 0,
        }
    };
    for (eta, shrinking) in [(0.0, 10), (0.5, 5), (1.0, 1)] {
        assert_eq!(wanted(ViewSubset::Shrinking, eta), shrinking);
        assert_eq!(wanted(ViewSubset::All, eta), 10);
        assert_eq!(wanted(ViewSubset::Fixed(4), eta), 4);
        assert_eq!(wanted(ViewSubset::Fixed(40), eta), 10);
    }
    let read = |text: &str| toml::from_str::<MhConfig>(&format!("view-subset = {text}"));
    for (text, subset) in [
        ("\"shrinking\"", ViewSubset::Shrinking),
        ("\"all\"", ViewSubset::All),
        ("7", ViewSubset::Fixed(7)),
    ] {
        let config = read(text).unwrap();
        assert_eq!(config.view_subset, subset);
        let again: MhConfig = toml::from_str(&toml::to_string(&config).unwrap()).unwrap();
        assert_eq!(again, config);
    }
    for bad in ["0", "-1", "\"some\"", "1.5"] {
        assert!(read(bad).is_err(), "{bad}");
    }
}

#[test]
fn the_target_rate_is_kept_and_temperature_raises_it() {
    let scene = Scene::random(N, 8);
    for (target, wanted) in [([0.2, 0.2], 0.2), ([0.8, 0.3], 0.55)] {
        let config = MhConfig {
            target_acceptance: target,
            ..MhConfig::paper()
        };
        let outcome = at(&config, &scene, &context(700, 0.5, 1));
        // Some thousand proposals: five standard errors.
        assert!((rate(&outcome) - wanted).abs() < 0.03, "{}", rate(&outcome));
    }
    let cold = with(&MhConfig::paper(), &scene);
    let warm = MhConfig {
        temperature: [3.0, 1.0],
        ..MhConfig::paper()
    };
    assert!(rate(&with(&warm, &scene)) > 1.3 * rate(&cold));
}

#[test]
fn voxels_far_from_the_cameras_take_fewer() {
    let scene = Scene::random(N, 8);
    let cameras = [[100.0, 0.0, 0.0], [0.0, 40.0, 0.0]];
    let far = StepContext {
        cameras: &cameras,
        ..context(700, 0.1, 1)
    };
    let growing = MhConfig {
        voxel_growth_from: 5.0,
        ..MhConfig::paper()
    };
    let plain = with(&MhConfig::paper(), &scene).stats;
    let grown = at(&growing, &scene, &far).stats;
    // 40 of 5 units: edges are eight times as long.
    assert!(grown.occupied_voxels * 4 < plain.occupied_voxels);
    assert!(grown.mean_prior < plain.mean_prior);
    let near = at(&growing, &scene, &context(700, 0.1, 1)).stats;
    assert_eq!(near, plain, "no camera, no growth");
    let run = || at(&growing, &scene, &far).edits;
    assert!(on_threads(1, run) == on_threads(3, run));
}

#[test]
fn values_out_of_their_domain_are_refused_by_name() {
    type Change = fn(&mut MhConfig);
    let cases: [(&str, Change); 11] = [
        ("temperature", |c| c.temperature = [0.0, 1.0]),
        ("target-acceptance", |c| c.target_acceptance = [0.5, 0.0]),
        ("target-acceptance", |c| c.target_acceptance = [0.5, 1.0]),
        ("voxel-growth-from", |c| c.voxel_growth_from = f64::NAN),
        ("pixel-views", |c| c.pixel_views = 0),
        // No other view could confirm a surface.
        ("pixel-views", |c| c.pixel_views = 1),
        ("pixel-far", |c| c.pixel_far = [3.0, 2.0]),
        ("pixel-surface", |c| c.pixel_surface = 1.1),
        ("pixel-tolerance", |c| c.pixel_tolerance = 1.0),
        ("pixel-opacity", |c| c.pixel_opacity = 1.0),
        ("lambda-voxel", |c| c.lambda_voxel = -1.0),
    ];
    for (name, change) in cases {
        let mut config = MhConfig {
            pixel_proposals: 1,
            ..MhConfig::paper()
        };
        change(&mut config);
        let said = config.validate().unwrap_err().to_string();
        assert!(said.contains(name), "{said}");
    }
}

#[test]
fn before_births_begin_a_step_relocates_and_no_more() {
    let config = MhConfig {
        from_iteration: 500,
        births_from_iteration: Some(1500),
        until_iteration: 2500,
        pixel_proposals: 100,
        ..MhConfig::paper()
    };
    let mh = MetropolisHastings::new(&config);
    for (progress, bears) in [(0.0, false), (0.49, false), (0.5, true), (1.0, true)] {
        assert_eq!(config.births_enabled(progress), bears);
        assert_eq!(mh.wanted(8, progress) != StatisticsKind::Nothing, bears);
        assert_eq!(mh.pictures(progress) > 0, bears);
    }
    // Whatever the first iteration, births begin with the step there and not the one after.
    for first in (500..=20_000).step_by(100) {
        let config = MhConfig {
            births_from_iteration: Some(first),
            ..MhConfig::default()
        };
        let eta = |done: u32| f64::from(done - 500) / 19_500.0;
        assert!(config.births_enabled(eta(first)), "{first}");
        assert!(
            first == 500 || !config.births_enabled(eta(first - 100)),
            "{first}"
        );
    }
    let scene = dying(7000);
    let step = |evidence: &Statistics<'_>, progress: f64| {
        let mh = MetropolisHastings::new(&config);
        mh.step(&context(700, progress, 1), &scene.state(), evidence)
    };
    let early = step(&Statistics::Nothing, 0.2).unwrap();
    assert_eq!((early.rows, early.stats.proposed), (7000, 0));
    assert!(early.stats.relocated > 0);
    assert!(step(&Statistics::Nothing, 0.6).is_err());
    let late = step(&scene.errors(), 0.6).unwrap();
    assert!(late.rows > 7000 && late.stats.relocated == early.stats.relocated);
}

#[test]
fn the_readme_has_the_papers_numbers() {
    let readme = include_str!("../../docs/method.md");
    let (_, after) = readme
        .split_once("The paper's own numbers, as a file")
        .unwrap();
    let lines = after.lines().skip(2);
    let file: Vec<&str> = lines.map_while(|l| l.strip_prefix("    ")).collect();
    let config: mhsplat::TrainConfig = toml::from_str(&file.join("\n")).unwrap();
    assert_eq!(config.mh, MhConfig::paper());
    assert_ne!(config.mh, MhConfig::default());
    config.validate().unwrap();
}

/// The place of a birth depends on the seed, not on its source alone.
#[test]
fn offsets_follow_the_seed() {
    let scene = Scene::random(60, 5);
    let births = |seed: u64, coarse_proposals: u32, fine_proposals: u32| {
        let config = MhConfig {
            coarse_proposals,
            fine_proposals,
            target_acceptance: [0.9, 0.9],
            ..MhConfig::paper()
        };
        let outcome = at(&config, &scene, &context(700, 0.1, seed));
        let born = outcome.edits.into_iter().filter(|e| e.dst >= 60);
        born.map(|e| (e.src, e.position)).collect::<Vec<_>>()
    };
    for (coarse, fine) in [(500, 0), (0, 500)] {
        let [first, second] = [1, 2].map(|seed| births(seed, coarse, fine));
        let same = |(src, position): &&(u32, [f32; 3])| {
            second.iter().any(|(s, p)| s == src && p == position)
        };
        let common = first.iter().filter(|a| second.iter().any(|b| a.0 == b.0));
        assert!(common.count() > 20);
        assert_eq!(first.iter().filter(same).count(), 0);
    }
}

/// Births of one phase are in the voxel counts of the next.
#[test]
fn births_are_counted_before_the_next_phase() {
    let n = 60;
    let scene = Scene::random(n, 5);
    let config = MhConfig {
        coarse_proposals: 200,
        fine_proposals: 200,
        // All in one voxel, but for chance births beyond.
        voxel_edge: [1e6, 1e6],
        lambda_voxel: 1.0,
        target_acceptance: [0.5, 0.5],
        ..MhConfig::paper()
    };
    let mut inside = scene.clone();
    inside
        .positions
        .iter_mut()
        .for_each(|p| p.iter_mut().for_each(|v| *v = v.abs() + 1e3));
    let outcome = at(&config, &inside, &context(700, 0.1, 1));
    let stats = outcome.stats;
    let prior = |count: f64| 1.0 / (1.0 + count);
    let [proposed, born] = stats.coarse.map(|v| v as f64);
    let fine = stats.fine[0] as f64;
    assert!(born > 5.0);
    let expected = (proposed * prior(n as f64) + fine * prior(n as f64 + born)) / (proposed + fine);
    assert!(
        (stats.mean_prior - expected).abs() < 1e-9,
        "{} of {expected}",
        stats.mean_prior
    );
}

/// Faint births are spread about their sources as those are themselves, at the start and at the end; the paper's are spread farther, at the end
/// half as far as at the start.
#[test]
fn births_are_spread_as_their_sources_are() {
    let scene = Scene::random(N, 8);
    // Mean of |x|² over that of a draw from the source.
    let squared_spread = |config: &MhConfig, progress: f64, kind: BirthKind| {
        let config = MhConfig {
            relocation: false,
            births_from_iteration: Some(500),
            // What is proposed is born: refusals by voxel would favour the far ones.
            lambda_voxel: 0.0,
            target_acceptance: [0.0, 0.0],
            temperature: [1e9, 1e9],
            ..*config
        };
        let outcome = at(&config, &scene, &context(700, progress, 3));
        let places: HashMap<u32, [f32; 3]> =
            outcome.edits.iter().map(|e| (e.dst, e.position)).collect();
        let born = outcome.births.iter().filter(|birth| birth.kind == kind);
        let ratios: Vec<f64> = born
            .map(|birth| {
                let row = birth.source.unwrap() as usize;
                let sum = |square: &dyn Fn(usize) -> f64| -> f64 { (0..3).map(square).sum() };
                let place = places[&birth.dst];
                let moved = |k: usize| f64::from(place[k] - scene.positions[k][row]).powi(2);
                let drawn = |k: usize| (2.0 * f64::from(scene.log_scales[k][row])).exp();
                sum(&moved) / sum(&drawn)
            })
            .collect();
        assert!(ratios.len() > 500, "{kind:?}: {}", ratios.len());
        ratios.iter().sum::<f64>() / ratios.len() as f64
    };
    let faint = MhConfig {
        birth: Some(Birth::Faint),
        coarse_proposals: 22_500,
        ..MhConfig::default()
    };
    for (config, progress, coarse, fine) in [
        (faint, 0.0, 1.0, 1.0),
        (faint, 0.5, 1.0, 1.0),
        (MhConfig::paper(), 0.0, 100.0, 4.0),
        (MhConfig::paper(), 0.5, 56.25, 2.25),
    ] {
        for (kind, expected) in [(BirthKind::Coarse, coarse), (BirthKind::Fine, fine)] {
            let found = squared_spread(&config, progress, kind) / expected;
            assert!(
                (0.8..1.25).contains(&found),
                "{kind:?}, {progress}: {found}"
            );
        }
    }
}
