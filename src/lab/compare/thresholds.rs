//! PSNR values that runs are timed to.

use crate::base::error::{Error, Result};
use crate::lab::compare::group::Group;
use crate::lab::compare::load::Loaded;
use crate::lab::stats::Spread;

/// Largest PSNR that is accepted, dB.
pub const LIMIT: f64 = 200.0;
/// Most thresholds that a table can hold.
const MAX_COUNT: usize = 24;
/// Fewest whole values that need no halves near the end.
const MIN_COUNT: usize = 4;
/// Rule of values that were asked for.
const GIVEN: &str = "Thresholds as given.";
/// Rule of the default values.
const RULE: &str = "Thresholds: every whole dB above the highest first evaluation of a group and up to the best PSNR of any \
                    (medians over its runs), every other one and so on where they are more than 24; where they are fewer \
                    than four, half dB, too, within the last 1 dB below the best of the reference and below that of the others.";

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

/// Values between the highest first PSNR and the best one: `(first, best)` of each group. In no order, and some twice.
#[must_use]
pub fn between(ends: &[(f64, f64)], reference: usize) -> Vec<f64> {
    let highest = |pick: &dyn Fn(usize) -> Option<f64>| {
        let all = (0..ends.len()).filter_map(pick);
        all.fold(f64::NEG_INFINITY, f64::max)
    };
    let low = highest(&|k| Some(ends[k].0));
    let best = highest(&|k| Some(ends[k].1));
    if !(low < best && low.abs() <= LIMIT && best.abs() <= LIMIT) {
        return Vec::new();
    }
    let step = ((best - low) / MAX_COUNT as f64).ceil().max(1.0);
    let mut all = steps(low, best, step);
    if all.len() < MIN_COUNT {
        let own = ends.get(reference).map_or(best, |e| e.1);
        let others = highest(&|k| Some(ends[k].1).filter(|_| k != reference));
        for end in [own, others].into_iter().filter(|e| e.is_finite()) {
            all.extend(steps(low.max(end - 1.0), end, 0.5));
        }
    }
    all
}

/// Thresholds as asked for, else by the default rule; and the rule in words.
///
/// # Errors
/// Values that are no PSNR.
pub fn choose(
    groups: &[Group],
    reference: usize,
    asked: &[f64],
) -> Result<(Vec<f64>, &'static str)> {
    check(asked)?;
    let median = |g: &Group, of: fn(&Loaded) -> Option<f64>| -> Option<f64> {
        let values: Vec<f64> = g.runs.iter().filter_map(of).collect();
        Some(Spread::of(&values)?.median)
    };
    let first = |r: &Loaded| r.rows.first()?.psnr;
    let best = |r: &Loaded| r.rows.iter().filter_map(|row| row.psnr).reduce(f64::max);
    let (mut all, rule) = match asked.is_empty() {
        false => (asked.to_vec(), GIVEN),
        true => {
            let none = (f64::NEG_INFINITY, f64::NEG_INFINITY);
            let end = |g: &Group| median(g, first).zip(median(g, best)).unwrap_or(none);
            let ends: Vec<_> = groups.iter().map(end).collect();
            (between(&ends, reference), RULE)
        }
    };
    all.sort_by(f64::total_cmp);
    all.dedup();
    Ok((all, rule))
}
