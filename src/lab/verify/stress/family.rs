//! [`Family`]: cases along one measure of stiffness, and the parts that all families share.

use glam::DVec3;

use crate::base::rng::{Philox, Stream};
use crate::lab::verify::cases::{Case, mild};
use crate::lab::verify::check::Row;
use crate::lab::verify::verification::FamilyNote;
use crate::scene::{Gaussians, Plane};

/// A case and its stiffness.
#[derive(Debug, Clone)]
pub struct Stiff {
    /// Stiffness in the unit of the family's axis, > 0.
    pub stiffness: f64,
    /// The case.
    pub case: Case,
}

/// Cases along one measure of stiffness.
#[derive(Debug, Clone)]
pub struct Family {
    /// Name, axis and bound.
    pub note: FamilyNote,
    /// Cases in the order of rising stiffness.
    pub cases: Vec<Stiff>,
}

/// f32 rounding through the longest stage, where no term cancels another.
pub const WELL: f64 = 1e-5;
/// f32 rounding with the small differences that positions and scales of several sizes beside each other leave.
pub const MIXED: f64 = 1e-4;

/// Four uniform numbers of Gaussian `i`.
pub fn uniform(seed: u64, i: usize) -> [f64; 4] {
    Philox::uniform(seed, Stream::Synthetic.stream(1), i as u64)
}

/// A mild scene of which every Gaussian is changed.
pub fn each(
    name: &str,
    n: usize,
    size: [u32; 2],
    seed: u64,
    change: impl Fn(&mut Gaussians, usize, &Case),
) -> Case {
    let base = mild(name, n, size, 1, seed);
    let mut case = base.clone();
    for i in 0..n {
        change(&mut case.splats, i, &base);
    }
    case
}

/// A family of (stiffness, case).
pub fn family(
    name: &'static str,
    axis: &'static str,
    bound: f64,
    reason: &'static str,
    cases: impl IntoIterator<Item = (f64, Case)>,
) -> Family {
    Family {
        note: FamilyNote {
            name,
            axis,
            bound,
            reason,
        },
        cases: cases
            .into_iter()
            .map(|(stiffness, case)| Stiff { stiffness, case })
            .collect(),
    }
}

/// Powers of ten, every `step`th of a range of exponents.
pub fn powers(range: std::ops::RangeInclusive<i32>, step: usize) -> impl Iterator<Item = f64> {
    range.step_by(step).map(|e| 10f64.powi(e))
}

/// Position of Gaussian `i`.
pub fn position(s: &Gaussians, i: usize) -> DVec3 {
    DVec3::from_array(s.gather::<3>(Plane::POSITION, i).map(f64::from))
}

/// A row of numbers that were compared on the host: `errors` are relative already.
pub fn host_row(
    family: &str,
    case: &str,
    stage: &'static str,
    quantity: &str,
    stiffness: f64,
    errors: &[f64],
    bound: f64,
) -> Row {
    let non_finite = errors.iter().filter(|e| !e.is_finite()).count();
    let mut finite: Vec<f64> = errors.iter().copied().filter(|e| e.is_finite()).collect();
    finite.sort_by(f64::total_cmp);
    let max = finite.last().copied().unwrap_or(0.0);
    Row {
        family: family.into(),
        case: case.into(),
        stage,
        quantity: quantity.into(),
        stiffness: Some(stiffness),
        max_rel_error: max,
        median_rel_error: finite.get(finite.len() / 2).copied().unwrap_or(0.0),
        bound,
        non_finite,
        flips: 0,
        pass: non_finite == 0 && !errors.is_empty() && max <= bound,
    }
}
