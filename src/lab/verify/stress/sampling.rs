//! Density control at its extremes, on the host, against closed forms and brute force.

use std::collections::HashMap;

use crate::base::error::Result;
use crate::base::math::{logit, sigmoid};
use crate::base::rng::{Philox, Stream};
use crate::config::{Acceptance, MhConfig};
use crate::density::draw::Categorical;
use crate::density::mh::MetropolisHastings;
use crate::density::mh::accept::{accepts, exact_ln_prior_ratio, ln_acceptance};
use crate::density::mh::importance::importance;
use crate::density::mh::sparsity::VoxelCounts;
use crate::density::relocation::{ln_coefficient, split};
use crate::density::{DensityControl, ErrorStatistics, SceneState, Statistics, StepContext};
use crate::lab::verify::check::{EXACT, FamilyNote, Row};

/// Name, axis and bound of the family.
pub const NOTE: FamilyNote = FamilyNote {
    name: "density control",
    axis: "size of the extreme",
    bound: 1e-9,
    reason: "sums over ten million weights in f64; a quadrature of 40 nodes for the relocation",
};

fn row(case: &str, stiffness: f64, quantity: &str, errors: &[f64], bound: f64) -> Row {
    let (of, names) = ([NOTE.name, "density"], [case, quantity]);
    Row::of_errors(of, names, stiffness, errors, bound)
}

fn yes(good: bool) -> f64 {
    if good { 0.0 } else { 1.0 }
}

/// Rows of all extremes.
///
/// # Errors
/// Those of a density step.
pub fn rows() -> Result<Vec<Row>> {
    let mut rows = draws();
    rows.extend(importances());
    rows.push(voxels());
    rows.extend(relocations());
    rows.extend(acceptance());
    rows.extend(steps()?);
    Ok(rows)
}

/// Draws over ten million weights: the item at u against the exact distribution.
fn draws() -> Vec<Row> {
    const N: usize = 10_000_000;
    let probe = |k: usize| (k as f64 + 0.5) / 1000.0;
    let even = |case: &str, weight: f64| {
        let drawn = Categorical::new(&vec![weight; N]);
        let error = |k: usize| match drawn.draw(probe(k)) {
            // The item's own width is no error.
            Some(i) => ((i as f64 + 0.5) / N as f64 - probe(k)).abs() - 0.5 / N as f64,
            None => 1.0,
        };
        let errors: Vec<f64> = (0..1000).map(|k| error(k).max(0.0)).collect();
        row(case, N as f64, "distribution", &errors, 1e-9)
    };
    let mut hot = vec![0.0; N];
    hot[N - 7] = 1e-38;
    let hot = Categorical::new(&hot);
    let errors: Vec<f64> = (0..1000)
        .map(|k| yes(hot.draw(probe(k)) == Some(N - 7)))
        .collect();
    // Weights 1/(i + 1): the sum up to an item is ln(i) + γ + 1/(2i) − 1/(12i²) for large i.
    let harmonic: Vec<f64> = (0..N).map(|i| 1.0 / (i as f64 + 1.0)).collect();
    let harmonic = Categorical::new(&harmonic);
    let sum = |i: f64| i.ln() + 0.577_215_664_901_532_9 + 0.5 / i - 1.0 / (12.0 * i * i);
    let error = |k: usize| match harmonic.draw(probe(k)) {
        Some(i) if i > 1000 => {
            let [below, above] = [i as f64, i as f64 + 1.0].map(|i| sum(i) / sum(N as f64));
            (below - probe(k)).max(probe(k) - above).max(0.0)
        }
        Some(_) => 0.0,
        None => 1.0,
    };
    let tails: Vec<f64> = (0..1000).map(error).collect();
    vec![
        even("10^7 equal weights", 1.0),
        even("10^7 weights of 1e-38", 1e-38),
        even("10^7 weights of 0", 0.0),
        row("one weight of 10^7", N as f64, "item", &errors, EXACT),
        row("10^7 weights 1/i", N as f64, "distribution", &tails, 1e-9),
    ]
}

/// Importance from cues that are equal, alone or of any size: finite, between 0 and 1, and ½ if all are equal.
fn importances() -> Vec<Row> {
    const N: usize = 1000;
    let of = |cue: &dyn Fn(usize) -> f32| {
        let values: Vec<f32> = (0..N).map(cue).collect();
        let cues = ErrorStatistics {
            ssim: &values,
            l1: &values,
            views: &[1; N],
        };
        importance(&[0.5; N], &cues, [0.8, 0.5, 0.5]).values
    };
    let half = |case: &str, value: f32| {
        let errors: Vec<f64> = of(&|_| value).iter().map(|i| (i - 0.5).abs()).collect();
        row(case, 1.0, "importance", &errors, EXACT)
    };
    let bounded = |case: &str, values: Vec<f64>| {
        let errors: Vec<f64> = values
            .iter()
            .map(|i| yes(i.is_finite() && (0.0..=1.0).contains(i)))
            .collect();
        row(case, 1.0, "importance within 0 and 1", &errors, EXACT)
    };
    let hot = |height: f32| of(&|i| if i == 7 { height } else { 0.0 });
    let first = hot(1.0);
    let highest = first
        .iter()
        .enumerate()
        .all(|(i, v)| i == 7 || *v < first[7]);
    vec![
        half("all cues equal", 0.25),
        half("all cues 0", 0.0),
        half("all cues 1e-38", 1e-38),
        half("all cues f32::MAX", f32::MAX),
        bounded("one cue of many", first),
        row(
            "one cue of many",
            1.0,
            "it is the highest",
            &[yes(highest)],
            EXACT,
        ),
        bounded("one cue of f32::MAX", hot(f32::MAX)),
        bounded(
            "cues that are NaN",
            of(&|i| if i % 2 == 0 { f32::NAN } else { 1.0 }),
        ),
    ]
}

/// Counts of voxels with indices beyond 32 bits, which merge, against brute force.
fn voxels() -> Row {
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
    let error = |p: &[f32; 3]| {
        let want = if finite(p) { wanted[&key(p)] } else { 0 };
        f64::from(counts.get(p.map(f64::from)).abs_diff(want))
    };
    let mut errors: Vec<f64> = positions.iter().map(error).collect();
    errors.push(counts.occupied().abs_diff(wanted.len()) as f64);
    row(
        "voxel indices beyond 32 bits",
        1e38,
        "counts",
        &errors,
        EXACT,
    )
}

/// Opacity of N copies, which stays the same, and F against an independent quadrature.
fn relocations() -> Vec<Row> {
    let opacities = [1e-6, 0.005, 0.1, 0.5, 0.99, 1.0 - 1e-9];
    let case = |copies: u32| {
        let mut errors = Vec::new();
        for o in opacities {
            let part = split(logit(o), copies);
            let kept = -(f64::from(copies) * (-sigmoid(part.opacity_logit)).ln_1p()).exp_m1();
            errors.push((kept - o).abs() / o);
            let own = sigmoid(part.opacity_logit);
            let want = coefficient(own, copies);
            errors.push((ln_coefficient(own, copies).exp() / want - 1.0).abs());
        }
        let name = format!("relocation to {copies} copies");
        row(&name, f64::from(copies), "opacity kept, F", &errors, 1e-9)
    };
    [1, 2, 15, 51, 100, 1000, 10_000].map(case).to_vec()
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
fn acceptance() -> Vec<Row> {
    let us = [0.0, f64::MIN_POSITIVE, 0.5, 1.0 - f64::EPSILON / 2.0];
    let never = us.map(|u| yes(!accepts(u, f64::NEG_INFINITY) && !accepts(u, f64::NAN)));
    let always = us.map(|u| yes(accepts(u, 0.0)));
    let forms = [
        Acceptance::Eq20,
        Acceptance::Alg1,
        Acceptance::Centred,
        Acceptance::ExactPrior,
    ];
    let mut bounded = Vec::new();
    for form in forms {
        for importance in [0.0, 1e-38, 0.5, 1.0] {
            for lambda in [0.0, 5.0, 1e30] {
                for count in [0, 1, u32::MAX] {
                    let ln = ln_acceptance(form, importance, lambda, count);
                    bounded.push(yes(!ln.is_nan() && ln <= 0.0));
                }
            }
        }
    }
    // ((1+c)/(2+c))^λ of a crowded voxel is 1 − λ/(2+c) within (λ/(2+c))².
    let crowded = exact_ln_prior_ratio(5.0, u32::MAX);
    let want = -5.0 / (f64::from(u32::MAX) + 1.5);
    vec![
        row("acceptance", 1.0, "ratio 0", &never, EXACT),
        row("acceptance", 1.0, "ratio 1", &always, EXACT),
        row("acceptance", 1e30, "ratio within 0 and 1", &bounded, EXACT),
        row(
            "acceptance",
            f64::from(u32::MAX),
            "a crowded voxel",
            &[(crowded / want - 1.0).abs()],
            1e-9,
        ),
    ]
}

/// Whole steps on scenes of one extreme: every edit is finite, names a row that is there and writes none twice.
fn steps() -> Result<Vec<Row>> {
    const N: usize = 5000;
    let stream = Stream::Synthetic.stream(2);
    let normal = |k: u64, i: usize| Philox::normal(k, stream, i as u64)[0] as f32;
    let step = |case: &str, at: &dyn Fn(usize) -> [f32; 3], opacity_logit: f32| -> Result<Row> {
        let positions: Vec<[f32; 3]> = (0..N).map(at).collect();
        let plane = |k: usize| positions.iter().map(|p| p[k]).collect::<Vec<f32>>();
        let planes = [plane(0), plane(1), plane(2)];
        let (small, zeros, ones) = (vec![-4.0; N], vec![0.0; N], vec![1.0; N]);
        let logits = vec![opacity_logit; N];
        let scene = SceneState {
            positions: [&planes[0], &planes[1], &planes[2]],
            log_scales: [&small; 3],
            rotations: [&ones, &zeros, &zeros, &zeros],
            opacity_logits: &logits,
        };
        let cues = ErrorStatistics {
            ssim: &zeros,
            l1: &zeros,
            views: &vec![0; N],
        };
        let config = MhConfig::default();
        let mh = MetropolisHastings::new(&config);
        let context = StepContext::at(10_000, 0.5, 1);
        let outcome = mh.step(&context, &scene, &Statistics::Errors(cues))?;
        let mut written = vec![false; outcome.rows];
        let error = |e: &crate::scene::Edit| {
            let values = e
                .position
                .iter()
                .chain(&e.log_scale)
                .chain([&e.opacity_logit]);
            let finite = values.into_iter().all(|v| v.is_finite());
            let there = (e.src as usize) < N && (e.dst as usize) < outcome.rows;
            let first = there && !std::mem::replace(&mut written[e.dst as usize], true);
            yes(finite && first)
        };
        let mut errors: Vec<f64> = outcome.edits.iter().map(error).collect();
        errors.push(yes(outcome.gaussians() > 0));
        // Scenes that are not wholly dead have births.
        errors.push(yes(opacity_logit < -10.0 || outcome.stats.accepted > 0));
        Ok(row(case, N as f64, "edits", &errors, EXACT))
    };
    let apart = |i: usize| [normal(1, i), normal(2, i), normal(3, i)];
    Ok(vec![
        step("every Gaussian dead", &apart, -20.0)?,
        step("none dead", &apart, 3.0)?,
        step("all in one voxel", &|_| [0.0; 3], 0.0)?,
        step(
            "positions of 1e38",
            &|i| apart(i).map(|v| 1e38 * v.signum()),
            0.0,
        )?,
    ])
}
