//! Splitting one Gaussian into N equal copies that render alike (\[MCMC\] Eq. 9, Kheradmand et al., NeurIPS 2024).
//!
//! o′ = 1 − (1−o)^{1/N} and Σ′ = (o/F)²·Σ with F = Σ_{i=1..N} Σ_{k<i} C(i−1,k) (−1)^k o′^{k+1}/√(k+1). The alternating
//! sum loses every digit of f64 near N = 50; 1/√(k+1) = (2/√π) ∫₀^∞ e^{−(k+1)t²} dt turns it into
//!
//! F = (2/√π) ∫₀^∞ [1 − (1 − o′ e^{−t²})^N] dt,
//!
//! whose integrand is smooth, positive and falling, for any N.

use std::f64::consts::{FRAC_2_SQRT_PI, PI};
use std::sync::OnceLock;

use crate::base::math::{ln_sigmoid, softplus};

/// Gauss–Legendre nodes on the interval in which the integrand is neither 1 nor 0. 40 of them leave a relative error
/// below 1e-10 for N ≤ 10⁵; 32 leave 1e-8.
const NODES: usize = 40;
/// The integrand is 1 within e⁻²⁵ ≈ 1e-11 where N·o′·e^{−t²} exceeds this, because (1−z)^N ≤ e^{−Nz}.
const SATURATED: f64 = 25.0;
/// The integrand is negligible where N·o′·e^{−t²} is below e⁻²⁴ ≈ 4e-11 of min(1, N·o′).
const NEGLIGIBLE: f64 = 24.0;
/// Logits are clamped to ± this: e^{−600} is still a normal f64, so every logarithm below stays finite.
const LOGIT_LIMIT: f64 = 600.0;

/// What each of N copies gets.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Split {
    /// Opacity logit of each copy.
    pub opacity_logit: f64,
    /// To be added to each of the three log-scales: ln o − ln F. Never positive beyond rounding.
    pub log_scale_offset: f64,
}

/// Into how many equal copies a Gaussian can be split so that each keeps an opacity of at least `floor` in (0, 1): the
/// largest N with 1 − (1−o)^{1/N} ≥ floor, 1 where even two are too many.
#[must_use]
pub fn most_copies(opacity_logit: f64, floor: f64) -> u32 {
    let copies = softplus(opacity_logit) / -(-floor).ln_1p();
    // Says what is good: NaN is 1, and the conversion saturates.
    if copies >= 2.0 { copies as u32 } else { 1 }
}

/// Splits a Gaussian of opacity σ(`opacity_logit`) into `copies` equal ones (\[MCMC\] Eq. 9). 0 and 1 copies leave it
/// as it is. Logits beyond ±600 are taken as ±600; a NaN stays one.
///
/// The opacity is kept: 1 − (1−o′)^N = o, computed from ln(1−o) = −softplus(logit), so that neither o → 0 nor o → 1
/// loses digits.
#[must_use]
pub fn split(opacity_logit: f64, copies: u32) -> Split {
    if copies <= 1 || opacity_logit.is_nan() {
        return Split {
            opacity_logit,
            log_scale_offset: 0.0,
        };
    }
    let logit = opacity_logit.clamp(-LOGIT_LIMIT, LOGIT_LIMIT);
    // y = −ln(1−o′); o′ = −expm1(−y); o′/(1−o′) = expm1(y) = e^y·o′.
    let y = softplus(logit) / f64::from(copies);
    let opacity = -(-y).exp_m1();
    Split {
        opacity_logit: y + opacity.ln(),
        log_scale_offset: ln_sigmoid(logit) - ln_coefficient(opacity, copies),
    }
}

/// ln F(o′, N) by quadrature of the integral form above: o′ in (0, 1], N ≥ 1; relative error of F at most 1e-9 for
/// N ≤ 10,000 (measured: below 1e-10).
#[must_use]
pub fn ln_coefficient(opacity: f64, copies: u32) -> f64 {
    let n = f64::from(copies);
    let peak = (n * opacity).ln();
    let from = (peak - SATURATED.ln()).max(0.0).sqrt();
    let to = (peak.max(0.0) + NEGLIGIBLE).sqrt();
    let half = 0.5 * (to - from);
    let sum: f64 = nodes()
        .iter()
        .map(|&(x, weight)| {
            let t = from + half * (1.0 + x);
            let z = opacity * (-t * t).exp();
            -weight * (n * (-z).ln_1p()).exp_m1()
        })
        .sum();
    (FRAC_2_SQRT_PI * (from + half * sum)).ln()
}

/// Nodes and weights of the Gauss–Legendre rule on [−1, 1]: roots of the Legendre polynomial by Newton's method.
fn nodes() -> &'static [(f64, f64); NODES] {
    static RULE: OnceLock<[(f64, f64); NODES]> = OnceLock::new();
    RULE.get_or_init(|| {
        std::array::from_fn(|i| {
            // Tricomi's first guess; five Newton steps are two more than needed at this size.
            let mut x = (PI * (i as f64 + 0.75) / (NODES as f64 + 0.5)).cos();
            let mut slope = 1.0;
            for _ in 0..5 {
                let (value, derivative) = legendre(x);
                slope = derivative;
                x -= value / derivative;
            }
            (x, 2.0 / ((1.0 - x * x) * slope * slope))
        })
    })
}

/// The Legendre polynomial of degree [`NODES`] and its derivative at x in (−1, 1).
fn legendre(x: f64) -> (f64, f64) {
    let (mut before, mut current) = (1.0, x);
    for k in 2..=NODES {
        let k = k as f64;
        (before, current) = (
            current,
            ((2.0 * k - 1.0) * x * current - (k - 1.0) * before) / k,
        );
    }
    let derivative = NODES as f64 * (x * current - before) / (x * x - 1.0);
    (current, derivative)
}
