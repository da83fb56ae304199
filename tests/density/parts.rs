//! The parts of density control, each against something simpler.

use super::{Scene, on_threads};
use mhsplat::base::math::sigmoid;
use mhsplat::base::rng::{Philox, Stream};
use mhsplat::density::ErrorStatistics;
use mhsplat::density::draw::{Categorical, birth_position, rotate};
use mhsplat::density::mh::importance::importance;
use mhsplat::density::mh::sparsity::VoxelCounts;
use mhsplat::density::relocation::{ln_coefficient, most_copies, split};

/// Known answers of Random123's `kat_vectors` for philox4x32-10.
#[test]
fn philox_gives_the_published_words() {
    let ones = u64::MAX;
    let cases = [
        (
            (0, 0, 0),
            [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8],
        ),
        (
            (ones, ones, ones),
            [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd],
        ),
        (
            (
                0x299f_31d0_a409_3822,
                0x0370_7344_1319_8a2e,
                0x85a3_08d3_243f_6a88,
            ),
            [0xd16c_fe09, 0x94fd_cceb, 0x5001_e420, 0x2412_6ea1],
        ),
    ];
    for ((seed, stream, index), words) in cases {
        assert_eq!(Philox::words(seed, stream, index), words);
    }
    assert_ne!(Philox::words(0, 0, 1), cases[0].1);
}

#[test]
fn uniform_and_normal_have_their_moments() {
    let stream = Stream::Synthetic.stream(7);
    let moments = |draw: &dyn Fn(u64) -> Vec<f64>| {
        let values: Vec<f64> = (0..50_000).flat_map(draw).collect();
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let var = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n;
        (mean, var)
    };
    let close = |(mean, var): (f64, f64), m: f64, v: f64| {
        // Five standard errors of 200,000 (100,000) draws.
        (mean - m).abs() < 5.0 * (v / 1e5).sqrt()
            && (var / v - 1.0).abs() < 5.0 * (2.0f64 / 1e5).sqrt()
    };
    let uniform = moments(&|i| Philox::uniform(3, stream, i).to_vec());
    let fine = moments(&|i| Philox::uniform_53(3, stream, i).to_vec());
    let normal = moments(&|i| Philox::normal(3, stream, i).to_vec());
    assert!(close(uniform, 0.5, 1.0 / 12.0) && close(fine, 0.5, 1.0 / 12.0));
    assert!(close(normal, 0.0, 1.0));
    assert!(
        !close(uniform, 0.5, 0.09),
        "the comparator must see a wrong variance"
    );
}

#[test]
fn streams_of_two_purposes_never_meet() {
    let a = Stream::CoarseOffset.stream(u32::MAX);
    let b = Stream::FineDraw.stream(0);
    assert_ne!(a, b);
    assert_eq!(a >> 32, Stream::CoarseOffset as u64);
    assert_ne!(Philox::words(1, a, 5), Philox::words(1, b, 5));
}

#[test]
fn most_copies_are_as_many_as_keep_the_floor() {
    for logit in [-5.0, -3.0, 0.0, 4.0, 60.0] {
        for floor in [0.005, 0.01, 0.2] {
            let most = most_copies(logit, floor);
            let opacity = |copies| sigmoid(split(logit, copies).opacity_logit);
            assert!(most == 1 || opacity(most) >= floor * (1.0 - 1e-9));
            assert!(opacity(most + 1) < floor * (1.0 + 1e-9));
        }
    }
    assert_eq!(most_copies(f64::NAN, 0.01), 1);
    assert_eq!(most_copies(f64::INFINITY, 1e-300), u32::MAX);
}

/// [MCMC] Eq. 9 as printed; good to about 1e-12 for N ≤ 12.
pub fn alternating_sum(opacity: f64, copies: u32) -> f64 {
    let mut sum = 0.0;
    for i in 1..=copies {
        let mut binomial = 1.0;
        for k in 0..i {
            let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
            let k = f64::from(k);
            sum += sign * binomial * opacity.powf(k + 1.0) / (k + 1.0).sqrt();
            binomial *= (f64::from(i) - 1.0 - k) / (k + 1.0);
        }
    }
    sum
}

/// The integral form by the trapezoid rule, which converges exponentially for this even entire integrand.
fn fine_quadrature(opacity: f64, copies: u32) -> f64 {
    let h = 0.004;
    let g = |k: u32| {
        let t = h * f64::from(k);
        -(f64::from(copies) * (-opacity * (-t * t).exp()).ln_1p()).exp_m1()
    };
    let sum: f64 = 0.5 * g(0) + (1..2500).map(g).sum::<f64>();
    std::f64::consts::FRAC_2_SQRT_PI * h * sum
}

const OPACITIES: [f64; 10] = [
    1e-6,
    1e-4,
    0.005,
    0.1,
    0.3,
    0.5,
    0.9,
    0.99,
    0.9999,
    1.0 - 1e-6,
];

#[test]
fn coefficient_is_the_alternating_sum_where_that_one_holds() {
    for opacity in OPACITIES {
        for copies in 1..=12 {
            let ours = ln_coefficient(opacity, copies).exp();
            let printed = alternating_sum(opacity, copies);
            assert!(
                (ours / printed - 1.0).abs() < 1e-9,
                "{opacity} {copies}: {ours} {printed}"
            );
        }
    }
    // One copy too many is far outside of the tolerance.
    let wrong = alternating_sum(0.3, 6) / ln_coefficient(0.3, 5).exp() - 1.0;
    assert!(wrong.abs() > 1e-2);
}

#[test]
fn coefficient_is_the_fine_quadrature_up_to_ten_thousand_copies() {
    let mut worst = 0.0f64;
    for opacity in OPACITIES {
        for copies in [1, 2, 7, 13, 20, 33, 60, 128, 200, 500, 1000, 3333, 10_000] {
            let ours = ln_coefficient(opacity, copies).exp();
            worst = worst.max((ours / fine_quadrature(opacity, copies) - 1.0).abs());
        }
    }
    println!("largest relative error of F: {worst:.1e}");
    assert!(worst < 1e-9, "{worst:e}");
}

#[test]
fn split_keeps_the_rendered_opacity_and_never_grows() {
    for logit in [-13.0, -5.0, -1.0, 0.0, 2.0, 9.0, 30.0] {
        for copies in [1u32, 2, 3, 10, 77, 1000, 10_000] {
            let part = split(logit, copies);
            // Compared as ln(1−o): 1 − (1−o′)^N = o means N·ln(1−o′) = ln(1−o).
            let ln_pass = |l: f64| sigmoid(-l).ln();
            let all = f64::from(copies) * ln_pass_stable(part.opacity_logit);
            let one = ln_pass_stable(logit);
            assert!(
                (all / one - 1.0).abs() < 1e-9,
                "{logit} {copies}: {all} {one}"
            );
            assert!(part.log_scale_offset <= 1e-9, "{logit} {copies}: {part:?}");
            if logit.abs() < 3.0 {
                assert!((ln_pass(logit) / one - 1.0).abs() < 1e-12);
            }
        }
    }
    let one = split(0.7, 1);
    assert_eq!((one.opacity_logit, one.log_scale_offset), (0.7, 0.0));
    let o = sigmoid(1.0);
    let wrong = 1.0 - (1.0 - sigmoid(split(1.0, 3).opacity_logit)).powi(4);
    assert!(
        (wrong - o).abs() > 1e-2,
        "the check must see a wrong number of copies"
    );
    for logit in [f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e300] {
        let part = split(logit, 5);
        assert!(part.opacity_logit.is_finite() && part.log_scale_offset.is_finite());
    }
    assert!(split(f64::NAN, 2).opacity_logit.is_nan());
}

fn ln_pass_stable(logit: f64) -> f64 {
    -(logit.max(0.0) + (-logit.abs()).exp().ln_1p())
}

#[test]
fn importance_follows_its_equation() {
    let scene = Scene::random(5000, 9);
    let weights = [0.8, 0.5, 0.5];
    let ours = importance(&scene.logits, &scene.cues(), weights);
    let seen: Vec<usize> = (0..5000).filter(|i| scene.views[*i] > 0).collect();
    let standard = |values: &dyn Fn(usize) -> f64, rows: &[usize], i: usize| {
        let n = rows.len() as f64;
        let mean = rows.iter().map(|r| values(*r)).sum::<f64>() / n;
        let var = rows
            .iter()
            .map(|r| (values(*r) - mean).powi(2))
            .sum::<f64>()
            / n;
        (values(i) - mean) / (var.sqrt() + 1e-6)
    };
    let all: Vec<usize> = (0..5000).collect();
    for i in [0, 1, 2, 3, 4998, 4999] {
        let mut z = 0.8 * standard(&|r| sigmoid(f64::from(scene.logits[r])), &all, i);
        if scene.views[i] > 0 {
            z += 0.5
                * standard(
                    &|r| f64::from(scene.ssim[r]) / f64::from(scene.views[r]),
                    &seen,
                    i,
                );
            z += 0.5
                * standard(
                    &|r| f64::from(scene.l1[r]) / f64::from(scene.views[r]),
                    &seen,
                    i,
                );
        }
        assert!((ours[i] - sigmoid(z)).abs() < 1e-12, "row {i}");
    }
    let other = importance(&scene.logits, &scene.cues(), [0.8, 0.5, 0.0]);
    assert!((ours[1] - other[1]).abs() > 1e-6, "the L1 cue must matter");
}

#[test]
fn importance_survives_broken_and_constant_cues() {
    let cues = ErrorStatistics {
        ssim: &[f32::NAN, 1.0, 1.0, 3.0],
        l1: &[1.0, f32::INFINITY, 1.0, 1.0],
        views: &[1, 1, 1, 0],
    };
    let i = importance(&[0.0; 4], &cues, [0.8, 0.5, 0.5]);
    // Constant cues carry no information: everything is average.
    assert!(i.iter().all(|v| (v - 0.5).abs() < 1e-9), "{i:?}");
    let empty = ErrorStatistics {
        ssim: &[],
        l1: &[],
        views: &[],
    };
    assert!(importance(&[], &empty, [1.0; 3]).is_empty());
}

#[test]
fn categorical_draws_follow_the_weights() {
    let weights: Vec<f64> = (0..20_000).map(|i| f64::from(i % 4)).collect();
    let c = Categorical::new(weights);
    let mut tally = [0.0; 4];
    let n = 100_000;
    for k in 0..n {
        let u = Philox::uniform_53(1, Stream::Synthetic.stream(1), k)[0];
        tally[c.draw(u).unwrap() % 4] += 1.0;
    }
    // Chi-square over three categories, 99.9 % quantile of 2 degrees of freedom: 13.8.
    let chi = |p: [f64; 4]| -> f64 {
        (1..4)
            .map(|i| (tally[i] - p[i] * n as f64).powi(2) / (p[i] * n as f64))
            .sum()
    };
    assert_eq!(tally[0], 0.0, "an item of weight 0 was drawn");
    assert!(chi([0.0, 1.0 / 6.0, 1.0 / 3.0, 0.5]) < 13.8);
    assert!(
        chi([0.0, 0.2, 0.3, 0.5]) > 13.8,
        "the comparator must see other weights"
    );
}

/// Sums that are kept for blocks give the items that all prefix sums give, to the bit: an item on the edge of a draw is another scene.
#[test]
fn categorical_draws_what_all_prefix_sums_draw() {
    const CHUNK: usize = 8192;
    for count in [1, 127, 128, 129, CHUNK, 3 * CHUNK + 77] {
        let weight = |i: u64| {
            let [u, scale, kind, _] = Philox::uniform(3, 1, i);
            match kind {
                k if k < 0.2 => 0.0,
                k if k < 0.25 => -u,
                k if k < 0.3 => f64::NAN,
                _ => u * (40.0 * scale - 20.0).exp(),
            }
        };
        let weights: Vec<f64> = (0..count as u64).map(weight).collect();
        let (mut sums, mut base) = (Vec::new(), 0.0);
        for chunk in weights.chunks(CHUNK) {
            let mut run = 0.0;
            for weight in chunk {
                run += if *weight > 0.0 { *weight } else { 0.0 };
                sums.push(base + run);
            }
            base += run;
        }
        let plain = |u: f64| {
            let at = u * base;
            match at < base {
                true => sums.iter().position(|sum| *sum > at),
                false => sums.iter().position(|sum| *sum >= base),
            }
        };
        let c = Categorical::new(weights);
        let edges = sums.iter().step_by(97).map(|sum| sum / base);
        let draws = (0..2000).map(|k| Philox::uniform_53(4, 2, k)[0]);
        for u in draws.chain(edges).filter(|u| *u < 1.0) {
            assert_eq!(c.draw(u), plain(u), "{count} weights, u = {u}");
        }
    }
}

#[test]
fn categorical_handles_one_hot_zero_and_broken_weights() {
    let mut one = vec![0.0; 30_000];
    one[17_321] = 1e-300;
    let hot = Categorical::new(one);
    assert_eq!(hot.draw_unique(500, 3, 4), vec![17_321]);
    assert_eq!(hot.draw(1.0 - f64::EPSILON / 2.0), Some(17_321));
    for weights in [
        vec![0.0; 8],
        vec![f64::NAN; 8],
        vec![f64::INFINITY; 8],
        vec![-1.0; 8],
    ] {
        let flat = Categorical::new(weights);
        assert_eq!(flat.draw_unique(400, 3, 4), (0..8).collect::<Vec<_>>());
    }
    assert_eq!(
        Categorical::new(vec![f64::NAN, 2.0, -3.0]).draw_unique(50, 0, 0),
        vec![1]
    );
    assert_eq!(Categorical::new(Vec::new()).draw(0.3), None);
    assert!(Categorical::new(Vec::new()).draw_unique(5, 0, 0).is_empty());
}

#[test]
fn sums_counts_and_draws_do_not_depend_on_threads() {
    let scene = Scene::random(60_000, 2);
    let run = || {
        let i = importance(&scene.logits, &scene.cues(), [0.8, 0.5, 0.5]);
        let c = Categorical::new(i.clone());
        let counts = VoxelCounts::count(scene.state().positions, 0.02);
        let found: Vec<u32> = (0..60_000)
            .map(|r| counts.get(scene.state().positions.map(|p| f64::from(p[r]))))
            .collect();
        (c.draw_unique(5000, 1, 2), i, c, found)
    };
    assert!(on_threads(1, run) == on_threads(2, run));
}

#[test]
fn births_follow_the_shape_of_their_source() {
    let mut scene = Scene::random(1, 1);
    // A needle along its own x axis, turned by 90° about z: births must spread along world y.
    let half = std::f32::consts::FRAC_1_SQRT_2;
    for (plane, q) in scene
        .rotations
        .iter_mut()
        .zip([3.0 * half, 0.0, 0.0, 3.0 * half])
    {
        plane[0] = q;
    }
    let scales = [0.0, -9.0, -9.0];
    let n = 4000;
    let mut var = [0.0; 3];
    for k in 0..n {
        let [a, b, c, _] = Philox::normal(8, 8, k);
        let x = birth_position(&scene.state(), 0, scales, 2.0, [a, b, c]).unwrap();
        for (v, (x, p)) in var.iter_mut().zip(x.iter().zip(&scene.positions)) {
            *v += f64::from(x - p[0]).powi(2) / n as f64;
        }
    }
    assert!(
        (var[1] / 4.0 - 1.0).abs() < 0.12 && var[0] < 1e-6 && var[2] < 1e-6,
        "{var:?}"
    );
    assert!(birth_position(&scene.state(), 1, scales, 2.0, [0.0; 3]).is_none());
    assert!(birth_position(&scene.state(), 0, [80.0; 3], 1e9, [1.0; 3]).is_none());
    let v = [1.0, 2.0, 3.0];
    assert_eq!(rotate([0.0; 4], v), v);
    assert_eq!(rotate([f64::NAN, 1.0, 0.0, 0.0], v), v);
    let tiny = rotate([0.0, 1e-200, 0.0, 0.0], v);
    assert!(
        tiny.iter()
            .zip([1.0, -2.0, -3.0])
            .all(|(a, b)| (a - b).abs() < 1e-12)
    );
}
