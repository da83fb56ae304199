//! Acceptance: frequencies against ρ, and a chain against the exact distribution of a toy target.

use super::total_variation;
use mhsplat::base::rng::{Philox, Stream};
use mhsplat::config::Acceptance;
use mhsplat::density::mh::accept::{
    accepts, exact_ln_prior_ratio, exact_ln_prior_ratio_of_death, ln_acceptance, temperature_for,
    voxel_prior,
};

const LAMBDA: f64 = 0.7;
/// log-weight of one more Gaussian in each voxel, standing for −ΔL; a few voxels that want to be filled differently.
const GAIN: [f64; 3] = [0.9, 0.2, -0.4];
/// Largest count of a voxel; births beyond it are refused, which keeps the state space small and enumerable.
const CAP: u32 = 5;
const STATES: usize = 6 * 6 * 6;

fn state_index(counts: [u32; 3]) -> usize {
    counts.iter().fold(0, |i, c| i * 6 + *c as usize)
}

/// π ∝ exp(Σ_v gain_v·c_v − λ·Σ_v ln(1+c_v)): Eq. 7 with a linear loss.
fn exact_distribution() -> Vec<f64> {
    let mut p = vec![0.0; STATES];
    for a in 0..=CAP {
        for b in 0..=CAP {
            for c in 0..=CAP {
                let energy: f64 = [a, b, c]
                    .iter()
                    .zip(GAIN)
                    .map(|(n, g)| LAMBDA * f64::from(1 + n).ln() - g * f64::from(*n))
                    .sum();
                p[state_index([a, b, c])] = (-energy).exp();
            }
        }
    }
    let total: f64 = p.iter().sum();
    p.iter().map(|v| v / total).collect()
}

/// Births and deaths in a uniformly drawn voxel, each with probability ½ (symmetric on the counts), decided by
/// `accepts` with the given prior ratios of birth and death.
fn chain(birth: impl Fn(u32) -> f64, death: impl Fn(u32) -> f64) -> Vec<f64> {
    let steps = 1_500_000;
    let mut counts = [0u32; 3];
    let mut visits = vec![0.0; STATES];
    for k in 0..steps {
        let [voxel, kind, u, _] = Philox::uniform(11, Stream::Synthetic.stream(2), k);
        let v = ((voxel * 3.0) as usize).min(2);
        let c = counts[v];
        if kind < 0.5 {
            let ln_rho = if c < CAP {
                GAIN[v] + birth(c)
            } else {
                f64::NEG_INFINITY
            };
            counts[v] += u32::from(accepts(u, ln_rho));
        } else {
            counts[v] -= u32::from(accepts(u, death(c) - GAIN[v]));
        }
        visits[state_index(counts)] += 1.0 / steps as f64;
    }
    visits
}

#[test]
fn the_chain_has_the_stated_posterior() {
    let exact = exact_distribution();
    let visited = chain(
        |c| exact_ln_prior_ratio(LAMBDA, c),
        |c| exact_ln_prior_ratio_of_death(LAMBDA, c),
    );
    let distance = total_variation(&visited, &exact);
    // 216 states, about 1.5 million correlated steps: the noise of a right chain is near 0.01.
    println!("total variation, exact prior ratio: {distance:.4}");
    assert!(distance < 0.02, "{distance}");
}

#[test]
fn a_wrong_ratio_is_noticed() {
    let exact = exact_distribution();
    // The surrogate D = 1/(1 + λc) in place of the exact ratio, with its own inverse for deaths.
    let surrogate = chain(
        |c| voxel_prior(LAMBDA, c).ln(),
        |c| {
            c.checked_sub(1)
                .map_or(f64::NEG_INFINITY, |b| -voxel_prior(LAMBDA, b).ln())
        },
    );
    // A death that forgets to invert the birth that leads to its state.
    let unbalanced = chain(
        |c| exact_ln_prior_ratio(LAMBDA, c),
        |c| if c == 0 { f64::NEG_INFINITY } else { 0.0 },
    );
    for wrong in [surrogate, unbalanced] {
        let distance = total_variation(&wrong, &exact);
        println!("total variation, wrong ratio: {distance:.3}");
        assert!(distance > 0.1, "{distance}");
    }
}

#[test]
fn the_prior_ratio_is_that_of_the_energy() {
    for count in [0u32, 1, 2, 10, 1000, u32::MAX] {
        let c = f64::from(count);
        let energy = -5.0 * ((2.0 + c).ln() - (1.0 + c).ln());
        assert!((exact_ln_prior_ratio(5.0, count) - energy).abs() < 1e-12);
    }
    assert_eq!(
        exact_ln_prior_ratio_of_death(5.0, 3),
        -exact_ln_prior_ratio(5.0, 2)
    );
    assert_eq!(exact_ln_prior_ratio_of_death(5.0, 0), f64::NEG_INFINITY);
    assert_eq!(voxel_prior(5.0, 0), 1.0);
    assert!((voxel_prior(5.0, 2) - 1.0 / 11.0).abs() < 1e-15);
}

/// The forms of ρ as printed, not in logarithms, from the importance and the count in the voxel.
pub fn printed(form: Acceptance, i: f64, lambda: f64, c: u32) -> f64 {
    let d = 1.0 / (1.0 + lambda * f64::from(c));
    let logistic = |x: f64| 1.0 / (1.0 + (-x).exp());
    match form {
        Acceptance::Eq20 => logistic(i) * d,
        Acceptance::Alg1 => i * d,
        Acceptance::ExactPrior => (f64::from(1 + c) / f64::from(2 + c)).powf(lambda),
        _ => logistic(i - 0.5) * d,
    }
}

#[test]
fn births_are_accepted_as_often_as_each_form_says() {
    use Acceptance::{Alg1, Centred, Eq20, ExactPrior};
    let forms = [Eq20, Alg1, Centred, ExactPrior];
    let n = 40_000u64;
    // Five standard errors of a frequency.
    let close = |seen: f64, p: f64| (seen - p).abs() < 5.0 * (p * (1.0 - p) / n as f64).sqrt();
    for (f, form) in forms.into_iter().enumerate() {
        for (c, importance) in [(0, 0.5), (0, 0.95), (1, 0.7), (3, 0.2)] {
            let ln_rho = ln_acceptance(form, importance, 5.0, c);
            let stream = Stream::Synthetic.stream(3 + f as u32);
            let hits = (0..n)
                .filter(|k| accepts(Philox::uniform(5, stream, *k)[0], ln_rho))
                .count();
            let seen = hits as f64 / n as f64;
            assert!(
                close(seen, printed(form, importance, 5.0, c)),
                "{form:?} {importance} {c}: {seen}"
            );
            assert!(
                !close(seen, printed(form, importance, 5.0, c + 1)),
                "{form:?}: another count passes"
            );
            let other = forms[(f + 1) % 4];
            let differs = (printed(other, importance, 5.0, c) - printed(form, importance, 5.0, c))
                .abs()
                > 0.03;
            assert!(
                !differs || !close(seen, printed(other, importance, 5.0, c)),
                "{other:?} passes"
            );
        }
    }
}

#[test]
fn nothing_is_accepted_by_mistake() {
    assert!(!accepts(0.0, f64::NAN) && !accepts(f64::NAN, 0.0));
    assert!(!accepts(0.0, f64::NEG_INFINITY) && !accepts(0.5, f64::NEG_INFINITY));
    assert!(accepts(0.0, -700.0) && accepts(0.999, 0.0) && accepts(0.999, f64::INFINITY));
    assert_eq!(
        ln_acceptance(Acceptance::Alg1, 0.0, 5.0, 0),
        f64::NEG_INFINITY
    );
}

#[test]
fn a_temperature_gives_the_wanted_rate() {
    let draw = |k: u64| Philox::uniform(3, Stream::Synthetic.stream(9), k);
    let ln_rhos: Vec<f64> = (0..5000)
        .map(|k| {
            let [i, c, ..] = draw(k);
            ln_acceptance(Acceptance::Eq20, i, 5.0, (4.0 * c) as u32)
        })
        .collect();
    let mean = |t: f64| ln_rhos.iter().map(|l| (l / t).exp()).sum::<f64>() / 5000.0;
    for wanted in [0.05, 0.2, 0.5, 0.9] {
        let t = temperature_for(&ln_rhos, wanted);
        assert!((mean(t) - wanted).abs() < 1e-8, "{wanted}: {t}");
        assert!((mean(1.1 * t) - wanted).abs() > 1e-3);
    }
    assert!((temperature_for(&ln_rhos, mean(1.0)) - 1.0).abs() < 1e-8);
    // What cannot be had gives the nearer end, and what is impossible stays so.
    assert!(temperature_for(&[-1.0], 1.0 - 1e-9) > 9999.0);
    assert!(temperature_for(&[0.0; 3], 0.3) < 2e-4);
    let some = temperature_for(&[f64::NEG_INFINITY, -1.0, -1.0], 0.5);
    assert!((2.0 / 3.0 * (-1.0 / some).exp() - 0.5).abs() < 1e-8);
}

/// The result of bisection in ln T alone, which `temperature_for` is to equal to the bit.
fn by_halving(ln_rhos: &[f64], wanted: f64) -> f64 {
    let [mut low, mut high] = [1e-4f64, 1e4].map(f64::ln);
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        let power = (-middle).exp();
        let sum: f64 = ln_rhos.iter().map(|l| (l * power).min(0.0).exp()).sum();
        if sum >= wanted * ln_rhos.len() as f64 {
            high = middle;
        } else {
            low = middle;
        }
    }
    high.exp()
}

#[test]
fn temperatures_are_those_of_halving_alone() {
    let draw = |k: u64| Philox::uniform(5, Stream::Synthetic.stream(10), k)[0];
    let mut sets = vec![
        vec![-1.0],
        vec![0.0; 3],
        vec![f64::NEG_INFINITY, -1.0, -1.0],
        vec![f64::NAN, -1.0],
        vec![f64::NEG_INFINITY; 2],
        Vec::new(),
    ];
    for (n, spread) in [(7, 1.0), (300, 1e-3), (2000, 3.0), (500, 1e5), (400, 1e-9)] {
        let all = (0..n).map(|k| -spread * draw(k + n) * draw(k)).collect();
        sets.push(all);
    }
    for ln_rhos in &sets {
        for wanted in [1e-9, 0.01, 0.2, 0.37, 0.5, 0.75, 0.999, 1.0, 2.0] {
            let (found, halved) = (
                temperature_for(ln_rhos, wanted),
                by_halving(ln_rhos, wanted),
            );
            assert_eq!(
                found.to_bits(),
                halved.to_bits(),
                "{} of {wanted}",
                ln_rhos.len()
            );
        }
    }
}
