//! Acceptance of a proposed birth, in logarithms (\[MH\] Eq. 7, 18–20, Alg. 1).
//!
//! The posterior is π ∝ exp(−E) with E = L + λ_v Σ_v ln(1 + c(v)) (Eq. 7). Adding one Gaussian to a voxel that holds c
//! multiplies the prior by ((1+c)/(2+c))^λ_v exactly: [`exact_ln_prior_ratio`]. The paper replaces that factor by
//! D = 1/(1 + λ_v·c) and the loss change by the importance I of the source; three forms of the product are on record
//! ([`Acceptance`]). These surrogates are not Metropolis–Hastings ratios: neither the loss nor the density of the proposal
//! nor that of the way back is in them, and deaths go by opacity alone. With [`exact_ln_prior_ratio`], its inverse for deaths and
//! the true change of the loss the chain has the posterior of Eq. 7 (`tests/density/chain.rs`); as the form
//! `exact-prior` of training, which applies it to births alone and decides many at once on the same counts, it is exact in the
//! prior's factor and no more, and in that for births whose sources stay where they are.
//!
//! The rule is applied in `step.rs` (`decide`), where each phase may solve T for the share of births that it is to accept.
//!
//! If births are estimated, the computed first-order change of the loss takes the place of I ([`ln_gains`]). It is that of a
//! faint birth, over a few views, and of each birth alone.
//!
//! A temperature T turns ρ into ρ^{1/T}: the posterior's 1/T-th power for the exact form, a plain knob for the others.

use rayon::prelude::*;

use crate::base::math::ln_sigmoid;
use crate::config::Acceptance;

/// D(v′) = 1/(1 + λ_v·c), c Gaussians being in the proposal's voxel. In (0, 1], and 1 in an empty voxel.
#[must_use]
pub fn voxel_prior(lambda: f64, count: u32) -> f64 {
    1.0 / (1.0 + lambda * f64::from(count))
}

/// ln ρ of a birth whose source has importance I ∈ [0, 1], in the chosen form; −∞ if ρ is 0.
#[must_use]
pub fn ln_acceptance(form: Acceptance, importance: f64, lambda: f64, count: u32) -> f64 {
    ln_ratio(form, ln_gain(form, importance), lambda, count)
}

/// The part of ln ρ that stands for the change of the loss, from the importance I ∈ [0, 1] of the source: at most 0, −∞ if
/// such a birth is never accepted; 0 in the form without importance.
#[must_use]
pub fn ln_gain(form: Acceptance, importance: f64) -> f64 {
    match form {
        Acceptance::Eq20 => ln_sigmoid(importance),
        Acceptance::Alg1 => importance.ln(),
        Acceptance::Centred => ln_sigmoid(importance - 0.5),
        Acceptance::ExactPrior => 0.0,
    }
}

/// ln ρ from the gain's part and the c Gaussians in the voxel of birth.
#[must_use]
pub fn ln_ratio(form: Acceptance, ln_gain: f64, lambda: f64, count: u32) -> f64 {
    match form {
        Acceptance::ExactPrior => exact_ln_prior_ratio(lambda, count),
        _ => ln_gain - (lambda * f64::from(count)).ln_1p(),
    }
}

/// The gain's part of ln ρ from first-order changes ΔL of the loss, one per proposal of a step: ln σ(−ΔL/s), Barker's rule
/// (Barker 1965) at a temperature of s, the mean |ΔL|, so that `temperature` means the same at any size of the loss; z = 0
/// if s is 0. Metropolis's min(0, −ΔL/s) makes half of the proposals certain, whatever the temperature, so that no share
/// below theirs can be asked for. A proposal that no view saw (NaN) gets the mean of the others,
/// like the error statistics of a source that no view sees.
#[must_use]
pub fn ln_gains(changes: &[f64]) -> Vec<f64> {
    let known = || changes.iter().filter(|c| c.is_finite());
    let count = known().count().max(1) as f64;
    let scale = known().map(|c| c.abs()).sum::<f64>() / count;
    if !(scale > 0.0 && scale.is_finite()) {
        return vec![ln_sigmoid(0.0); changes.len()];
    }
    let gain = |change: &f64| ln_sigmoid(-change / scale);
    let mean = known().map(gain).sum::<f64>() / count;
    let of = |c: &f64| if c.is_finite() { gain(c) } else { mean };
    changes.iter().map(of).collect()
}

/// ln of the exact prior ratio of a birth into a voxel that holds c Gaussians: λ_v·[ln(1+c) − ln(2+c)], from Eq. 7.
#[must_use]
pub fn exact_ln_prior_ratio(lambda: f64, count: u32) -> f64 {
    // (1+c)/(2+c) = 1 − 1/(2+c): no cancellation at large c.
    lambda * (-1.0 / (2.0 + f64::from(count))).ln_1p()
}

/// ln of the exact prior ratio of a death in a voxel that holds c ≥ 1 Gaussians: the inverse of the birth that leads
/// there. An empty voxel has nothing to lose: −∞.
#[must_use]
pub fn exact_ln_prior_ratio_of_death(lambda: f64, count: u32) -> f64 {
    count.checked_sub(1).map_or(f64::NEG_INFINITY, |before| {
        -exact_ln_prior_ratio(lambda, before)
    })
}

/// Least and greatest result of [`temperature_for`].
const TEMPERATURES: [f64; 2] = [1e-4, 1e4];
/// Number of halvings of their logarithms' range: 18.4 / 2⁴⁰ is 2e-11.
const HALVINGS: usize = 40;
/// Greatest number of trials that enclose the result before the halvings.
const TRIALS: usize = 12;
/// Width in ln T at which it counts as enclosed.
const ENCLOSED: f64 = 1e-11;

/// The T at which the mean of ρ^{1/T} over the proposals is `wanted`, by bisection in ln T between 1e-4 and 1e4; the nearer
/// end if there is none. A function of the proposals alone, so that nothing has to be kept between steps.
#[must_use]
pub fn temperature_for(ln_rhos: &[f64], wanted: f64) -> f64 {
    let mut accepted = Vec::with_capacity(ln_rhos.len());
    let mut excess = |ln_temperature: f64| -> f64 {
        let power = (-ln_temperature).exp();
        let each = ln_rhos.par_iter().map(|l| (l * power).min(0.0).exp());
        each.collect_into_vec(&mut accepted);
        // One order of summation, whatever the number of threads.
        let sum: f64 = accepted.iter().sum();
        sum - wanted * ln_rhos.len() as f64
    };
    // The mean rises with T, because no ρ is above 1, and so does its computed sum as far as `exp` rises: what trials have found out spares
    // most of the halvings their sums.
    let [below, above] = enclose(&mut excess);
    let [mut low, mut high] = TEMPERATURES.map(f64::ln);
    for _ in 0..HALVINGS {
        let middle = 0.5 * (low + high);
        let reached = middle >= above || (middle > below && excess(middle) >= 0.0);
        if reached {
            high = middle;
        } else {
            low = middle;
        }
    }
    high.exp()
}

/// Two values of ln T between which a rising function reaches 0: it is below 0 at the first and not at the second, ±∞ if it does not
/// cross between T = 1e-4 and 1e4. By false position, with the value halved of an end that stays (Dowell and Jarratt 1971).
fn enclose(excess: &mut impl FnMut(f64) -> f64) -> [f64; 2] {
    let [mut low, mut high] = TEMPERATURES.map(f64::ln);
    let [mut at_low, mut at_high] = [excess(low), excess(high)];
    if at_low >= 0.0 {
        return [f64::NEG_INFINITY, low];
    }
    if at_high < 0.0 || at_high.is_nan() {
        return [high, f64::INFINITY];
    }
    let mut moved_up = None;
    for _ in 0..TRIALS {
        if high - low < ENCLOSED || at_high == 0.0 {
            break;
        }
        let secant = high - at_high * (high - low) / (at_high - at_low);
        let trial = secant.clamp(low, high);
        let value = excess(trial);
        let up = value < 0.0;
        if up {
            (low, at_low) = (trial, value);
            at_high *= if moved_up == Some(true) { 0.5 } else { 1.0 };
        } else {
            (high, at_high) = (trial, value);
            at_low *= if moved_up == Some(false) { 0.5 } else { 1.0 };
        }
        moved_up = Some(up);
    }
    [low, high]
}

/// The Metropolis decision: accept if ln u < ln ρ, u uniform in [0, 1). A NaN ratio is never accepted.
#[must_use]
pub fn accepts(u: f64, ln_rho: f64) -> bool {
    u.ln() < ln_rho
}
