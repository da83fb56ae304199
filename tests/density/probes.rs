//! Births judged by computed changes of the loss.

use std::collections::HashSet;

use super::step::{breaches, context};
use super::{Scene, on_threads};
use mhsplat::config::{Acceptance, Birth, MhConfig, Surrogate};
use mhsplat::density::mh::MetropolisHastings;
use mhsplat::density::mh::accept::{ln_gains, ln_ratio};
use mhsplat::density::{DensityControl, Edit, Outcome};

const N: usize = 5000;

fn config() -> MhConfig {
    MhConfig {
        surrogate: Surrogate::Probe,
        lambda_voxel: 0.0,
        ..MhConfig::paper()
    }
}

/// The births that a step has probed, and its outcome if the probe returns `changes` of them.
fn probed(
    config: &MhConfig,
    scene: &Scene,
    changes: &dyn Fn(usize) -> Vec<f64>,
) -> (Vec<Edit>, mhsplat::Result<Outcome>) {
    let mut tried = Vec::new();
    let outcome = MetropolisHastings::new(config).step_estimated(
        &context(700, 0.1, 1),
        &scene.state(),
        &scene.errors(),
        &mut |candidates| {
            tried.extend_from_slice(candidates);
            Ok(changes(candidates.len()))
        },
    );
    (tried, outcome)
}

#[test]
fn gains_by_hand() {
    // Mean |ΔL| of the four that are known: 1.5; the fifth gets the mean of their gains.
    let got = ln_gains(&[-2.0, 1.0, f64::NAN, 3.0, 0.0]);
    let gain = |z: f64| -(-z).exp().ln_1p();
    let known = [4.0 / 3.0, -2.0 / 3.0, -2.0, 0.0].map(gain);
    let mean = known.iter().sum::<f64>() / 4.0;
    let want = [known[0], known[1], mean, known[2], known[3]];
    let gap = |(a, b): (&f64, &f64)| (a - b).abs();
    assert!(got.iter().zip(&want).map(gap).all(|g| g < 1e-14), "{got:?}");
    let even = -std::f64::consts::LN_2;
    assert_eq!(ln_gains(&[0.0, f64::NAN, 0.0]), [even; 3]);
    assert_eq!(ln_gains(&[f64::NAN]), [even]);
    assert_eq!(ln_gains(&[]), [0.0; 0]);
    // Any size of the loss is the same.
    assert_eq!(ln_gains(&[-2e-9, 1e-9]), ln_gains(&[-2.0, 1.0]));
    let ln_rho = ln_ratio(Acceptance::Eq20, -2.0, 5.0, 3);
    assert!((ln_rho - (-2.0 - 16f64.ln())).abs() < 1e-15);
    assert_eq!(
        ln_ratio(Acceptance::ExactPrior, -2.0, 5.0, 3),
        ln_ratio(Acceptance::ExactPrior, 0.0, 5.0, 3)
    );
}

#[test]
fn what_a_probe_foretells_decides() {
    let scene = Scene::random(N, 8);
    let config = config();
    // Every other one spoils the loss, by as much as the others lower it: ρ is σ(−1) and σ(1) without a voxel prior.
    let spoils = |k: usize| k.is_multiple_of(2);
    let change = |k: usize| if spoils(k) { 1e-7 } else { -1e-7 };
    let step = || probed(&config, &scene, &|n| (0..n).map(change).collect());
    let (tried, outcome) = step();
    let outcome = outcome.unwrap();
    assert_eq!(breaches(N, &outcome), Vec::<String>::new());
    let births = outcome.edits.iter().filter(|e| e.dst as usize >= N);
    let born: HashSet<[u32; 3]> = births.map(|e| e.position.map(f32::to_bits)).collect();
    for (bad, rho) in [(true, 0.2689), (false, 0.7311)] {
        let all = (0..tried.len()).filter(|k| spoils(*k) == bad);
        let all: Vec<[f32; 3]> = all.map(|k| tried[k].position).collect();
        let in_it = |p: &&[f32; 3]| born.contains(&p.map(f32::to_bits));
        let rate = all.iter().filter(in_it).count() as f64 / all.len() as f64;
        // Some thousand proposals: five standard errors.
        assert!((rate - rho).abs() < 0.04, "{rate}");
    }
    let run = || step().1.unwrap().edits;
    assert!(on_threads(1, run) == on_threads(3, run));
    // A wanted rate is kept here, too.
    let wanted = MhConfig {
        target_acceptance: [0.3, 0.3],
        ..config
    };
    let mixed = |n| (0..n).map(|k| (k % 7) as f64).collect();
    let s = probed(&wanted, &scene, &mixed).1.unwrap().stats;
    let rate = s.accepted as f64 / s.proposed as f64;
    assert!((rate - 0.3).abs() < 0.03, "{rate}");
}

#[test]
fn a_birth_is_tried_in_the_shape_it_would_have() {
    let scene = Scene::random(N, 8);
    let [copied, faint] = [Birth::Copy, Birth::Faint].map(|birth| {
        let config = MhConfig {
            birth: Some(birth),
            ..config()
        };
        probed(&config, &scene, &|n| vec![0.0; n]).0
    });
    assert!(copied.len() == faint.len() && !copied.is_empty());
    let most = (0.1f64 / 0.9).ln() as f32;
    for (copy, faint) in copied.iter().zip(&faint) {
        assert_eq!(copy.opacity_logit, scene.logits[copy.src as usize]);
        let expected = Edit {
            log_scale: copy.log_scale.map(|v| v + 0.6f64.ln() as f32),
            opacity_logit: copy.opacity_logit.min(most),
            ..*copy
        };
        assert_eq!(*faint, expected);
    }
}

/// A split moves its source, and so has no first-order estimate.
#[test]
fn split_births_are_not_judged_by_probes() {
    let scene = Scene::random(N, 8);
    let splits = MhConfig {
        birth: Some(Birth::Split),
        ..config()
    };
    let error = probed(&splits, &scene, &|_| Vec::new()).1.unwrap_err();
    assert!(error.to_string().contains("mh.birth"), "{error}");
    let unasked = MhConfig {
        acceptance: Acceptance::ExactPrior,
        ..splits
    };
    assert!(probed(&unasked, &scene, &|_| Vec::new()).1.is_ok());
    // Unless one is chosen, the form goes by it.
    let chosen = |config: MhConfig| {
        MhConfig {
            birth: None,
            ..config
        }
        .form()
    };
    assert_eq!(
        [MhConfig::default(), config(), unasked].map(chosen),
        [Birth::Split, Birth::Faint, Birth::Split]
    );
}

#[test]
fn nothing_is_tried_where_nothing_is_judged_by_it() {
    let scene = Scene::random(N, 8);
    let exact = MhConfig {
        acceptance: Acceptance::ExactPrior,
        ..config()
    };
    for config in [MhConfig::default(), exact] {
        assert_eq!(MetropolisHastings::new(&config).estimate_views(), 0);
        let (tried, outcome) = probed(&config, &scene, &|_| Vec::new());
        assert!(tried.is_empty() && outcome.is_ok());
    }
    let (_, outcome) = probed(&config(), &scene, &|_| vec![0.0]);
    let said = outcome.unwrap_err().to_string();
    assert!(said.contains("1 changes of the loss"), "{said}");
}

#[test]
fn settings_that_make_no_sense_are_refused() {
    let refused = |change: &dyn Fn(&mut MhConfig), name: &str| {
        let mut config = config();
        change(&mut config);
        let said = config.validate().unwrap_err().to_string();
        assert!(said.contains(name), "{said}");
        // Without probes it does not matter, or is fine.
        config.surrogate = Surrogate::Importance;
        assert!(config.validate().is_ok());
    };
    refused(&|c| c.probe_views = 0, "mh.probe-views");
    refused(&|c| c.acceptance = Acceptance::Alg1, "mh.surrogate");
    refused(&|c| c.acceptance = Acceptance::Centred, "mh.surrogate");
    let read = |text: &str| toml::from_str::<MhConfig>(&format!("surrogate = {text}"));
    assert_eq!(read("\"probe\"").unwrap().surrogate, Surrogate::Probe);
    assert!(read("\"guess\"").is_err() && read("1").is_err());
}
