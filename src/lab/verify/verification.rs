//! [`Verification`]: the outcome of a suite.

use serde::Serialize;

use crate::device::Device;
use crate::lab::verify::check::Row;

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
    pub(super) fn of(device: &Device, suite: &'static str, cases: Vec<Row>) -> Self {
        let failed = cases.iter().filter(|r| !r.pass).count();
        Self {
            device: device.info().name.clone(),
            suite,
            passed: cases.len() - failed,
            failed,
            families: Vec::new(),
            cases,
        }
    }
}
