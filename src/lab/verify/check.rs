//! Comparison of every quantity of a pass with the reference, and [`Verification`], the outcome of a suite.

use std::collections::HashSet;

use serde::Serialize;

use crate::device::Device;
use crate::device::tuning::Tuning;
use crate::lab::error::{Report, Tolerance, compare, measure};
use crate::lab::verify::cases::Case;
use crate::lab::verify::pass::{Outcome, Quantity};

/// Bound on f64 kernels: rounding of f64 through the longest stage, with room for its condition.
pub const EXACT: f64 = 1e-10;
/// Share of elements that may fall on the other side of a discontinuity in f32 (the alpha cut, tile edges, a sign).
pub const FLIP_SHARE: f64 = 0.01;
/// Gaussians that may be flagged wrongly as seen or unseen in f32, in scenes too small for [`FLIP_SHARE`]: a single pixel at the
/// alpha cut may show one.
pub const FLAG_FLIPS: usize = 1;

/// One line of the table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Family of cases.
    pub family: &'static str,
    /// Case.
    pub case: String,
    /// Stage.
    pub stage: &'static str,
    /// Quantity and precision.
    pub quantity: String,
    /// Stiffness of the case in the unit of its family (suite "stress").
    pub stiffness: Option<f64>,
    /// Largest error (flips left out) over the largest wanted value.
    pub max_rel_error: f64,
    /// Median error, likewise.
    pub median_rel_error: f64,
    /// Bound on the largest error.
    pub bound: f64,
    /// Values that are not finite.
    pub non_finite: usize,
    /// Elements beyond the bound that a discontinuity excuses.
    pub flips: usize,
    /// True if every bound was kept.
    pub pass: bool,
}

impl Row {
    /// Numbers that were compared on the host: family and stage, case and quantity; `errors` are relative already.
    pub(super) fn of_errors(
        [family, stage]: [&'static str; 2],
        [case, quantity]: [&str; 2],
        stiffness: f64,
        errors: &[f64],
        bound: f64,
    ) -> Self {
        let report = measure(errors, &vec![0.0; errors.len()], bound, 0.0);
        Self {
            family,
            case: case.into(),
            stage,
            quantity: quantity.into(),
            stiffness: Some(stiffness),
            max_rel_error: report.largest,
            median_rel_error: report.median,
            bound,
            non_finite: report.non_finite,
            flips: 0,
            pass: report.non_finite + report.flips == 0 && !errors.is_empty(),
        }
    }
}

/// Name, axis and bound of a family of cases.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FamilyNote {
    /// Name.
    pub name: &'static str,
    /// Measure of the stiffness.
    pub axis: &'static str,
    /// Bound on the f32 errors, relative to the largest value of a quantity.
    pub bound: f64,
    /// Reason for that bound.
    pub reason: &'static str,
}

/// Outcome of a suite on one device.
#[derive(Debug, Clone, Serialize)]
pub struct Verification {
    /// Device name.
    pub device: String,
    /// Sizes that its kernels were built with.
    pub tuning: Tuning,
    /// Suite.
    pub suite: &'static str,
    /// Families of the cases (suite "stress").
    pub families: Vec<FamilyNote>,
    /// One row per case, stage and quantity.
    pub cases: Vec<Row>,
    /// Rows within their bounds.
    pub passed: usize,
    /// Rows that missed a bound.
    pub failed: usize,
}

impl Verification {
    /// A verification without families.
    pub(super) fn new(device: &Device, suite: &'static str, cases: Vec<Row>) -> Self {
        let failed = cases.iter().filter(|r| !r.pass).count();
        Self {
            device: device.info().name.clone(),
            tuning: device.tuning(),
            suite,
            passed: cases.len() - failed,
            failed,
            families: Vec::new(),
            cases,
        }
    }
}

/// True if decisions at a discontinuity (the alpha cut, the last layer of a pixel, a tile's edge, the sign in L1) reach a
/// quantity, so that in f32 a few of its elements may differ by more than rounding.
fn has_flips(stage: &str, name: &str) -> bool {
    match stage {
        "project" => name == "pixel bounds",
        "scan" | "bin" | "sort" | "splat" | "splat_grad" | "project_grad" | "seen" => true,
        "loss" => name != "L1, SSIM",
        _ => false,
    }
}

/// Number of differences of tile lists, each closed by −1: pairs that only one side has, and places at which the common ones
/// are in another order.
fn list_flips(got: &[f64], want: &[f64]) -> usize {
    let tiles = |v: &[f64]| -> Vec<Vec<i64>> {
        v.split(|g| *g < 0.0)
            .map(|t| t.iter().map(|g| *g as i64).collect())
            .collect()
    };
    let (a, b) = (tiles(got), tiles(want));
    let in_tile = |(a, b): (&Vec<i64>, &Vec<i64>)| {
        let common = |x: &[i64], y: &[i64]| -> Vec<i64> {
            let y: HashSet<i64> = y.iter().copied().collect();
            x.iter().copied().filter(|g| y.contains(g)).collect()
        };
        let (left, right) = (common(a, b), common(b, a));
        let moved = left.iter().zip(&right).filter(|(x, y)| x != y).count();
        a.len() - left.len() + b.len() - right.len() + moved + left.len().abs_diff(right.len())
    };
    a.iter().zip(&b).map(in_tile).sum::<usize>() + a.len().abs_diff(b.len())
}

/// Number of places at which two lists of flags differ.
fn mismatches(got: &[f64], want: &[f64]) -> usize {
    let differ = got.iter().zip(want).filter(|(g, w)| g != w).count();
    differ + got.len().abs_diff(want.len())
}

/// Numbers of a quantity without those of invalid Gaussians; the case has `n`.
fn valid(q: &Quantity, values: &[f64], n: usize, invalid: &[usize]) -> Vec<f64> {
    let per = values.len() / n.max(1);
    let owner = |at: usize| match q.stage {
        // One Gaussian after the other.
        "filter" | "project" | "splat_grad" => Some(at / per.max(1)),
        // Plane by plane.
        "project_grad" | "adam" | "noise" | "screen_grad" | "seen" | "importance" | "edit" => {
            Some(at % n)
        }
        _ => None,
    };
    let kept = |at: &usize| !owner(*at).is_some_and(|i| invalid.contains(&i));
    (0..values.len())
        .filter(kept)
        .map(|at| values[at])
        .collect()
}

/// Compares every quantity of one pass with the reference. `bound` applies to each, but for [`Case::error_map_bound`]; in f32 a share
/// of the elements behind a discontinuity (of flags at least [`FLAG_FLIPS`]) may be flips, in f64 none.
#[must_use]
pub fn check(case: &Case, out: &Outcome, precision: &str, bound: f64) -> Vec<Row> {
    let row = |q: &Quantity| row(case, q, bound, precision);
    out.quantities.iter().map(row).collect()
}

/// The comparison of one quantity.
fn row(case: &Case, q: &Quantity, bound: f64, precision: &str) -> Row {
    let of = |values: &[f64]| valid(q, values, case.splats.len(), &case.invalid);
    let (got, want, single) = (of(&q.got), of(&q.want), bound > EXACT);
    let bound = match case.error_map_bound {
        Some(own) if single && q.name == "error maps" => own,
        _ => bound,
    };
    let flips = if single && has_flips(q.stage, q.name) {
        (FLIP_SHARE * want.len() as f64) as usize
    } else {
        0
    };
    // Number of elements of lists and flags that differ, and the largest that may.
    let counted = match (q.stage, q.name) {
        (_, "tile lists") => Some((list_flips(&got, &want), flips)),
        ("seen", _) if single => Some((mismatches(&got, &want), flips.max(FLAG_FLIPS))),
        ("seen", _) => Some((mismatches(&got, &want), 0)),
        _ => None,
    };
    let (pass, report) = if let Some((found, most)) = counted {
        let report = Report {
            flips: found,
            ..Report::default()
        };
        (found <= most, report)
    } else {
        let mut tolerance = Tolerance {
            floor: q.floor,
            ..Tolerance::all(bound)
        };
        if flips > 0 {
            tolerance = tolerance.with_flips(flips, 0.05_f64.max(bound));
        }
        let report = measure(&got, &want, bound, q.floor);
        (compare(&got, &want, tolerance).is_ok(), report)
    };
    Row {
        family: case.family,
        case: case.name.clone(),
        stage: q.stage,
        quantity: format!("{} ({precision})", q.name),
        stiffness: None,
        // An error that no flip excuses counts, however large.
        max_rel_error: if pass { report.max } else { report.largest },
        median_rel_error: report.median,
        bound,
        non_finite: report.non_finite,
        flips: report.flips,
        pass,
    }
}
