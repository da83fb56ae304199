//! Voxel counts against brute force.

use std::collections::HashMap;

use super::Scene;
use mhsplat::density::mh::sparsity::{Lattice, VoxelCounts};

/// Counts with a map of floored f64 coordinates.
fn brute_force(positions: [&[f32]; 3], edge: f64) -> HashMap<[i64; 3], u32> {
    let mut counts = HashMap::new();
    for i in 0..positions[0].len() {
        let key = positions.map(|p| (f64::from(p[i]) / edge).floor() as i64);
        *counts.entry(key).or_insert(0) += 1;
    }
    counts
}

/// Number of positions at which the counts differ from the expected ones of lattice edge `edge`.
fn disagreements(
    counts: &VoxelCounts,
    positions: [&[f32]; 3],
    expected: &HashMap<[i64; 3], u32>,
    edge: f64,
) -> usize {
    (0..positions[0].len())
        .filter(|&i| {
            let at = positions.map(|p| f64::from(p[i]));
            let key = at.map(|x| (x / edge).floor() as i64);
            counts.get(at) != expected[&key]
        })
        .count()
}

#[test]
fn voxel_counts_equal_brute_force() {
    let mut scene = Scene::random(40_000, 5);
    // Borders of cells on both sides of zero, and places far away.
    for i in 0..4000 {
        let k = i as f32 - 2000.0;
        scene.positions[0][i] = k * 0.0625;
        scene.positions[1][i] = if i % 2 == 0 { -0.0 } else { 0.125 };
        scene.positions[2][i] = if i % 7 == 0 { k * 1e3 } else { -0.0625 };
    }
    for edge in [0.0625, 0.02, 0.005] {
        let positions = scene.state().positions;
        let expected = brute_force(positions, edge);
        let counts = VoxelCounts::count(positions, edge);
        assert_eq!(counts.occupied(), expected.len());
        assert_eq!(disagreements(&counts, positions, &expected, edge), 0);
        let shifted = VoxelCounts::count(positions, edge * 1.5);
        assert!(disagreements(&shifted, positions, &expected, edge) > 0);
    }
    let counts = VoxelCounts::count([&[0.5], &[0.5], &[0.5]], 1.0);
    assert_eq!(counts.get([-0.5, 0.5, 0.5]), 0);
    assert_eq!(counts.get([0.0, 0.999, 0.5]), 1);
    assert_eq!(counts.get([1.0, 0.5, 0.5]), 0);
    // Beyond 2³¹ edges the outermost voxel takes everything; nothing wraps around to the other side.
    let far = VoxelCounts::count([&[1e30, 3e38], &[0.0; 2], &[0.0; 2]], 0.005);
    assert_eq!(
        (far.get([2e30, 0.0, 0.0]), far.get([-2e30, 0.0, 0.0])),
        (2, 0)
    );
}

#[test]
fn what_leaves_a_voxel_is_counted_no_more() {
    // The second place is too far for a packed key.
    for place in [[0.2, 0.2, 0.2], [1e12, 0.2, 0.2]] {
        let mut counts = VoxelCounts::count([&[0.1], &[0.1], &[5.1]], 1.0);
        counts.add(place);
        counts.add(place);
        counts.remove(place);
        assert_eq!((counts.occupied(), counts.get(place)), (2, 1));
        counts.remove(place);
        counts.remove([f64::NAN; 3]);
        assert_eq!((counts.occupied(), counts.get(place)), (1, 0));
        // The place of an emptied voxel is found again while others come.
        for i in 0..10_000 {
            counts.add([0.5, f64::from(i) + 0.5, 9.5]);
        }
        counts.add(place);
        assert_eq!((counts.occupied(), counts.get(place)), (10_002, 1));
    }
}

#[test]
fn voxel_counts_grow_and_ignore_what_is_not_finite() {
    let nan = [f32::NAN, 0.1, f32::INFINITY];
    let mut counts = VoxelCounts::count([&nan, &[0.1; 3], &[0.1; 3]], 0.5);
    assert_eq!((counts.occupied(), counts.get([0.1; 3])), (1, 1));
    assert_eq!(counts.get([f64::NAN, 0.0, 0.0]), 0);
    counts.add([f64::NAN; 3]);
    for i in 0..20_000 {
        counts.add([f64::from(i % 10_000) + 0.25, -1.0, 3.0]);
    }
    assert_eq!(counts.occupied(), 10_001);
    assert!((0..10_000).all(|i| counts.get([f64::from(i), -0.75, 3.4]) == 2));
    assert_eq!(VoxelCounts::count([&[], &[], &[]], 1.0).occupied(), 0);
    let some = VoxelCounts::count_where(
        [&[0.1, 0.1], &[0.1; 2], &[0.1; 2]],
        Lattice::uniform(1.0),
        |i| i == 1,
    );
    assert_eq!(some.get([0.2; 3]), 1);
}

#[test]
fn far_voxels_are_counted_like_near_ones() {
    // Around 2¹⁸ edges from the origin keys no longer fit into 64 bits.
    let line: Vec<f32> = (0..16).map(|i| 262_136.0 + i as f32).collect();
    let line: Vec<f32> = line.iter().flat_map(|x| [*x, *x, -x]).collect();
    let zeros = vec![0.5; line.len()];
    for planes in [[&line, &zeros, &zeros], [&zeros, &zeros, &line]] {
        let mut counts = VoxelCounts::count(planes.map(Vec::as_slice), 1.0);
        assert_eq!(counts.occupied(), 32);
        let at = |i: usize| planes.map(|p| f64::from(p[i]));
        for (i, x) in line.iter().enumerate() {
            assert_eq!(counts.get(at(i)), if *x > 0.0 { 2 } else { 1 }, "{x}");
        }
        for i in 0..line.len() {
            counts.add(at(i));
        }
        assert_eq!((counts.get(at(0)), counts.occupied()), (4, 32));
    }
}

#[test]
fn edges_grow_with_the_distance_from_the_nearest_camera() {
    let centres = [[0.0f32; 3], [100.0, 0.0, 0.0]];
    let lattice = Lattice::growing(0.5, 2.0, &centres);
    let level = |x: f64| lattice.level([x, 0.0, 0.0]);
    let levels = [0.0, 1.9, 3.99, 4.0, 7.99, 8.0, 16.0, 50.0, 84.1, 97.0].map(level);
    assert_eq!(levels, [0, 0, 0, 1, 1, 2, 3, 4, 2, 0]);
    assert_eq!(lattice.level([1e30; 3]), 30);
    assert_eq!(Lattice::uniform(0.5).level([1e30; 3]), 0);
    assert_eq!(Lattice::growing(0.5, 2.0, &[]).level([1e30; 3]), 0);
    // The count of brute force over (level, lattice coordinates).
    let scene = Scene::random(20_000, 5);
    let scaled = scene
        .positions
        .each_ref()
        .map(|p| -> Vec<f32> { p.iter().map(|v| v * 300.0).collect() });
    let planes = scaled.each_ref().map(Vec::as_slice);
    let key = |i: usize| {
        let at = planes.map(|p| f64::from(p[i]));
        let apart = |c: &[f32; 3]| {
            let along = |k: usize| (at[k] - f64::from(c[k])).powi(2);
            (0..3).map(along).sum::<f64>().sqrt()
        };
        let nearest = centres.iter().map(apart).fold(f64::MAX, f64::min);
        let level = (nearest / 2.0).log2().floor().max(0.0);
        let edge = 0.5 * level.exp2();
        (level as i64, at.map(|x| (x / edge).floor() as i64))
    };
    let mut expected = HashMap::new();
    for i in 0..20_000 {
        *expected.entry(key(i)).or_insert(0u32) += 1;
    }
    let counts = VoxelCounts::count_where(planes, lattice, |_| true);
    assert_eq!(counts.occupied(), expected.len());
    let wrong =
        (0..20_000).filter(|&i| counts.get(planes.map(|p| f64::from(p[i]))) != expected[&key(i)]);
    assert_eq!(wrong.count(), 0);
    assert!(expected.keys().any(|k| k.0 > 2) && expected.keys().any(|k| k.0 == 0));
}
