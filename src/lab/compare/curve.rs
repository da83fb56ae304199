//! A quantity over a clock: when it first reaches a value, and several such curves as one with a band.

use serde::Serialize;

use crate::lab::stats::Spread;

/// Points of a common grid.
const GRID: usize = 120;

/// Points (clock, value), the clock never falling. Holds finite points only.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Curve(Vec<(f64, f64)>);

/// The time at which a curve first reached a value.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Crossing {
    /// Clock, interpolated between two evaluations.
    pub at: f64,
    /// True if it was there at the first evaluation already, so that the true time is `at` or earlier.
    pub at_most: bool,
}

impl Curve {
    /// A curve of points in any order; those that are not finite are left out.
    #[must_use]
    pub fn new(points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        let finite = |p: &(f64, f64)| p.0.is_finite() && p.1.is_finite();
        let mut points: Vec<_> = points.into_iter().filter(finite).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        Self(points)
    }

    /// The points.
    #[must_use]
    pub fn points(&self) -> &[(f64, f64)] {
        &self.0
    }

    /// The last value.
    #[must_use]
    pub fn last(&self) -> Option<f64> {
        self.0.last().map(|p| p.1)
    }

    /// The first time at which the curve is at `value` or above, linear between its points; `None` if no point is.
    /// A curve that falls below it later has reached it all the same.
    #[must_use]
    pub fn first_reaches(&self, value: f64) -> Option<Crossing> {
        let found = self.0.iter().position(|p| p.1 >= value)?;
        let above = self.0[found];
        let Some(below) = found.checked_sub(1).map(|i| self.0[i]) else {
            return Some(Crossing {
                at: above.0,
                at_most: true,
            });
        };
        let share = (value - below.1) / (above.1 - below.1);
        Some(Crossing {
            at: below.0 + share * (above.0 - below.0),
            at_most: false,
        })
    }

    /// The value at `at`, linear between the points; `None` outside of them.
    #[must_use]
    pub fn value(&self, at: f64) -> Option<f64> {
        let after = self.0.iter().position(|p| p.0 >= at)?;
        let b = self.0[after];
        if b.0 == at {
            return Some(b.1);
        }
        let a = self.0[after.checked_sub(1)?];
        Some(a.1 + (at - a.0) / (b.0 - a.0) * (b.1 - a.1))
    }
}

/// Median and range of several curves on a common grid, over the span that all of them cover: (clock, spread), rising. Empty
/// if there is no such span. One curve is its own points.
#[must_use]
pub fn band(curves: &[Curve]) -> Vec<(f64, Spread)> {
    let spread = |at: f64| -> Option<(f64, Spread)> {
        let values: Option<Vec<f64>> = curves.iter().map(|c| c.value(at)).collect();
        Some((at, Spread::of(&values?)?))
    };
    if let [one] = curves {
        return one.0.iter().filter_map(|p| spread(p.0)).collect();
    }
    let span = |c: &Curve| Some((c.0.first()?.0, c.0.last()?.0));
    let Some(spans) = curves.iter().map(span).collect::<Option<Vec<_>>>() else {
        return Vec::new();
    };
    let from = spans.iter().map(|s| s.0).fold(f64::NEG_INFINITY, f64::max);
    let to = spans.iter().map(|s| s.1).fold(f64::INFINITY, f64::min);
    if !(from < to && from.is_finite() && to.is_finite()) {
        return Vec::new();
    }
    let step = |i: usize| match i {
        i if i == GRID => to,
        i => from + (to - from) * i as f64 / GRID as f64,
    };
    (0..=GRID).filter_map(|i| spread(step(i))).collect()
}
