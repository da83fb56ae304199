//! Scalar functions and order statistics that several rooms use.

/// ln(1 + eˣ) without overflow or cancellation.
#[must_use]
pub fn softplus(x: f64) -> f64 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}

/// The logistic function 1/(1 + e⁻ˣ), without overflow.
#[must_use]
pub fn sigmoid(x: f64) -> f64 {
    // One exponential for both signs: which it is cannot be predicted.
    let e = (-x.abs()).exp();
    (if x >= 0.0 { 1.0 } else { e }) / (1.0 + e)
}

/// ln σ(x) = −softplus(−x).
#[must_use]
pub fn ln_sigmoid(x: f64) -> f64 {
    -softplus(-x)
}

/// The inverse of [`sigmoid`], ln(p/(1−p)), of a number between 0 and 1.
#[must_use]
pub fn logit(p: f64) -> f64 {
    p.ln() - (-p).ln_1p()
}

/// Median of the values, the mean of the middle two if their number is even; `None` without values.
#[must_use]
pub fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let sorted = sorted(values);
    let upper = *sorted.get(sorted.len() / 2)?;
    Some(f64::midpoint(sorted[(sorted.len() - 1) / 2], upper))
}

/// Median of the values, the upper of the middle two if their number is even; `None` without values.
#[must_use]
pub fn upper_median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let sorted = sorted(values);
    sorted.get(sorted.len() / 2).copied()
}

/// The values in ascending order (`f64::total_cmp`).
#[must_use]
pub fn sorted(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values
}

/// The sorted value at rank ⌊share · (n − 1)⌋, share in [0, 1]; `None` without values.
#[must_use]
pub fn order_statistic<T: Copy>(sorted: &[T], share: f64) -> Option<T> {
    let last = sorted.len().checked_sub(1)?;
    sorted.get((share * last as f64) as usize).copied()
}
