//! Gradients of the whole pass against finite differences of the reference's loss.
//!
//! The alpha cut is a discontinuity at which finite differences disagree even in sign, so it lies at 1e-7 here; the bounds
//! of the ellipses move with it.

use crate::device;
use mhsplat::device::tuning::Tuning;
use mhsplat::lab::error::{Tolerance, compare};
use mhsplat::lab::verify::cases::{self, Case};
use mhsplat::lab::verify::definition::{Reference, inputs, photo};
use mhsplat::lab::verify::pass;
use mhsplat::pipeline::reference::Scene64;
use mhsplat::pipeline::reference_pass::loss_of;
use mhsplat::scene::Plane;

/// Step of the central differences: truncation (h²) and rounding (1e-16/h) meet near it.
const STEP: f64 = 1e-5;

/// Central differences of loss that are O(1): truncation and rounding leave about 1e-10 of the largest element; the cut,
/// lowered but not gone, another 1e-7.
const DIFFERENCES: Tolerance = Tolerance::all(2e-6);

/// One Gaussian of the first case moves across a pixel's last layer within the step (transmittance at its bound): a
/// position and three components of the quaternion differ there, and no more than that may.
const ACROSS_A_BOUND: Tolerance = DIFFERENCES.with_flips(3, 0.01);

fn case(name: &str, size: [u32; 2], sh_degree: u32, seed: u64) -> Case {
    let mut case = cases::mild(name, 12, size, sh_degree, seed);
    // Nothing in the scene may sit at the cap of alpha, another discontinuity of the derivative.
    for i in 0..case.splats.len() {
        let logit = case.splats.planes()[Plane::OPACITY][i];
        case.splats.scatter(Plane::OPACITY, i, [logit.min(1.5)]);
    }
    case.alpha_min = 1e-7;
    case
}

fn needles(seed: u64) -> Case {
    Case {
        alpha_min: 1e-7,
        ..cases::needles(8, [40, 30], seed)
    }
}

/// Gaussians of one shape at all angles, thin enough for the filters and not so thin that these leave too little of their
/// opacity for finite differences.
fn thin(name: &str, log_scales: [f32; 3], seed: u64) -> Case {
    let mut case = case(name, [40, 30], 0, seed);
    for i in 0..case.splats.len() {
        case.splats.scatter(Plane::LOG_SCALE, i, log_scales);
    }
    case.anti_aliased(4)
}

fn differences(case: &Case) -> Vec<Vec<f64>> {
    let (scene, camera, options) = inputs(case);
    let photo = photo(case);
    let loss = |scene: &Scene64| loss_of(scene, &camera, &options, &photo, case.lambdas);
    let mut moved = scene.clone();
    (0..scene.planes.len())
        .map(|p| {
            (0..scene.len())
                .map(|i| {
                    let at = scene.planes[p][i];
                    let mut side = |h: f64| {
                        moved.planes[p][i] = at + h;
                        loss(&moved)
                    };
                    let slope = (side(STEP) - side(-STEP)) / (2.0 * STEP);
                    moved.planes[p][i] = at;
                    slope
                })
                .collect()
        })
        .collect()
}

/// The parameter groups, so that none hides behind another's larger gradients.
fn groups(planes: usize) -> [(&'static str, std::ops::Range<usize>); 5] {
    [
        ("position", 0..3),
        ("log-scale", 3..6),
        ("rotation", 6..10),
        ("opacity", 10..11),
        ("SH", 11..planes),
    ]
}

fn assert_same(what: &str, got: &[Vec<f64>], want: &[Vec<f64>], tolerance: Tolerance) {
    for (group, planes) in groups(want.len()) {
        let flat = |v: &[Vec<f64>]| -> Vec<f64> { v[planes.clone()].concat() };
        let result = compare(&flat(got), &flat(want), tolerance);
        assert!(result.is_ok(), "{what}, {group}: {result:?}");
    }
}

fn cases() -> Vec<(Case, Tolerance)> {
    let mut off_center = case("cx, cy, alpha", [33, 21], 1, 33).with_alpha();
    off_center.camera.cx += 3.3;
    vec![
        (case("SH 3", [40, 30], 3, 31), ACROSS_A_BOUND),
        (case("SH 2, wide", [70, 18], 2, 32), DIFFERENCES),
        (off_center, DIFFERENCES),
        (needles(34), DIFFERENCES),
        (
            case("anti-aliased", [40, 30], 1, 36).anti_aliased(1),
            DIFFERENCES,
        ),
        (
            thin("needles, anti-aliased", [-0.8, -5.4, -5.6], 37),
            DIFFERENCES,
        ),
        (
            thin("pancakes, anti-aliased", [-1.6, -1.8, -6.2], 38),
            DIFFERENCES,
        ),
    ]
}

#[test]
fn the_reference_is_the_derivative_of_its_own_loss() {
    for (case, tolerance) in cases() {
        let reference = Reference::new(&case).pass;
        assert_same(
            &case.name,
            &reference.grads.planes,
            &differences(&case),
            tolerance,
        );
    }
}

#[test]
fn the_f64_kernels_are_the_derivative_of_the_reference_loss() {
    let device = device();
    if !device.info().fp64 {
        println!("skipped: {} has no f64", device.info().name);
        return;
    }
    let tuning = Tuning::for_device(device.info());
    for (case, tolerance) in cases() {
        let out = pass::run::<f64>(&device, tuning, &case, None).unwrap();
        let grads = out.quantities.iter().filter(|q| q.stage == "project_grad");
        let planes = grads.flat_map(|q| q.got.chunks(case.splats.len()).map(<[f64]>::to_vec));
        let planes: Vec<Vec<f64>> = planes.collect();
        assert_same(&case.name, &planes, &differences(&case), tolerance);
    }
}

#[test]
fn a_wrong_sign_a_zero_and_a_lost_factor_are_noticed() {
    let case = case("wrong", [40, 30], 1, 35);
    let want = differences(&case);
    let good = Reference::new(&case).pass.grads.planes;
    let noticed = |spoil: &dyn Fn(&mut Vec<f64>)| {
        groups(good.len()).iter().all(|(_, planes)| {
            let mut bad = good.clone();
            bad[planes.clone()].iter_mut().for_each(spoil);
            let flat = |v: &[Vec<f64>]| v[planes.clone()].concat();
            compare(&flat(&bad), &flat(&want), DIFFERENCES).is_err()
        })
    };
    assert!(noticed(&|p| p.iter_mut().for_each(|v| *v = -*v)));
    assert!(noticed(&|p| p.iter_mut().for_each(|v| *v = 0.0)));
    assert!(noticed(&|p| p.iter_mut().for_each(|v| *v *= 1.001)));
    assert!(noticed(&|p| p[0] = f64::NAN));
}
