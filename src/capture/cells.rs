//! Cells that divide the plane in which a capture's cameras stand: every point is in exactly one of them.
//!
//! The cells of equal numbers of cameras, first along one axis and then along the other, and their growth by a share of their length are
//! those of VastGaussian (Lin et al., CVPR 2024).

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

use crate::base::math::sorted;

/// Sweeps of Jacobi's rotations over a 3×3 matrix; it takes about six to the last bit.
const SWEEPS: usize = 12;

/// The plane in which points extend most.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Ground {
    /// The mean of the points, which has the coordinates 0, 0.
    pub center: DVec3,
    /// Unit vectors in the plane, perpendicular to each other: the direction in which the points extend most, then the other one.
    pub axes: [DVec3; 2],
}

impl Ground {
    /// The plane of points: of all directions they extend least along its normal.
    #[must_use]
    pub fn of(points: &[DVec3]) -> Self {
        let n = points.len().max(1) as f64;
        let center = points.iter().sum::<DVec3>() / n;
        let outer = |d: DVec3| DMat3::from_cols(d * d.x, d * d.y, d * d.z);
        let spread = points
            .iter()
            .fold(DMat3::ZERO, |sum, p| sum + outer(*p - center));
        let axes = principal_axes(spread * (1.0 / n));
        Self {
            center,
            axes: [axes[0], axes[1]],
        }
    }

    /// Coordinates of a point along the two axes, and its height above the plane.
    #[must_use]
    pub fn place(&self, p: DVec3) -> DVec3 {
        self.direction(p - self.center)
    }

    /// A direction in the axes of [`Self::place`].
    #[must_use]
    pub fn direction(&self, d: DVec3) -> DVec3 {
        let [u, v] = self.axes;
        DVec3::new(d.dot(u), d.dot(v), d.dot(u.cross(v)))
    }
}

/// Unit eigenvectors of a symmetric matrix, that of the largest eigenvalue first (cyclic Jacobi). Each has its largest component positive.
fn principal_axes(mut a: DMat3) -> [DVec3; 3] {
    let mut axes = DMat3::IDENTITY;
    for (p, q) in [(0, 1), (0, 2), (1, 2)]
        .into_iter()
        .cycle()
        .take(3 * SWEEPS)
    {
        let off = a.col(q)[p];
        if off == 0.0 {
            continue;
        }
        let theta = (a.col(q)[q] - a.col(p)[p]) / (2.0 * off);
        let t = theta.signum() / (theta.abs() + theta.hypot(1.0));
        let c = t.hypot(1.0).recip();
        let mut turn = DMat3::IDENTITY;
        turn.col_mut(p)[p] = c;
        turn.col_mut(q)[q] = c;
        turn.col_mut(q)[p] = c * t;
        turn.col_mut(p)[q] = -c * t;
        a = turn.transpose() * a * turn;
        axes *= turn;
    }
    let mut order = [0, 1, 2];
    order.sort_by(|i, j| a.col(*j)[*j].total_cmp(&a.col(*i)[*i]));
    order.map(|k| {
        let axis = axes.col(k).normalize_or(DVec3::AXES[k]);
        axis * axis[axis.abs().max_position()].signum()
    })
}

/// A rectangle of the plane: from and to along each axis, `None` where it has no end. It begins at its lower edge and ends before its
/// upper one.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Bounds(pub [[Option<f64>; 2]; 2]);

impl Bounds {
    /// The whole plane.
    pub const ALL: Self = Self([[None; 2]; 2]);

    /// True for a place in the rectangle.
    #[must_use]
    pub fn contains(&self, place: DVec3) -> bool {
        self.0.iter().enumerate().all(|(k, [from, to])| {
            let v = place[k];
            from.is_none_or(|from| v >= from) && to.is_none_or(|to| v < to)
        })
    }

    /// The rectangle with each edge moved outwards by a share of its length along the axis. Where it has no end it counts as far as
    /// the places reach.
    #[must_use]
    pub fn grown(&self, share: f64, places: &[DVec3]) -> Self {
        let mut grown = *self;
        for (k, [from, to]) in grown.0.iter_mut().enumerate() {
            let along = sorted(places.iter().map(|p| p[k]));
            let end = |edge: &Option<f64>, reach: Option<&f64>| edge.or(reach.copied());
            let ends = (end(from, along.first()), end(to, along.last()));
            let (Some(low), Some(high)) = ends else {
                continue;
            };
            let more = share * (high - low).max(0.0);
            *from = from.map(|v| v - more);
            *to = to.map(|v| v + more);
        }
        grown
    }
}

/// Divides the plane into cells with equal numbers of places, within one: into strips across the first axis, and these across the second. There
/// are as many strips as make the cells most nearly square. `None` if so many cells cannot each have a place of its own.
#[must_use]
pub fn divide(places: &[DVec3], cells: usize) -> Option<Vec<Bounds>> {
    if cells > places.len() {
        return None;
    }
    let reach = |k: usize| {
        let along = sorted(places.iter().map(|p| p[k]));
        along.first().zip(along.last()).map(|(a, b)| b - a)
    };
    let (long, wide) = (reach(0)?, reach(1)?);
    let square = (cells as f64 * long / wide).sqrt().round();
    // Infinite where all places are on a line, no number where they are one place.
    let strips = match square >= 1.0 {
        true => (square as usize).min(cells),
        false => 1,
    };
    let shares: Vec<usize> = (0..strips)
        .map(|i| cells * (i + 1) / strips - cells * i / strips)
        .collect();
    let mut all = Vec::with_capacity(cells);
    for (first, share) in between(places, 0, &shares)?.into_iter().zip(shares) {
        let strip = Bounds([first, [None; 2]]);
        let inside: Vec<DVec3> = places
            .iter()
            .copied()
            .filter(|p| strip.contains(*p))
            .collect();
        let parts = between(&inside, 1, &vec![1; share])?;
        all.extend(parts.into_iter().map(|second| Bounds([first, second])));
    }
    Some(all)
}

/// Intervals along an axis whose numbers of places are as the shares; they begin and end midway between two places. `None` if there are
/// fewer places that differ than shares.
fn between(places: &[DVec3], axis: usize, shares: &[usize]) -> Option<Vec<[Option<f64>; 2]>> {
    let along = sorted(places.iter().map(|p| p[axis]));
    // Cameras of a rig, or photos from a tripod, differ by rounding alone.
    let least = 1e-9 * (along.last()? - along.first()?);
    let gaps = (1..along.len()).filter(|k| along[*k] - along[*k - 1] > least);
    let gaps: Vec<usize> = gaps.collect();
    let total: usize = shares.iter().sum();
    let (mut taken, mut last, mut from) = (0, 0, None);
    let mut intervals = Vec::with_capacity(shares.len());
    for (i, share) in shares[..shares.len() - 1].iter().enumerate() {
        taken += share;
        let due = (along.len() * taken + total / 2) / total;
        // A gap is left for each edge that comes after.
        let left = shares.len() - 2 - i;
        let free = gaps.get(..gaps.len().checked_sub(left)?)?;
        let later = free.iter().filter(|k| **k > last);
        last = *later.min_by_key(|k| k.abs_diff(due))?;
        let to = Some(f64::midpoint(along[last - 1], along[last]));
        intervals.push([from, to]);
        from = to;
    }
    intervals.push([from, None]);
    Some(intervals)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Places of a generator that is as good as random.
    fn scattered(n: usize, size: DVec3) -> Vec<DVec3> {
        let part = |i: usize, step: f64| (i as f64 * step).fract() - 0.5;
        let place =
            |i: usize| DVec3::new(part(i, 0.618_034), part(i, 0.754_878), part(i, 0.569_84));
        (1..=n).map(|i| place(i) * size).collect()
    }

    #[test]
    fn an_edge_leaves_gaps_for_those_after_it() {
        let places: Vec<DVec3> = [0.0, 1.0, 2.0]
            .into_iter()
            .chain([3.0; 100])
            .map(|x| DVec3::new(x, 0.0, 0.0))
            .collect();
        let intervals = between(&places, 0, &[1; 4]).unwrap();
        let edges: Vec<Option<f64>> = intervals.iter().map(|i| i[1]).collect();
        assert_eq!(edges, [Some(0.5), Some(1.5), Some(2.5), None]);
        assert_eq!(between(&places, 0, &[1; 5]), None);
        assert_eq!(divide(&places, 4_000_000_000), None);
    }

    #[test]
    fn the_plane_is_that_of_the_largest_extents() {
        let turn = DMat3::from_rotation_y(0.3) * DMat3::from_rotation_x(1.1);
        let middle = DVec3::new(4e5, -20.0, 5e6);
        let points: Vec<DVec3> = scattered(500, DVec3::new(3.0, 9.0, 0.5))
            .into_iter()
            .map(|p| middle + turn * p)
            .collect();
        let ground = Ground::of(&points);
        assert!(ground.axes[0].dot(turn.y_axis).abs() > 0.999);
        assert!(ground.axes[1].dot(turn.x_axis).abs() > 0.999);
        let normal = ground.direction(turn.z_axis);
        assert!(normal.z.abs() > 0.999, "{normal}");
        assert!(ground.place(ground.center).length() < 1e-9);
        // Without a direction of their own points lie in a plane of the axes.
        for few in [&points[..1], &[]] {
            let [u, v] = Ground::of(few).axes;
            assert!(u.dot(v) == 0.0 && u.is_normalized() && v.is_normalized());
        }
    }

    #[test]
    fn every_place_is_in_one_cell_and_cells_have_as_many_cameras() {
        for n in [1, 2, 3, 4, 5, 7, 12] {
            for size in [
                DVec3::ONE,
                DVec3::new(9.0, 1.0, 1.0),
                DVec3::new(5.0, 0.0, 0.0),
            ] {
                let cameras = scattered(240, size);
                let cells = divide(&cameras, n).unwrap();
                assert_eq!(cells.len(), n);
                for cell in &cells {
                    let own = cameras.iter().filter(|p| cell.contains(**p)).count();
                    assert!((240 / n).abs_diff(own) <= 2, "{own} of 240 in one of {n}");
                }
                let edges = cells.iter().flat_map(|c| c.0).flatten().flatten();
                let corners = edges.map(|v| DVec3::new(v, v, 0.0));
                let far = [DVec3::splat(1e30), DVec3::new(-1e30, 1e30, 0.0)];
                for place in scattered(999, 3.0 * size)
                    .into_iter()
                    .chain(corners)
                    .chain(far)
                {
                    let of = cells.iter().filter(|c| c.contains(place)).count();
                    assert_eq!(of, 1, "{place} of {n} cells");
                }
            }
        }
        // Long captures are cut across, square ones both ways.
        let across = |size| {
            let cells = divide(&scattered(100, size), 4).unwrap();
            cells.iter().filter(|c| c.0[1] == [None; 2]).count()
        };
        assert_eq!(across(DVec3::new(9.0, 1.0, 0.0)), 4);
        assert_eq!(across(DVec3::ONE), 0);
    }

    #[test]
    fn more_cells_than_places_are_none() {
        let line: Vec<DVec3> = (0..5).map(|i| DVec3::X * f64::from(i)).collect();
        assert_eq!(divide(&line, 5).unwrap().len(), 5);
        assert_eq!(divide(&line, 6), None);
        // Two photos from each place.
        let pairs = [&line[..], &line[..]].concat();
        assert_eq!(divide(&pairs, 5).unwrap().len(), 5);
        assert_eq!(divide(&pairs, 6), None);
        assert_eq!(divide(&line[..1], 1), Some(vec![Bounds::ALL]));
        assert_eq!(divide(&[], 1), None);
    }

    #[test]
    fn a_cell_grows_by_a_share_of_its_length_and_stays_without_an_end() {
        let places = [DVec3::ZERO, DVec3::new(10.0, 4.0, 0.0)];
        let cell = Bounds([[None, Some(5.0)], [Some(1.0), Some(3.0)]]);
        let grown = cell.grown(0.2, &places);
        assert_eq!(grown, Bounds([[None, Some(6.0)], [Some(0.6), Some(3.4)]]));
        assert_eq!(cell.grown(0.0, &places), cell);
        assert_eq!(Bounds::ALL.grown(0.2, &[]), Bounds::ALL);
    }
}
