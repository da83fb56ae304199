//! Density control at its extremes against closed forms and brute force.

use std::collections::HashMap;

use mhsplat::base::math::{logit, sigmoid};
use mhsplat::base::rng::{Philox, Stream};
use mhsplat::config::{Acceptance, MhConfig};
use mhsplat::density::draw::Categorical;
use mhsplat::density::mh::MetropolisHastings;
use mhsplat::density::mh::accept::{accepts, exact_ln_prior_ratio, ln_acceptance};
use mhsplat::density::mh::importance::importance;
use mhsplat::density::mh::sparsity::VoxelCounts;
use mhsplat::density::relocation::{ln_coefficient, split};
use mhsplat::density::{DensityControl, ErrorStatistics, SceneState, Statistics, StepContext};

/// Bound on errors that are rounding alone.
const EXACT: f64 = 1e-10;
/// Bound on sums over ten million weights in f64 and on a quadrature of 40 nodes.
const SUMMED: f64 = 1e-9;

/// Draws over ten million weights: the item at u against the exact distribution.
#[test]
fn draws_over_ten_million_weights() {
    const N: usize = 10_000_000;
    let probe = |k: usize| (k as f64 + 0.5) / 1000.0;
    for weight in [1.0, 1e-38, 0.0] {
        let drawn = Categorical::new(vec![weight; N]);
        for k in 0..1000 {
            let i = drawn.draw(probe(k)).unwrap();
            // The item's own width is no error.
            let error = ((i as f64 + 0.5) / N as f64 - probe(k)).abs() - 0.5 / N as f64;
            assert!(error <= SUMMED, "weight {weight:e}, {k}: {error:e}");
        }
    }
    let mut hot = vec![0.0; N];
    hot[N - 7] = 1e-38;
    let hot = Categorical::new(hot);
    assert!((0..1000).all(|k| hot.draw(probe(k)) == Some(N - 7)));
    // Weights 1/(i + 1): the sum up to an item is ln(i) + γ + 1/(2i) − 1/(12i²) for large i.
    let harmonic: Vec<f64> = (0..N).map(|i| 1.0 / (i as f64 + 1.0)).collect();
    let harmonic = Categorical::new(harmonic);
    let sum = |i: f64| i.ln() + 0.577_215_664_901_532_9 + 0.5 / i - 1.0 / (12.0 * i * i);
    for k in 0..1000 {
        let i = harmonic.draw(probe(k)).unwrap();
        if i > 1000 {
            let [below, above] = [i as f64, i as f64 + 1.0].map(|i| sum(i) / sum(N as f64));
            let error = (below - probe(k)).max(probe(k) - above);
            assert!(error <= SUMMED, "{k}: {error:e}");
        }
    }
}

/// Importance from cues that are equal, alone or of any size: between 0 and 1, and ½ if all are equal.
#[test]
fn importance_of_extreme_cues() {
    const N: usize = 1000;
    let of = |cue: &dyn Fn(usize) -> f32| {
        let values: Vec<f32> = (0..N).map(cue).collect();
        let cues = ErrorStatistics {
            ssim: &values,
            l1: &values,
            views: &[1; N],
        };
        importance(&[0.5; N], &cues, [0.8, 0.5, 0.5])
    };
    for value in [0.25, 0.0, 1e-38, f32::MAX] {
        let all = of(&|_| value);
        assert!(all.iter().all(|i| (i - 0.5).abs() <= EXACT), "{value:e}");
    }
    let hot = |height: f32| of(&|i| if i == 7 { height } else { 0.0 });
    let broken = of(&|i| if i % 2 == 0 { f32::NAN } else { 1.0 });
    let first = hot(1.0);
    for values in [&first, &hot(f32::MAX), &broken] {
        assert!(values.iter().all(|i| (0.0..=1.0).contains(i)));
    }
    let mut others = first.iter().enumerate().filter(|(i, _)| *i != 7);
    assert!(others.all(|(_, v)| *v < first[7]));
}

/// Counts of voxels with indices beyond 32 bits, which merge, against brute force.
#[test]
fn voxel_indices_beyond_32_bits() {
    let spread = [
        0.0f32,
        0.3,
        -0.3,
        1e3,
        -1e3,
        1e12,
        -1e12,
        1e30,
        -1e30,
        f32::MAX,
        f32::NAN,
    ];
    let positions: Vec<[f32; 3]> = spread
        .iter()
        .flat_map(|x| spread.map(|y| [*x, y, *x]))
        .collect();
    let plane = |k: usize| positions.iter().map(|p| p[k]).collect::<Vec<f32>>();
    let planes = [plane(0), plane(1), plane(2)];
    let edge = 0.005;
    let counts = VoxelCounts::count([&planes[0], &planes[1], &planes[2]], edge);
    let key = |p: &[f32; 3]| p.map(|v| (f64::from(v) / edge).floor() as i32);
    let finite = |p: &[f32; 3]| p.iter().all(|v| v.is_finite());
    let mut wanted: HashMap<[i32; 3], u32> = HashMap::new();
    for p in positions.iter().filter(|p| finite(p)) {
        *wanted.entry(key(p)).or_default() += 1;
    }
    for p in &positions {
        let want = if finite(p) { wanted[&key(p)] } else { 0 };
        assert_eq!(counts.get(p.map(f64::from)), want, "{p:?}");
    }
    assert_eq!(counts.occupied(), wanted.len());
}

/// Opacity of N copies, which stays the same, and F against an independent quadrature.
#[test]
fn relocation_to_many_copies() {
    for copies in [1, 2, 15, 51, 100, 1000, 10_000] {
        for o in [1e-6, 0.005, 0.1, 0.5, 0.99, 1.0 - 1e-9] {
            let own = sigmoid(split(logit(o), copies).opacity_logit);
            let kept = -(f64::from(copies) * (-own).ln_1p()).exp_m1();
            let opacity = (kept - o).abs() / o;
            let f = ln_coefficient(own, copies).exp() / coefficient(own, copies);
            let worst = opacity.max((f - 1.0).abs());
            assert!(worst <= SUMMED, "{copies} copies of {o}: {worst:e}");
        }
    }
}

/// F = (2/√π) ∫ 1 − (1 − o·e^{−t²})^N dt by the trapezoidal rule in steps of 10⁻³.
fn coefficient(opacity: f64, copies: u32) -> f64 {
    let step = 1e-3;
    let value = |k: i32| {
        let t = f64::from(k) * step;
        let z = opacity * (-t * t).exp();
        -(f64::from(copies) * (-z).ln_1p()).exp_m1()
    };
    let inner: f64 = (1..9000).map(value).sum();
    std::f64::consts::FRAC_2_SQRT_PI * step * (0.5 * value(0) + inner)
}

/// Acceptance at its ends: ρ of 0 never, ρ of 1 always; ρ stays within 0 and 1 for crowded voxels and λ of any size.
#[test]
fn acceptance_at_its_ends() {
    for u in [0.0, f64::MIN_POSITIVE, 0.5, 1.0 - f64::EPSILON / 2.0] {
        assert!(!accepts(u, f64::NEG_INFINITY) && !accepts(u, f64::NAN));
        assert!(accepts(u, 0.0));
    }
    let forms = [
        Acceptance::Eq20,
        Acceptance::Alg1,
        Acceptance::Centred,
        Acceptance::ExactPrior,
    ];
    for form in forms {
        for importance in [0.0, 1e-38, 0.5, 1.0] {
            for lambda in [0.0, 5.0, 1e30] {
                for count in [0, 1, u32::MAX] {
                    let ln = ln_acceptance(form, importance, lambda, count);
                    assert!(ln <= 0.0, "{form:?}, {importance}, {lambda}, {count}: {ln}");
                }
            }
        }
    }
    // ((1+c)/(2+c))^λ of a crowded voxel is 1 − λ/(2+c) within (λ/(2+c))².
    let crowded = exact_ln_prior_ratio(5.0, u32::MAX);
    let want = -5.0 / (f64::from(u32::MAX) + 1.5);
    assert!((crowded / want - 1.0).abs() <= SUMMED);
}

/// Whole steps on scenes of one extreme: every edit is finite, names a row that is there and writes none twice.
#[test]
fn steps_on_extreme_scenes() {
    const N: usize = 5000;
    let stream = Stream::Synthetic.stream(2);
    let normal = |k: u64, i: usize| Philox::normal(k, stream, i as u64)[0] as f32;
    let step = |case: &str, at: &dyn Fn(usize) -> [f32; 3], opacity_logit: f32| {
        let positions: Vec<[f32; 3]> = (0..N).map(at).collect();
        let plane = |k: usize| positions.iter().map(|p| p[k]).collect::<Vec<f32>>();
        let planes = [plane(0), plane(1), plane(2)];
        let (small, zeros, ones) = (vec![-4.0; N], vec![0.0; N], vec![1.0; N]);
        let scene = SceneState {
            positions: [&planes[0], &planes[1], &planes[2]],
            log_scales: [&small; 3],
            rotations: [&ones, &zeros, &zeros, &zeros],
            opacity_logits: &vec![opacity_logit; N],
        };
        let cues = ErrorStatistics {
            ssim: &zeros,
            l1: &zeros,
            views: &vec![0; N],
        };
        let config = MhConfig::default();
        let mh = MetropolisHastings::new(&config);
        let context = StepContext::at(10_000, 0.5, 1);
        let outcome = mh
            .step(&context, &scene, &Statistics::Errors(cues))
            .unwrap();
        let mut written = vec![false; outcome.rows];
        for e in &outcome.edits {
            let values = e.position.iter().chain(&e.log_scale);
            let mut values = values.chain([&e.opacity_logit]);
            assert!(values.all(|v| v.is_finite()), "{case}: {e:?}");
            assert!((e.src as usize) < N, "{case}: {e:?}");
            let twice = std::mem::replace(&mut written[e.dst as usize], true);
            assert!(!twice, "{case}: {e:?}");
        }
        assert!(outcome.gaussians() > 0, "{case}");
        // Scenes that are not wholly dead have births, but where f32 cannot tell the parts of a split apart.
        let resolved = planes[0].iter().all(|x| x.abs() < 1e30);
        let bears = opacity_logit > -10.0 && resolved;
        assert_eq!(outcome.stats.accepted > 0, bears, "{case}");
    };
    let apart = |i: usize| [normal(1, i), normal(2, i), normal(3, i)];
    step("every Gaussian dead", &apart, -20.0);
    step("none dead", &apart, 3.0);
    step("all in one voxel", &|_| [0.0; 3], 0.0);
    let far = |i: usize| apart(i).map(|v| 1e38 * v.signum());
    step("positions of 1e38", &far, 0.0);
}
