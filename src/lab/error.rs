//! Comparison of two results: NaN is rejected first, then four numbers, each with a bound.

/// Bounds of a comparison. Errors are relative to the largest wanted value of the array (a scale that does not vanish
/// where single values do).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tolerance {
    /// Largest difference of an element over the largest wanted magnitude.
    pub element: f64,
    /// ‖got − want‖ / ‖want‖.
    pub l2: f64,
    /// 1 − cosine of the angle between the two.
    pub cosine: f64,
    /// Number of elements that may miss the element bound (a decision at a discontinuity fell the other way).
    pub flips: usize,
    /// Least scale of relative errors: the size of the terms of an array's values, for values that cancel to nothing.
    pub floor: f64,
}

impl Tolerance {
    /// The same bound for the element and the norm, its square for the angle, no flips.
    #[must_use]
    pub const fn all(bound: f64) -> Self {
        Self {
            element: bound,
            l2: bound,
            cosine: bound * bound + 1e-14,
            flips: 0,
            floor: 0.0,
        }
    }

    /// The same bounds with some flips, which then also count in the norm and the angle.
    #[must_use]
    pub const fn with_flips(self, flips: usize, l2: f64) -> Self {
        Self {
            flips,
            l2,
            cosine: l2 * l2,
            ..self
        }
    }
}

/// Numbers of a comparison.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Report {
    /// Largest element error that is no flip.
    pub max: f64,
    /// Largest element error.
    pub largest: f64,
    /// Median element error.
    pub median: f64,
    /// Relative L2 error.
    pub l2: f64,
    /// 1 − cosine.
    pub cosine: f64,
    /// Elements beyond the element bound.
    pub flips: usize,
    /// Values that are not finite.
    pub non_finite: usize,
}

/// Compares `got` with `want` and judges the difference.
///
/// # Errors
/// A sentence that names the bound that is missed: lengths, values that are not finite, an element, the norm, the angle, or a
/// result that is all zero.
pub fn compare(got: &[f64], want: &[f64], tolerance: Tolerance) -> Result<Report, String> {
    let report = measure(got, want, tolerance.element, tolerance.floor);
    if got.len() != want.len() {
        return Err(format!("{} values; {} expected", got.len(), want.len()));
    }
    if report.non_finite > 0 {
        return Err(format!("{} values are not finite", report.non_finite));
    }
    if report.flips > tolerance.flips {
        return Err(format!(
            "{} elements beyond {:e} of the largest; {} may be",
            report.flips, tolerance.element, tolerance.flips
        ));
    }
    let counts = |v: &f64| v.abs() > tolerance.element * tolerance.floor;
    if want.iter().any(counts) && got.iter().all(|v| *v == 0.0) {
        return Err("silently zero".into());
    }
    for (name, value, allowed) in [
        ("relative L2 error", report.l2, tolerance.l2),
        ("1 - cosine", report.cosine, tolerance.cosine),
    ] {
        if value > allowed {
            return Err(format!("{name} {value:e}; {allowed:e} allowed"));
        }
    }
    Ok(report)
}

/// Numbers of a comparison without a verdict; an error above `element` is a flip, errors are relative to `floor` at least.
#[must_use]
pub fn measure(got: &[f64], want: &[f64], element: f64, floor: f64) -> Report {
    let non_finite = got.iter().chain(want).filter(|v| !v.is_finite()).count();
    let largest = want.iter().fold(floor, |m, v| m.max(v.abs()));
    let scale = if largest > 0.0 { largest } else { 1.0 };
    let pairs = || got.iter().zip(want).map(|(g, w)| (g / scale, w / scale));
    let mut errors: Vec<f64> = pairs().map(|(g, w)| (g - w).abs()).collect();
    errors.sort_by(f64::total_cmp);
    let a = pairs().map(|(g, _)| g * g).sum::<f64>().sqrt();
    let b = pairs().map(|(_, w)| w * w).sum::<f64>().sqrt();
    let l2 = errors.iter().map(|e| e * e).sum::<f64>().sqrt();
    // Half of the squared distance of the unit vectors: 1 − their product would lose every small angle.
    let apart = pairs().map(|(g, w)| (g / a - w / b).powi(2)).sum::<f64>();
    let within = |e: &&f64| **e <= element;
    Report {
        max: errors.iter().rfind(within).copied().unwrap_or(0.0),
        largest: errors.last().copied().unwrap_or(0.0),
        median: errors.get(errors.len() / 2).copied().unwrap_or(0.0),
        l2: l2 / if b > 0.0 { b.max(floor / scale) } else { 1.0 },
        // What is below the floor has no direction.
        cosine: if a > 0.0 && b > floor / scale {
            0.5 * apart
        } else {
            0.0
        },
        flips: errors.iter().filter(|e| !within(e)).count(),
        non_finite,
    }
}
