//! The first Gaussians (3DGS §5.1): one per point, isotropic, as large as the distance to its neighbours.

use glam::DVec3;
use rayon::prelude::*;

use super::{Plane, Splats};
use crate::dataset::{Dataset, Points};
use crate::density::rng::{Philox, Purpose};
use crate::error::{Error, Result};

/// SH basis function of degree 0.
pub const SH_C0: f64 = 0.282_094_791_773_878_14;
/// Opacity of a new Gaussian.
const OPACITY: f64 = 0.1;
/// Smallest squared scale, local units² (3DGS's 1e-7 is in world units; here the scene extent is 1).
const MIN_SQUARED: f64 = 1e-10;
/// Largest scale, local units: a stray point must not become a wall in front of every camera.
const MAX_SCALE: f64 = 1.0;

/// One Gaussian per point: scale √(mean squared distance to the 3 nearest neighbours), opacity 0.1, identity rotation,
/// colour in SH degree 0.
///
/// # Errors
/// No point, or one that is not finite.
pub fn from_points(points: &Points, sh_degree: u32) -> Result<Splats> {
    let n = points.positions.len();
    if n == 0 {
        return Err(Error::Numerics {
            stage: "init".into(),
            what: "no points".into(),
        });
    }
    let squared = mean_squared_neighbours(&points.positions);
    let mut s = Splats::zeros(sh_degree, n);
    let logit = (OPACITY / (1.0 - OPACITY)).ln() as f32;
    for i in 0..n {
        let scale = squared[i].max(MIN_SQUARED).sqrt().min(MAX_SCALE);
        s.scatter(Plane::POSITION, i, points.positions[i]);
        s.scatter(Plane::LOG_SCALE, i, [scale.ln() as f32; 3]);
        s.scatter(Plane::OPACITY, i, [logit]);
        let rgb = points.colors.get(i).copied().unwrap_or([128; 3]);
        let sh = rgb.map(|c| ((f64::from(c) / 255.0 - 0.5) / SH_C0) as f32);
        s.scatter(Plane::SH, i, sh);
    }
    Splats::new(sh_degree, s.planes().to_vec())
}

/// `count` points uniform in the cameras' bounding box (axes shorter than half the longest are widened to that), grey.
///
/// # Errors
/// As [`from_points`].
pub fn random(dataset: &Dataset, count: usize, sh_degree: u32, seed: u64) -> Result<Splats> {
    let centers = || dataset.train.iter().map(|v| v.camera.center());
    let low = centers().fold(DVec3::INFINITY, DVec3::min);
    let high = centers().fold(DVec3::NEG_INFINITY, DVec3::max);
    let longest = (high - low).max_element();
    let middle = 0.5 * (low + high);
    let half = if longest > 0.0 {
        (0.5 * (high - low)).max(DVec3::splat(0.25 * longest))
    } else {
        DVec3::ONE
    };
    let stream = Purpose::Init.stream(0);
    let positions = (0..count as u64)
        .map(|i| {
            let [x, y, z, _] = Philox::uniform(seed, stream, i);
            let p = middle + half * (2.0 * DVec3::new(x, y, z) - 1.0);
            p.as_vec3().to_array()
        })
        .collect();
    from_points(
        &Points {
            positions,
            colors: vec![[128; 3]; count],
        },
        sh_degree,
    )
}

/// Mean squared distance of each point to its 3 nearest neighbours (fewer where there are fewer), O(N log N).
#[must_use]
pub fn mean_squared_neighbours(positions: &[[f32; 3]]) -> Vec<f64> {
    let mut order: Vec<u32> = (0..positions.len() as u32).collect();
    build(positions, &mut order, 0);
    (0..positions.len())
        .into_par_iter()
        .map(|i| {
            let mut best = [f64::INFINITY; 3];
            search(positions, &order, 0, i as u32, &mut best);
            let found: Vec<f64> = best.into_iter().filter(|d| d.is_finite()).collect();
            found.iter().sum::<f64>() / found.len().max(1) as f64
        })
        .collect()
}

/// Points below which a node of the tree is searched through.
const LEAF: usize = 8;

/// A k-d tree in place: the median of each range splits it along the axes in turn.
fn build(positions: &[[f32; 3]], order: &mut [u32], axis: usize) {
    if order.len() <= LEAF {
        return;
    }
    let middle = order.len() / 2;
    let key = |i: &u32| positions[*i as usize][axis];
    order.select_nth_unstable_by(middle, |a, b| key(a).total_cmp(&key(b)).then(a.cmp(b)));
    let (left, right) = order.split_at_mut(middle);
    let next = (axis + 1) % 3;
    rayon::join(
        || build(positions, left, next),
        || build(positions, &mut right[1..], next),
    );
}

fn visit(positions: &[[f32; 3]], from: u32, to: u32, best: &mut [f64; 3]) {
    if from == to {
        return;
    }
    let (a, b) = (positions[from as usize], positions[to as usize]);
    let d: f64 = (0..3)
        .map(|k| (f64::from(a[k]) - f64::from(b[k])).powi(2))
        .sum();
    if d < best[2] {
        best[2] = d;
        best.sort_by(f64::total_cmp);
    }
}

fn search(positions: &[[f32; 3]], order: &[u32], axis: usize, i: u32, best: &mut [f64; 3]) {
    if order.len() <= LEAF {
        for &j in order {
            visit(positions, i, j, best);
        }
        return;
    }
    let middle = order.len() / 2;
    let pivot = order[middle];
    let gap = f64::from(positions[i as usize][axis]) - f64::from(positions[pivot as usize][axis]);
    let (left, right) = (&order[..middle], &order[middle + 1..]);
    let (near, far) = if gap < 0.0 {
        (left, right)
    } else {
        (right, left)
    };
    let next = (axis + 1) % 3;
    search(positions, near, next, i, best);
    visit(positions, i, pivot, best);
    if gap * gap < best[2] {
        search(positions, far, next, i, best);
    }
}
