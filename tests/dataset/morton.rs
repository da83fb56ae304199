//! Order by layers and along the Z curve.

use mhsplat::scene::{Gaussians, Plane, morton};

#[test]
fn corners_of_a_cube_in_z_order() {
    let corner = |k: usize| -> Vec<f32> { (0..8).map(|c| (c >> k & 1) as f32).rev().collect() };
    let [x, y, z] = [corner(0), corner(1), corner(2)];
    let order = morton::order([&x, &y, &z], morton::NO_UP);
    assert_eq!(order, [7, 6, 5, 4, 3, 2, 1, 0]);
}

#[test]
fn neighbours_lie_together_and_nothing_is_lost() {
    let mut splats = Gaussians::zeros(1, 64 * 64);
    for i in 0..64 * 64 {
        let shuffled = i * 2731 % (64 * 64);
        let at = [(shuffled % 64) as f32, (shuffled / 64) as f32, 0.5];
        splats.scatter(Plane::POSITION, i, at);
        splats.scatter(Plane::SH, i, [shuffled as f32]);
    }
    let sorted = splats.in_morton_order(morton::NO_UP);
    let mut seen: Vec<f32> = sorted.planes()[Plane::SH].clone();
    let step = |i: usize| {
        let [a, b] = [i, i + 1].map(|j| sorted.gather::<2>(Plane::POSITION, j));
        f64::from((a[0] - b[0]).abs() + (a[1] - b[1]).abs())
    };
    let mean = (0..64 * 64 - 1).map(step).sum::<f64>() / 4095.0;
    assert!(mean < 2.0, "{mean} cells between neighbours");
    for (i, row) in seen.iter().enumerate() {
        let [x, y] = sorted.gather::<2>(Plane::POSITION, i);
        assert_eq!(*row, y * 64.0 + x, "rows stay whole");
    }
    seen.sort_by(f32::total_cmp);
    assert!(seen.iter().enumerate().all(|(i, v)| *v == i as f32));
}

#[test]
fn equal_positions_and_one_far_away_keep_their_rows() {
    let x = [1.0, 1.0, 1e30, 1.0];
    let order = morton::order([&x, &[0.0; 4], &[0.0; 4]], morton::NO_UP);
    assert_eq!(order, [0, 1, 3, 2]);
    assert!(morton::order([&[], &[], &[]], morton::NO_UP).is_empty());
}

#[test]
fn layers_come_from_the_top_whatever_lies_beside() {
    let up = [0.0, -0.6, 0.8];
    // Heights along `up`, far from each other to the side.
    let heights = [-40.0f32, -1.0, -0.3, 0.01, 0.3, 1.0, 40.0, 1e30];
    let side = |i: usize| if i.is_multiple_of(2) { 1000.0 } else { -1000.0 };
    let x: Vec<f32> = (0..heights.len()).map(side).collect();
    let [y, z] = [1, 2].map(|k| heights.map(|h| h * up[k]));
    let order = morton::order([&x, &y, &z], up);
    assert_eq!(order, [7, 6, 5, 4, 3, 2, 1, 0]);
    assert_ne!(order, morton::order([&x, &y, &z], morton::NO_UP));
    let layer = |h: f32| morton::layer([0.0, 0.0, h], [0.0, 0.0, 1.0]);
    // Eight of them until 1 + 2 |height| is 2, and again until it is 4.
    let [above, below] = [1e-6, -1e-6].map(layer);
    assert_eq!(below - above, 1);
    assert_eq!([0.49999, 1.49999].map(layer), [above - 7, above - 15]);
    assert_eq!([-0.49999, -1.49999].map(layer), [below + 7, below + 15]);
    assert_eq!([f32::INFINITY, 1e9].map(layer), [0, 0]);
    let last = (1 << morton::LAYER_BITS) - 1;
    assert_eq!([f32::NEG_INFINITY, -1e9, f32::NAN].map(layer), [last; 3]);
}
