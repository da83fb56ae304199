//! weight: what the views show of each Gaussian.

use super::*;
use mhsplat::gpu::Array;
use mhsplat::gpu::tuning::SUMS;
use mhsplat::stage::weight::{Weight, WeightArgs, red_image};

#[test]
fn agrees_with_the_reference() {
    agrees("weight");
}

#[test]
fn wrong_weights_are_rejected() {
    rejects("weight", |out| out.weights[3] += 1e-3);
}

/// Weights of three Gaussians with two, one and no pair, after views in which they had 1, 2 and 3 pixels.
fn weights(sixth: [f64; 3]) -> Vec<f64> {
    let device = device();
    let mut sums = vec![7.0; 3 * SUMS];
    for (pair, weight) in sixth.iter().enumerate() {
        sums[pair * SUMS + 6] = *weight;
    }
    let most = Array::from_slice(&device, "weights", &[1.0, 2.0, 3.0]).unwrap();
    Weight::new::<f64>(&kernels(&device))
        .unwrap()
        .run(&WeightArgs {
            count: 3,
            pair_start: &Array::from_slice(&device, "pair_start", &[0, 2, 3]).unwrap(),
            pair_counts: &Array::from_slice(&device, "pair_counts", &[2, 1, 0]).unwrap(),
            sums: &Array::from_slice(&device, "sums", &sums).unwrap(),
            most: &most,
        })
        .unwrap();
    most.to_vec().unwrap()
}

#[test]
fn the_most_of_all_views_is_kept() {
    assert_eq!(weights([0.75, 0.5, 0.5]), [1.25, 2.0, 3.0]);
    assert_eq!(weights([0.25, 0.5, 4.0]), [1.0, 4.0, 3.0]);
}

#[test]
fn what_is_broken_is_not_taken_for_unseen() {
    assert!(weights([f64::NAN, 0.5, 0.5])[0] >= 1e30);
    assert!(weights([0.5, 0.5, f64::INFINITY])[1] >= 1e30);
}

#[test]
fn red_is_one_within_the_image_alone() {
    let red = red_image::<f64>([17, 3]);
    assert_eq!(red.len(), 3 * 32 * 16);
    assert_eq!(red.iter().sum::<f64>(), 51.0);
    assert_eq!(
        (red[16], red[17], red[2 * 32], red[3 * 32]),
        (1.0, 0.0, 1.0, 0.0)
    );
}
