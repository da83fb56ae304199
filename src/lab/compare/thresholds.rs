//! PSNR values that runs are timed to.

use crate::base::error::{Error, Result};
use crate::lab::compare::group::Group;
use crate::lab::compare::load::Loaded;
use crate::lab::stats::Spread;

/// Largest PSNR that is accepted, dB.
pub const LIMIT: f64 = 200.0;
/// Most thresholds that a table can hold.
const MAX_COUNT: usize = 24;
/// Fewest whole values that need no halves.
const MIN_COUNT: usize = 4;
/// Rule of values that were asked for.
const GIVEN: &str = "Thresholds as given.";
/// Rule of the default values.
const RULE: &str = "Thresholds: every whole dB above the highest first evaluation of a group and up to the best PSNR of any \
                    (medians over its runs), every other one and so on where they are more than 24, every half dB where they \
                    are fewer than four.";

/// Refuses values that cannot be a PSNR.
///
/// # Errors
/// The first such value.
pub fn check(values: &[f64]) -> Result<()> {
    let within = |v: &f64| v.abs() <= LIMIT;
    match values.iter().find(|v| !within(v)) {
        None => Ok(()),
        Some(bad) => Err(Error::config(
            "--threshold",
            format!("{bad}; a number of dB within ±{LIMIT} expected"),
        )),
    }
}

/// Multiples of `step` above `low` and up to `high`.
fn steps(low: f64, high: f64, step: f64) -> Vec<f64> {
    let (first, last) = ((low / step).floor() + 1.0, (high / step).floor());
    let count = (last - first + 1.0).max(0.0) as usize;
    (0..count).map(|k| (first + k as f64) * step).collect()
}

/// Values between the highest first PSNR and the best one, rising: `(first, best)` of each group.
#[must_use]
pub fn between(ends: &[(f64, f64)]) -> Vec<f64> {
    let low = ends.iter().map(|e| e.0).fold(f64::NEG_INFINITY, f64::max);
    let best = ends.iter().map(|e| e.1).fold(f64::NEG_INFINITY, f64::max);
    if !(low < best && low.abs() <= LIMIT && best.abs() <= LIMIT) {
        return Vec::new();
    }
    let step = ((best - low) / MAX_COUNT as f64).ceil().max(1.0);
    let whole = steps(low, best, step);
    match whole.len() < MIN_COUNT {
        true => steps(low, best, 0.5),
        false => whole,
    }
}

/// Thresholds as asked for, else by the default rule; and the rule in words.
///
/// # Errors
/// Values that are no PSNR.
pub fn choose(groups: &[Group], asked: &[f64]) -> Result<(Vec<f64>, &'static str)> {
    check(asked)?;
    if !asked.is_empty() {
        let mut all = asked.to_vec();
        all.sort_by(f64::total_cmp);
        all.dedup();
        return Ok((all, GIVEN));
    }
    let median = |g: &Group, of: fn(&Loaded) -> Option<f64>| -> f64 {
        let values: Vec<f64> = g.runs.iter().filter_map(of).collect();
        Spread::of(&values).map_or(f64::NEG_INFINITY, |s| s.median)
    };
    let first = |r: &Loaded| r.rows.first()?.psnr;
    let best = |r: &Loaded| r.rows.iter().filter_map(|row| row.psnr).reduce(f64::max);
    let ends = groups.iter().map(|g| (median(g, first), median(g, best)));
    Ok((between(&ends.collect::<Vec<_>>()), RULE))
}
