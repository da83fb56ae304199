//! The first Gaussians.

use glam::DVec3;

use super::{colmap_scene, load_every};
use mhsplat::base::rng::Philox;
use mhsplat::capture::Points;
use mhsplat::config::{Init, Sampler, TrainConfig};
use mhsplat::run::initial_gaussians;
use mhsplat::scene::knn::mean_squared_distances;
use mhsplat::scene::{Gaussians, Plane, init};
use mhsplat::train::Plan;

fn cloud(n: u64, seed: u64) -> Vec<[f32; 3]> {
    (0..n)
        .map(|i| {
            let u = Philox::uniform(seed, 1, i);
            // Clustered, with duplicates: a coarse lattice for every third point.
            let step = if i % 3 == 0 { 0.25 } else { 1e-6 };
            std::array::from_fn(|k| ((u[k] / step).floor() * step) as f32)
        })
        .collect()
}

fn brute(positions: &[[f32; 3]]) -> Vec<f64> {
    let each = positions.iter().enumerate().map(|(i, p)| {
        let others = positions.iter().enumerate().filter(|(j, _)| *j != i);
        let mut d: Vec<f64> = others
            .map(|(_, q)| {
                let along = |k: usize| f64::from(p[k]) - f64::from(q[k]);
                (0..3).map(|k| along(k).powi(2)).sum()
            })
            .collect();
        d.sort_by(f64::total_cmp);
        d[..3].iter().sum::<f64>() / 3.0
    });
    each.collect()
}

fn worst(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    let off = a.iter().zip(b).map(|(a, b)| (a - b).abs() / b.max(1e-12));
    off.fold(0.0, |m, v| if v.is_nan() { f64::NAN } else { m.max(v) })
}

#[test]
fn neighbours_match_brute_force() {
    for n in [4, 9, 100, 1500] {
        let positions = cloud(n, n);
        let off = worst(&mean_squared_distances::<3>(&positions), &brute(&positions));
        assert!(off < 1e-12, "{n} points: off by {off:e}");
    }
    // The comparator notices one point that moved.
    let (a, mut b) = (cloud(100, 5), cloud(100, 5));
    b[50][1] += 0.01;
    assert!(worst(&mean_squared_distances::<3>(&a), &brute(&b)) > 1e-3);
}

#[test]
fn coincident_points_stay_fast_and_finite() {
    let n = 50_000;
    let points = Points {
        positions: vec![[0.5, 0.25, -1.0]; n],
        colors: vec![[255, 0, 128]; n],
    };
    let splats = init::from_points(&points, 0).unwrap();
    let scale = splats.planes()[Plane::LOG_SCALE][n - 1];
    assert!((scale - 1e-5_f32.ln()).abs() < 1e-5);
}

#[test]
fn parameters_of_a_point() {
    // A unit square: two neighbours at 1, one at √2, hence a mean square of 4/3.
    let points = Points {
        positions: vec![
            [0.0, 0.0, 7.0],
            [1.0, 0.0, 7.0],
            [0.0, 1.0, 7.0],
            [1.0, 1.0, 7.0],
        ],
        colors: vec![[255, 0, 51]; 4],
    };
    let splats = init::from_points(&points, 2).unwrap();
    assert_eq!((splats.len(), splats.sh_degree()), (4, 2));
    let at = |p: usize| f64::from(splats.planes()[p][3]);
    assert_eq!(splats.gather::<3>(Plane::POSITION, 3), [1.0, 1.0, 7.0]);
    for k in 0..3 {
        assert!((at(Plane::LOG_SCALE + k).exp() - (4.0_f64 / 3.0).sqrt()).abs() < 1e-6);
    }
    assert_eq!(splats.gather::<4>(Plane::ROTATION, 3), [1.0, 0.0, 0.0, 0.0]);
    assert!((1.0 / (1.0 + (-at(Plane::OPACITY)).exp()) - 0.1).abs() < 1e-7);
    let color = |c: usize| 0.5 + 0.282_094_791_773_878_14 * at(Plane::SH + c);
    assert!((color(0) - 1.0).abs() < 1e-6 && color(1).abs() < 1e-6);
    assert!((color(2) - 0.2).abs() < 1e-6);
    assert!(
        splats.planes()[Plane::SH + 3..]
            .iter()
            .flatten()
            .all(|&v| v == 0.0)
    );
}

#[test]
fn few_points_and_bad_ones() {
    let points = |n: usize| Points {
        positions: (0..n).map(|i| [i as f32, 0.0, 0.0]).collect(),
        colors: vec![[0; 3]; n],
    };
    let scale = |s: &Gaussians| s.planes()[Plane::LOG_SCALE][0].exp();
    assert!((scale(&init::from_points(&points(1), 0).unwrap()) - 0.01).abs() < 1e-6);
    assert!((scale(&init::from_points(&points(2), 0).unwrap()) - 1.0).abs() < 1e-6);
    let three = 2.5_f32.sqrt();
    assert!((scale(&init::from_points(&points(3), 0).unwrap()) - three).abs() < 1e-6);
    assert!(init::from_points(&points(0), 0).is_err());
    assert!(init::from_points(&points(5), 4).is_err());
    let mut bad = points(5);
    bad.positions[2][1] = f32::NAN;
    assert!(init::from_points(&bad, 0).is_err());
    bad = points(5);
    bad.colors.pop();
    assert!(init::from_points(&bad, 0).is_err());
}

/// A fixed set never becomes more; the others make what they need.
#[test]
fn a_random_start_has_as_many_as_its_sampler_needs() {
    let data = crate::determinism::room(64);
    for (sampler, most, count) in [
        (Sampler::Mh, None, 5000),
        (Sampler::Mcmc, None, 5000),
        (Sampler::Adc, None, 20_000),
        (Sampler::None, None, 20_000),
        (Sampler::Mh, Some(700), 700),
    ] {
        let config = TrainConfig {
            sampler,
            init: Init::Random,
            max_gaussians: most,
            ..TrainConfig::default()
        };
        let plan = Plan::new(&data, &config).unwrap();
        assert_eq!(initial_gaussians(&data, &plan).unwrap().len(), count);
    }
}

#[test]
fn random_points_fill_the_cameras_box() {
    let dir = colmap_scene(9, DVec3::ZERO, true);
    let d = load_every(dir.path(), 8).unwrap();
    let splats = init::random(&d, 4000, 1, 3).unwrap();
    assert_eq!(splats, init::random(&d, 4000, 1, 3).unwrap());
    assert_ne!(splats, init::random(&d, 4000, 1, 4).unwrap());
    let centers: Vec<DVec3> = d
        .train
        .iter()
        .chain(&d.test)
        .map(|v| v.camera.center())
        .collect();
    for k in 0..3 {
        let low = centers.iter().map(|c| c[k]).fold(f64::INFINITY, f64::min);
        let high = centers
            .iter()
            .map(|c| c[k])
            .fold(f64::NEG_INFINITY, f64::max);
        let plane = &splats.planes()[Plane::POSITION + k];
        let share = |v: f32| (f64::from(v) - low) / (high - low);
        assert!(
            plane
                .iter()
                .all(|&v| (-1e-6..=1.000_001).contains(&share(v)))
        );
        let mean = plane.iter().map(|&v| share(v)).sum::<f64>() / 4000.0;
        // Standard error of the mean of 4000 uniform numbers: 0.0046.
        assert!((mean - 0.5).abs() < 0.025, "axis {k}: mean {mean}");
    }
    assert!(init::random(&d, 0, 1, 3).is_err());
    let one = colmap_scene(1, DVec3::ZERO, true);
    let d = load_every(one.path(), 0).unwrap();
    let splats = init::random(&d, 100, 0, 0).unwrap();
    assert!(splats.planes()[..3].iter().flatten().any(|v| v.abs() > 0.5));
}
