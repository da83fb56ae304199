//! Curves of a run for those who watch it: few points, however long the run is.

use serde::Serialize;

/// Largest number of points of a curve.
const MOST: usize = 1000;

/// Values over iterations. When there are too many, every second one goes, and the next ones come half as often.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Curve {
    points: Vec<(u32, f64)>,
    /// Iterations between two points at least.
    gap: u32,
}

impl Curve {
    /// Adds a finite value unless the last one is too near.
    pub fn push(&mut self, iteration: u32, value: f64) {
        let early = |last: &(u32, f64)| iteration < last.0 + self.gap.max(1);
        if !value.is_finite() || self.points.last().is_some_and(early) {
            return;
        }
        self.points.push((iteration, value));
        if self.points.len() > MOST {
            let last = self.points.len() - 1;
            let kept = self.points.iter().enumerate();
            let kept = kept.filter(|(k, _)| (last - k).is_multiple_of(2));
            self.points = kept.map(|(_, p)| *p).collect();
            let span = iteration - self.points[0].0;
            self.gap = (span / (MOST as u32 / 2)).max(1);
        }
    }

    /// The last value.
    pub fn last(&self) -> Option<f64> {
        self.points.last().map(|p| p.1)
    }

    /// Points after an iteration.
    fn since(&self, iteration: Option<u32>) -> &[(u32, f64)] {
        let first = iteration.map_or(0, |at| self.points.partition_point(|p| p.0 <= at));
        &self.points[first..]
    }
}

/// The curves of a run.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Curves {
    pub loss: Curve,
    pub psnr: Curve,
    pub gaussians: Curve,
}

/// Points of the curves as JSON has them.
#[derive(Serialize)]
pub(super) struct Points<'a> {
    loss: &'a [(u32, f64)],
    psnr: &'a [(u32, f64)],
    gaussians: &'a [(u32, f64)],
}

impl Curves {
    /// The points after an iteration.
    pub fn since(&self, iteration: Option<u32>) -> Points<'_> {
        Points {
            loss: self.loss.since(iteration),
            psnr: self.psnr.since(iteration),
            gaussians: self.gaussians.since(iteration),
        }
    }
}
