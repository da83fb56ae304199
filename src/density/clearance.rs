//! Free space about the training cameras.
//!
//! A training view punishes what stands right before its camera only within its own picture. Beside, behind and between the cameras a
//! Gaussian may stay that serves views from afar, and a camera that is put there, a held-out one or a viewer's, sees nothing else. Nobody
//! photographs from within an object, and the nearest sparse points tell how far the nearest object is.

use rayon::prelude::*;
use rustc_hash::FxHashMap;

/// One in so many points may be nearer to a camera than the distance that counts: some are wrong.
const NEAREST: usize = 1000;

/// Points that are looked at, evenly spread over the file.
const MAX_POINTS: usize = 100_000;

/// Balls about cameras.
#[derive(Debug, Clone)]
pub struct Clearance {
    /// Centres and squared radii, those of radius 0 left out.
    balls: Vec<([f32; 3], f32)>,
    /// Edge of the cells: the median radius, or a quarter of the largest, so that no ball reaches into more than 9 × 9 × 9 of them.
    edge: f32,
    /// Balls that reach into a cell, by its coordinates.
    cells: FxHashMap<[i32; 3], Vec<u32>>,
}

/// Radius of the ball about each of some cameras: `share` of the distance to the nearest points, one in 1000 of them left out; 0 without points. In the unit of
/// `centers` and `points`.
#[must_use]
pub fn radii(centers: &[[f32; 3]], points: &[[f32; 3]], share: f64) -> Vec<f32> {
    let step = points.len().div_ceil(MAX_POINTS).max(1);
    let sampled: Vec<[f32; 3]> = points.iter().copied().step_by(step).collect();
    let nth = sampled.len() / NEAREST;
    let radius = |center: &[f32; 3]| {
        let mut squares: Vec<f32> = sampled.iter().map(|p| square(*p, *center)).collect();
        if squares.is_empty() {
            return 0.0;
        }
        let (_, square, _) = squares.select_nth_unstable_by(nth, f32::total_cmp);
        let radius = share * f64::from(*square).sqrt();
        if radius.is_finite() {
            radius as f32
        } else {
            0.0
        }
    };
    centers.par_iter().map(radius).collect()
}

/// Square of the distance of two points.
fn square(a: [f32; 3], b: [f32; 3]) -> f32 {
    (0..3).map(|k| (a[k] - b[k]) * (a[k] - b[k])).sum()
}

impl Clearance {
    /// Balls of some radii about some centres, both of one length; where a radius is missing there is no ball.
    #[must_use]
    pub fn new(centers: &[[f32; 3]], radii: &[f32]) -> Self {
        let mut sorted: Vec<f32> = radii.iter().copied().filter(|r| *r > 0.0).collect();
        sorted.sort_by(f32::total_cmp);
        let median = sorted.get(sorted.len() / 2).copied().unwrap_or(1.0);
        let largest = sorted.last().copied().unwrap_or(1.0);
        let mut clearance = Self {
            balls: Vec::new(),
            edge: median.max(largest / 4.0),
            cells: FxHashMap::default(),
        };
        for (center, radius) in centers.iter().zip(radii).filter(|(_, r)| **r > 0.0) {
            let ball = clearance.balls.len() as u32;
            clearance.balls.push((*center, radius * radius));
            let radius = f64::from(*radius);
            let corner = |sign: f64| center.map(|c| f64::from(c) + sign * radius);
            let [from, to] = [-1.0, 1.0].map(|sign| clearance.cell(corner(sign)));
            for x in from[0]..=to[0] {
                for y in from[1]..=to[1] {
                    for z in from[2]..=to[2] {
                        clearance.cells.entry([x, y, z]).or_default().push(ball);
                    }
                }
            }
        }
        clearance
    }

    /// True if there is no ball.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.balls.is_empty()
    }

    /// True if a position lies within a ball; false if it is not finite.
    #[must_use]
    pub fn holds(&self, position: [f32; 3]) -> bool {
        let inside = |ball: &u32| {
            let (center, radius) = self.balls[*ball as usize];
            square(position, center) < radius
        };
        let near = self.cells.get(&self.cell(position.map(f64::from)));
        near.is_some_and(|balls| balls.iter().any(inside))
    }

    /// The cell of a position; the conversion saturates.
    fn cell(&self, position: [f64; 3]) -> [i32; 3] {
        position.map(|v| (v / f64::from(self.edge)).floor() as i32)
    }
}

#[cfg(test)]
mod tests {
    use super::{Clearance, radii, square};
    use crate::base::rng::Philox;

    fn cloud(n: u64, stream: u64, size: f64) -> Vec<[f32; 3]> {
        let at = |i| {
            let [x, y, z, _] = Philox::normal(5, stream, i);
            [x, y, z].map(|v| (size * v) as f32)
        };
        (0..n).map(at).collect()
    }

    #[test]
    fn cells_find_what_a_search_of_all_balls_finds() {
        let (centers, positions) = (cloud(60, 1, 1.0), cloud(20_000, 2, 1.5));
        let radii: Vec<f32> = (0..60).map(|i| 0.01 * (i % 30) as f32).collect();
        let clearance = Clearance::new(&centers, &radii);
        let all = |p: [f32; 3]| {
            let mut balls = centers.iter().zip(&radii);
            balls.any(|(c, r)| square(p, *c) < r * r)
        };
        let held = positions.iter().filter(|p| clearance.holds(**p)).count();
        assert!(held > 100 && held < 19_000, "{held}");
        assert!(positions.iter().any(|p| clearance.holds(*p) && p[0] < -0.5));
        assert!(positions.iter().all(|p| clearance.holds(*p) == all(*p)));
        assert!(!clearance.holds([f32::NAN, 0.0, 0.0]));
        assert!(!clearance.holds([f32::INFINITY; 3]));
    }

    #[test]
    fn balls_of_any_size_are_looked_up_at_once() {
        let far = [[1e30, -1e30, 0.0], [0.0; 3], [-3e38, 0.0, 0.0]];
        for radii in [
            [1e-30, 1e30, 0.1],
            [f32::MAX; 3],
            [f32::INFINITY, 0.1, 0.1],
            [f32::NAN, -1.0, 0.1],
        ] {
            let clearance = Clearance::new(&far, &radii);
            assert!(!clearance.holds([f32::NAN; 3]));
            let cells: usize = clearance.cells.values().map(Vec::len).sum();
            assert!(cells <= 3 * 9 * 9 * 9, "{radii:?}: {cells}");
        }
    }

    #[test]
    fn no_radius_holds_nothing() {
        let centers = cloud(3, 1, 1.0);
        for radii in [Vec::new(), vec![0.0; 3]] {
            let clearance = Clearance::new(&centers, &radii);
            assert!(clearance.is_empty() && !clearance.holds(centers[0]));
        }
    }

    #[test]
    fn wrong_points_right_before_a_camera_do_not_shrink_its_ball() {
        let mut points = vec![[4.0, 0.0, 0.0]; 9_990];
        points.extend([[0.01, 0.0, 0.0]; 10]);
        assert_eq!(radii(&[[0.0; 3]], &points, 0.5), [2.0]);
        points.extend([[0.01, 0.0, 0.0]; 10]);
        assert!(radii(&[[0.0; 3]], &points, 0.5)[0] < 0.01);
        assert_eq!(radii(&[[0.0; 3]], &[], 0.5), [0.0]);
    }
}
