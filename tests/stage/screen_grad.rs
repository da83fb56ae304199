//! screen_grad: gradients with respect to the projected centres.

use super::*;
use mhsplat::base::constants::{LARGE_PAIRS, SUMS};
use mhsplat::device::tuning::status::OVERFLOW;
use mhsplat::device::{Array, Projected};
use mhsplat::pipeline::buffers::{GaussianBuffers, ViewBuffers};
use mhsplat::pipeline::reference::Camera64;
use mhsplat::pipeline::reference_pass::loss_of;
use mhsplat::pipeline::stage::project::shape;
use mhsplat::pipeline::stage::screen_grad::{add_norms, mean_gradient};

#[test]
fn agrees_with_the_reference() {
    agrees("screen_grad");
}

#[test]
fn wrong_sums_are_rejected() {
    rejects("screen_grad", "norms", |norms| norms[3] += 1e-3);
    rejects("screen_grad", "iterations", |n| n[5] += 1.0);
}

/// Gaussians whose covariance is the unit matrix in an image of 40 × 80 pixels: their first slots, pairs and sums.
fn seen(
    kernels: &Kernels,
    start: &[u32],
    pairs: &[u32],
    sums: &[f64],
) -> (ViewBuffers<f64>, GaussianBuffers<f64>) {
    let (device, count) = (kernels.device(), pairs.len());
    // a = c = log2(e)/2 for the unit matrix.
    let record = Projected {
        a: std::f64::consts::LOG2_E / 2.0,
        c: std::f64::consts::LOG2_E / 2.0,
        ..Projected::default()
    };
    let ints = |name, values: &[u32]| Array::from_slice(device, name, values).unwrap();
    let mut frame = ViewBuffers::new(device, &kernels.defines().tuning, false).unwrap();
    frame.records = Array::from_slice(device, "records", &vec![record; count]).unwrap();
    frame.isect_start = ints("isect_start", start);
    frame.isect_counts = ints("isect_counts", pairs);
    frame.sums = Array::from_slice(device, "sums", sums).unwrap();
    frame.camera.size = [40, 80];
    let scene = GaussianBuffers {
        params: Array::zeros(device, "params", 0).unwrap(),
        filter: Array::zeros(device, "filter", 0).unwrap(),
        stride: count,
        count,
        sh_degree: 0,
        shard: None,
    };
    (frame, scene)
}

/// ErrorStatistics after one iteration of two Gaussians with two pairs each, whose covariance is the unit matrix; `second` is what the
/// second pair of the second Gaussian holds for the sums by u and dy.
fn cues(pairs: [u32; 2], second: [f64; 2], overflow: u32) -> Vec<f64> {
    let device = device();
    let mut sums = vec![7.0; 4 * SUMS];
    for (pair, by) in [[1.0, 0.5], [2.0, 0.5], [10.0, 0.0], second]
        .iter()
        .enumerate()
    {
        sums[pair * SUMS + 1..pair * SUMS + 3].copy_from_slice(by);
    }
    let kernels = kernels(&device);
    let (frame, scene) = seen(&kernels, &[0, 2], &pairs, &sums);
    frame.status.write(OVERFLOW as usize, &[overflow]).unwrap();
    let cues = Array::from_slice(&device, "cues", &[100.0, 200.0, 1.0, 2.0]).unwrap();
    let stage = kernels.build::<f64>("screen_grad").unwrap();
    add_norms(&stage, &scene, &frame, &cues).unwrap();
    cues.to_vec().unwrap()
}

#[test]
fn a_norm_in_device_coordinates_is_added_for_what_was_seen() {
    // The first: (3, 1) per pixel is (60, 40) per half an image of 40 × 80 pixels; the second: (14, 0) is 280.
    let got = cues([2, 2], [4.0, 0.0], 0);
    let want = [100.0 + 60.0f64.hypot(40.0), 480.0, 2.0, 3.0];
    assert!(
        got.iter().zip(want).all(|(g, w)| (g - w).abs() < 1e-9),
        "{got:?} {want:?}"
    );
    let unseen = cues([2, 0], [4.0, 0.0], 0);
    assert_eq!(unseen[1..], [200.0, 2.0, 2.0]);
}

/// The stage project_grad leaves the sums of a large Gaussian in its first slot in the group style, and nothing else is read.
#[test]
fn of_a_large_gaussian_one_slot_is_read_in_the_group_style() {
    let device = device();
    let pairs = LARGE_PAIRS as usize + 1;
    let norms = |tuning: Tuning| {
        let kernels = Kernels::new(&device, Defines::new(tuning));
        let mut sums = vec![0.0; pairs * SUMS];
        for pair in sums.chunks_exact_mut(SUMS) {
            pair[1] = 1.0;
        }
        let (frame, scene) = seen(&kernels, &[0], &[pairs as u32], &sums);
        let cues = Array::zeros(&device, "cues", 2).unwrap();
        let stage = kernels.build::<f64>("screen_grad").unwrap();
        add_norms(&stage, &scene, &frame, &cues).unwrap();
        cues.to_vec().unwrap()
    };
    let group = Tuning {
        chunks: 64,
        ..Tuning::GPU
    };
    // Half of a width of 40 pixels for each pair.
    let apart = |got: f64, want: f64| (got - want).abs();
    assert!(apart(norms(group)[0], 20.0) < 1e-9, "{:?}", norms(group));
    let all = norms(Tuning::for_device(device.info()));
    assert!(apart(all[0], 20.0 * pairs as f64) < 1e-6, "{all:?}");
}

#[test]
fn what_is_not_finite_or_overflowed_does_not_count() {
    assert_eq!(cues([2, 2], [f64::NAN, 0.0], 0)[1..], [200.0, 2.0, 2.0]);
    assert_eq!(cues([2, 2], [4.0, 0.0], 5), [100.0, 200.0, 1.0, 2.0]);
}

/// Moving the principal point moves the projected centre and nothing else, so the loss changes by the centre's gradient.
#[test]
fn the_gradient_by_the_mean_is_a_finite_difference() {
    let mut case = cases::mild("one", 1, [40, 30], 0, 37);
    // Without the cut, which is no part of the derivative.
    case.alpha_min = 1e-12;
    case.splats.scatter(0, 0, [0.1f32, 0.05, 0.2]);
    case.splats.scatter(3, 0, [-1.6f32, -1.2, -2.0]);
    let Reference {
        scene,
        camera,
        options,
        photo,
        pass,
        ..
    } = Reference::new(&case);
    let sums = pass.sums[0].unwrap();
    let shape = shape(&scene, 0, &camera).unwrap();
    let got = mean_gradient(&shape, &sums);
    let loss = |camera: &Camera64| loss_of(&scene, camera, &options, &photo, case.lambdas);
    for (k, got) in got.into_iter().enumerate() {
        let shifted = |by: f64| {
            let mut camera = camera;
            camera.principal[k] += by;
            loss(&camera)
        };
        let h = 1e-4;
        let want = (shifted(h) - shifted(-h)) / (2.0 * h);
        assert!((got - want).abs() < 1e-5 * want.abs(), "{k}: {got} {want}");
    }
}
