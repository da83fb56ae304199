//! Power laws of time and memory over the number of Gaussians and of pixels.

use crate::lab::bench::record::{Case, Growth};
use crate::lab::bench::scene::SYNTHETIC;
use crate::lab::stats::{Spread, exponent, ratio};

/// Number of Gaussians that a ratio starts from, if it was measured.
const COMMON: f64 = 1e5;

/// One measured point: x, time, memory.
type Point = (f64, Spread, Spread);

fn point(case: &Case, x: f64) -> Point {
    let i = &case.iteration;
    // Memory is known, not sampled.
    let bytes = i.device_bytes as f64;
    let memory = Spread {
        median: bytes,
        min: bytes,
        max: bytes,
        samples: i.ms.samples,
    };
    (x, i.ms, memory)
}

/// Every power law that two or more of the synthetic cases allow: over N at each resolution, over pixels at each N.
#[must_use]
pub fn growth(cases: &[Case]) -> Vec<Growth> {
    let synthetic: Vec<&Case> = cases.iter().filter(|c| c.scene == SYNTHETIC).collect();
    let pixels = |c: &Case| f64::from(c.width) * f64::from(c.height);
    let mut sizes: Vec<u32> = synthetic.iter().map(|c| c.width).collect();
    let mut numbers: Vec<usize> = synthetic.iter().map(|c| c.gaussians).collect();
    sizes.sort_unstable();
    sizes.dedup();
    numbers.sort_unstable();
    numbers.dedup();
    let mut laws = Vec::new();
    for size in sizes {
        let with = synthetic.iter().filter(|c| c.width == size);
        let points = with.map(|c| point(c, c.gaussians as f64)).collect();
        push(
            &mut laws,
            points,
            "Gaussians",
            &format!("{size} × {size} px"),
        );
    }
    for n in numbers {
        let with = synthetic.iter().filter(|c| c.gaussians == n);
        let points = with.map(|c| point(c, pixels(c))).collect();
        push(&mut laws, points, "pixels", &format!("{n} Gaussians"));
    }
    laws
}

fn push(laws: &mut Vec<Growth>, mut points: Vec<Point>, with: &str, at: &str) {
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (Some(first), Some(last)) = (points.first(), points.last()) else {
        return;
    };
    let common = points.iter().find(|p| p.0 == COMMON && p.0 < last.0);
    let from = common.unwrap_or(first);
    for what in ["time", "memory"] {
        let figure = |p: &Point| if what == "time" { p.1 } else { p.2 };
        let series: Vec<(f64, Spread)> = points.iter().map(|p| (p.0, figure(p))).collect();
        let ratio = ratio(&figure(last), &figure(from));
        if let (Some(exponent), Some(ratio)) = (exponent(&series), ratio) {
            laws.push(Growth {
                what: format!("{what} with {with}, {at}"),
                points: points.len(),
                exponent,
                between: [from.0, last.0],
                ratio,
            });
        }
    }
}
