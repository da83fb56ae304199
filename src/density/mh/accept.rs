//! Acceptance of a proposed birth, in logarithms (\[MH\] Eq. 7, 18–20, Alg. 1).
//!
//! The posterior is π ∝ exp(−E) with E = L + λ_v Σ_v ln(1 + c(v)) (Eq. 7). Adding one Gaussian to a voxel that holds c
//! multiplies the prior by ((1+c)/(2+c))^λ_v exactly: [`exact_ln_prior_ratio`]. The paper replaces that factor by
//! D = 1/(1 + λ_v·c) and the loss change by the importance I of the source; three forms of the product are on record
//! ([`Acceptance`]). The surrogates are what training uses; the exact ratio is what they can be measured against.

use crate::config::Acceptance;
use crate::density::relocation::ln_sigmoid;

/// D(v′) = 1/(1 + λ_v·c), c Gaussians being in the proposal's voxel. In (0, 1], and 1 in an empty voxel.
#[must_use]
pub fn voxel_prior(lambda: f64, count: u32) -> f64 {
    1.0 / (1.0 + lambda * f64::from(count))
}

/// ln ρ of a birth whose source has importance I ∈ [0, 1], in the chosen form; −∞ where ρ is 0.
#[must_use]
pub fn ln_acceptance(form: Acceptance, importance: f64, lambda: f64, count: u32) -> f64 {
    let ln_gain = match form {
        Acceptance::Eq20 => ln_sigmoid(importance),
        Acceptance::Alg1 => importance.ln(),
        Acceptance::Centred => ln_sigmoid(importance - 0.5),
    };
    ln_gain - (lambda * f64::from(count)).ln_1p()
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

/// The Metropolis decision: accept if ln u < ln ρ, u uniform in [0, 1). A NaN ratio is never accepted.
#[must_use]
pub fn accepts(u: f64, ln_rho: f64) -> bool {
    u.ln() < ln_rho
}
