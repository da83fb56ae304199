//! Free space about the training cameras, and from one to the next.
//!
//! A training view punishes what stands right before its camera only within its own picture. Beside, behind and between the cameras a
//! Gaussian may stay that serves views from afar, and a camera that is put there, a held-out one or a viewer's, sees nothing else. Nobody
//! photographs from within an object, and the nearest sparse points tell how far the nearest object is.

use rayon::prelude::*;
use rustc_hash::FxHashMap;

use crate::scene::knn::nearest;

/// One in so many points may be nearer to a camera than the distance that counts: some are wrong.
const NEAREST: usize = 1000;

/// Points that are looked at, evenly spread over the file.
const MAX_POINTS: usize = 100_000;

/// The space between a camera and so many neighbours is free, too, where they are no further apart than this part of the distance of the nearest
/// points: whoever took the photos went there, and held-out cameras stand there.
const NEIGHBOURS: usize = 4;
const APART: f64 = 0.9;

/// Largest distance of neighbours over the smaller radius: so many balls and no more lie between them, however small a share is asked for.
const LONGEST: f64 = 16.0;

/// Balls about cameras and in the passages between them.
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

/// A centre and a radius.
type Ball = ([f32; 3], f32);

/// Balls along the segments between neighbouring centres, no further apart than half of the smaller of the two radii.
fn passages(centers: &[[f32; 3]], radii: &[f32], share: f64) -> Vec<Ball> {
    let places = places(centers, radii);
    let centers: Vec<[f32; 3]> = places.iter().map(|(center, _)| *center).collect();
    let ends = (0_u32..).zip(nearest::<NEIGHBOURS>(&centers));
    let mut pairs: Vec<[u32; 2]> = ends
        .flat_map(|(i, near)| near.map(|n| [i.min(n.point), i.max(n.point)]))
        .filter(|[_, b]| (*b as usize) < centers.len())
        .collect();
    pairs.sort_unstable();
    pairs.dedup();
    // A point as far from both ends as their nearest ones is outside of all balls between them, by a margin.
    let longest = APART.min(1.9 * (1.0 - share * share).max(0.0).sqrt()) / share.max(1e-9);
    let balls = |ends: [u32; 2]| {
        let [(a, radius_a), (b, radius_b)] = ends.map(|i| places[i as usize]);
        let (distance, least) = (distance(a, b), f64::from(radius_a.min(radius_b)));
        let parts = match distance <= longest.min(LONGEST) * least {
            true => 2 * (distance / least).ceil() as u32,
            false => 0,
        };
        (1..parts).map(move |k| {
            let at = k as f32 / parts as f32;
            let mix = |from: f32, to: f32| from + at * (to - from);
            ([0, 1, 2].map(|k| mix(a[k], b[k])), mix(radius_a, radius_b))
        })
    };
    pairs.into_iter().flat_map(balls).collect()
}

/// Centres with a radius, but for those nearer to one before than half of the smaller of the two radii, as most views of a panorama or a rig: balls so near have
/// no waist.
fn places(centers: &[[f32; 3]], radii: &[f32]) -> Vec<Ball> {
    let edge = 0.5 * f64::from(median(radii));
    let mut places: Vec<Ball> = Vec::new();
    let mut cells: FxHashMap<[i64; 3], Vec<u32>> = FxHashMap::default();
    for (center, radius) in centers.iter().copied().zip(radii.iter().copied()) {
        if !(radius > 0.0 && center.iter().all(|v| v.is_finite())) {
            continue;
        }
        let cell = center.map(|v| (f64::from(v) / edge).floor() as i64);
        let beside =
            |k: i64| [0, 1, 2].map(|d| cell[d].saturating_add(k / 3_i64.pow(d as u32) % 3 - 1));
        let taken = |of: &u32| {
            let (other, other_radius) = places[*of as usize];
            distance(center, other) < 0.5 * f64::from(radius.min(other_radius))
        };
        let mut near = (0..27).filter_map(|k| cells.get(&beside(k))).flatten();
        if !near.any(taken) {
            cells.entry(cell).or_default().push(places.len() as u32);
            places.push((center, radius));
        }
    }
    places
}

/// Distance of two points.
fn distance(a: [f32; 3], b: [f32; 3]) -> f64 {
    let along = |k: usize| f64::from(a[k]) - f64::from(b[k]);
    along(0).hypot(along(1)).hypot(along(2))
}

/// Median of the radii that are positive; 1 without one.
fn median(radii: &[f32]) -> f32 {
    let mut sorted: Vec<f32> = radii.iter().copied().filter(|r| *r > 0.0).collect();
    sorted.sort_by(f32::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(1.0)
}

/// Square of the distance of two points.
fn square(a: [f32; 3], b: [f32; 3]) -> f32 {
    (0..3).map(|k| (a[k] - b[k]) * (a[k] - b[k])).sum()
}

impl Clearance {
    /// Balls of some radii, this `share` of the distance of the nearest points, about some centres, and in the passages between these; where a radius is
    /// missing there is no ball.
    #[must_use]
    pub fn new(centers: &[[f32; 3]], radii: &[f32], share: f64) -> Self {
        let median = median(radii);
        let largest = radii.iter().copied().fold(median, f32::max);
        let mut clearance = Self {
            balls: Vec::new(),
            edge: median.max(largest / 4.0),
            cells: FxHashMap::default(),
        };
        let about = centers.iter().copied().zip(radii.iter().copied());
        let balls = about.chain(passages(centers, radii, share));
        for (center, radius) in balls.filter(|(_, radius)| *radius > 0.0) {
            let ball = clearance.balls.len() as u32;
            clearance.balls.push((center, radius * radius));
            let radius = f64::from(radius);
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
    use super::{Clearance, passages, radii, square};
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
        let clearance = Clearance::new(&centers, &radii, 0.3);
        let about = centers.iter().copied().zip(radii.iter().copied());
        let between = passages(&centers, &radii, 0.3);
        assert!(between.len() > 20, "{}", between.len());
        let balls: Vec<_> = about.chain(between).collect();
        let all = |p: [f32; 3]| balls.iter().any(|(c, r)| square(p, *c) < r * r);
        let held = positions.iter().filter(|p| clearance.holds(**p)).count();
        assert!(held > 100 && held < 19_000, "{held}");
        assert!(positions.iter().any(|p| clearance.holds(*p) && p[0] < -0.5));
        assert!(positions.iter().all(|p| clearance.holds(*p) == all(*p)));
        assert!(!clearance.holds([f32::NAN, 0.0, 0.0]));
        assert!(!clearance.holds([f32::INFINITY; 3]));
    }

    #[test]
    fn balls_of_any_size_are_looked_up_at_once() {
        let beyond = [f32::NAN, f32::INFINITY, 0.0];
        let far = [[1e30, -1e30, 0.0], [0.0; 3], [-3e38, 0.0, 0.0], beyond];
        for radii in [
            [1e-30, 1e30, 0.1, 0.1],
            [f32::MAX; 4],
            [1e-45; 4],
            [f32::INFINITY, 0.1, 0.1, 0.1],
            [f32::NAN, -1.0, 0.1, 0.1],
        ] {
            let clearance = Clearance::new(&far, &radii, 0.3);
            assert!(!clearance.holds([f32::NAN; 3]));
            let cells: usize = clearance.cells.values().map(Vec::len).sum();
            assert!(cells <= (4 + 3 * 5) * 9 * 9 * 9, "{radii:?}: {cells}");
        }
    }

    /// A camera's nearest points may be many radii away, or hardly one.
    #[test]
    fn any_share_has_few_balls_and_spares_the_points() {
        let ends = [[0.0, 0.0, 0.0], [0.33, 0.0, 0.0]];
        for share in [0.0, 1e-12, 1e-6, 1e-3, 0.3, 0.9, 0.999, 1.0, f64::NAN] {
            let radius = (0.4 * share) as f32;
            let between = passages(&ends, &[radius; 2], share);
            assert!(between.len() <= 31, "{share}: {}", between.len());
            // A point at the distance of the nearest ones from both ends.
            let point = [0.165, (0.16_f32 - 0.165 * 0.165).sqrt(), 0.0];
            let held =
                |(center, radius): &([f32; 3], f32)| square(*center, point) < radius * radius;
            assert!(!between.iter().any(held), "{share}");
            let some = share == 0.3 || share == 0.9;
            assert_eq!(!between.is_empty(), some, "{share}: {}", between.len());
        }
    }

    #[test]
    fn no_radius_holds_nothing() {
        let centers = cloud(3, 1, 1.0);
        for radii in [Vec::new(), vec![0.0; 3]] {
            let clearance = Clearance::new(&centers, &radii, 0.3);
            assert!(clearance.is_empty() && !clearance.holds(centers[0]));
        }
    }

    /// Whoever took the photos walked from one to the next, and not through what they show.
    #[test]
    fn passages_lead_to_neighbours_and_not_across() {
        let held = |centers: &[[f32; 3]], radii: &[f32], share: f64, at: [f32; 3]| {
            Clearance::new(centers, radii, share).holds(at)
        };
        let two = |apart: f32| [[0.0, 0.0, 0.0], [apart, 0.0, 0.0]];
        let middle = |apart: f32, off: f32| [0.5 * apart, off, 0.0];
        for (apart, off, radii, share, free) in [
            (1.1, 0.38, [0.4, 0.4], 0.3, true),
            (1.1, 0.41, [0.4, 0.4], 0.3, false),
            // Further apart than 0.9 of the distance of the nearest points, of which the radii are a share.
            (1.3, 0.0, [0.4, 0.4], 0.3, false),
            (1.1, 0.0, [0.4, 0.4], 0.4, false),
            (1.1, 0.0, [0.4, 0.3], 0.3, false),
            (0.8, 0.33, [0.4, 0.3], 0.3, true),
            (1.1, 0.0, [0.4, 0.0], 0.3, false),
        ] {
            let found = held(&two(apart), &radii, share, middle(apart, off));
            assert_eq!(found, free, "{apart} {off} {radii:?}");
        }
        // All views of a panorama stand at one place, and there is a way from one panorama to the next.
        let panoramas: Vec<[f32; 3]> = two(1.1).into_iter().flat_map(|c| [c; 6]).collect();
        assert!(held(&panoramas, &[0.4; 12], 0.3, middle(1.1, 0.38)));
        // The eight cameras of a rig stand at the corners of a cube.
        let corner =
            |c: [f32; 3], k: usize| [0, 1, 2].map(|d| c[d] + 0.05 * ((k >> d & 1) as f32 - 0.5));
        let rigs = two(1.1).into_iter();
        let rigs: Vec<[f32; 3]> = rigs
            .flat_map(|c| (0..8).map(move |k| corner(c, k)))
            .collect();
        assert!(held(&rigs, &[0.4; 16], 0.3, middle(1.1, 0.3)));
        // Close ones keep theirs beside far ones.
        let mut mixed = vec![[100.0, 0.0, 0.0]; 5];
        mixed.extend(two(0.15));
        let radii = [1.0, 1.0, 1.0, 1.0, 1.0, 0.1, 0.1];
        assert!(held(&mixed, &radii, 0.3, middle(0.15, 0.08)));
        // Cameras in a circle about an object: the circle is free, its middle is not, however far points are.
        let turn = std::f32::consts::TAU / 16.0;
        let on = |k: f32| [5.0 * (k * turn).cos(), 5.0 * (k * turn).sin(), 0.0];
        let circle: Vec<[f32; 3]> = (0..16).map(|k| on(k as f32)).collect();
        assert!(held(&circle, &[0.8; 16], 0.3, on(0.5)));
        assert!(!held(&circle, &[3.4; 16], 0.3, [0.0; 3]));
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
