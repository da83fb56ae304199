//! adam: the optimiser.

use super::*;
use mhsplat::device::Array;
use mhsplat::device::tuning::status::{NON_FINITE, OVERFLOW};
use mhsplat::pipeline::buffers::{GaussianBuffers, GradientBlock, ViewBuffers};
use mhsplat::pipeline::stage::adam::{Step, adam, update};

#[test]
fn agrees_with_the_reference() {
    agrees("adam");
}

#[test]
fn wrong_parameters_are_rejected() {
    rejects("adam", "first moments", |moments| {
        moments.iter_mut().for_each(|m| *m *= 1.01)
    });
}

/// Parameters and status after one step of 256 Gaussians at 1.0 with the given gradients in every plane.
fn step(gradient: impl Fn(usize) -> f32, overflow: u32) -> (Vec<f32>, Vec<u32>) {
    step_of(0..256, gradient, overflow)
}

/// [`step`] of one block; the gradients are indexed from its start.
fn step_of(
    block: std::ops::Range<usize>,
    gradient: impl Fn(usize) -> f32,
    overflow: u32,
) -> (Vec<f32>, Vec<u32>) {
    step_at(block, gradient, overflow, 1)
}

/// [`step_of`] with the number of the step; all moments are 0 before it.
fn step_at(
    block: std::ops::Range<usize>,
    gradient: impl Fn(usize) -> f32,
    overflow: u32,
    t: u32,
) -> (Vec<f32>, Vec<u32>) {
    let device = device();
    let kernels = kernels(&device);
    let (stride, planes) = (256, 14);
    let array = |name, v: f32| Array::from_slice(&device, name, &vec![v; planes * stride]).unwrap();
    let grads: Vec<f32> = (0..planes * stride).map(|k| gradient(k % stride)).collect();
    let grads = Array::from_slice(&device, "grads", &grads).unwrap();
    let scene = GaussianBuffers {
        params: array("params", 1.0),
        filter: Array::zeros(&device, "filter", 0).unwrap(),
        stride,
        count: stride,
        sh_degree: 0,
        shard: None,
    };
    let (m, v) = (array("m", 0.0), array("v", 0.0));
    let frame = ViewBuffers::new(&device, &kernels.defines().tuning, false).unwrap();
    frame.status.write(OVERFLOW as usize, &[overflow]).unwrap();
    let case = cases::mild("rates", 1, [1, 1], 0, 1);
    let grads = GradientBlock {
        values: &grads,
        planes,
        stride,
        first: block.start,
        rows: block,
        views: 1,
    };
    let step = Step {
        rate: case.rates,
        constants: [0.9, 0.999, 1e-15],
        t,
    };
    let stage = kernels.build::<f32>("adam").unwrap();
    update(&stage, &scene, [&m, &v], &grads, &step, &frame).unwrap();
    (
        scene.params.to_vec().unwrap(),
        frame.status.to_vec().unwrap(),
    )
}

#[test]
fn the_first_step_is_the_learning_rate_times_the_sign() {
    let (params, _) = step(|i| if i % 2 == 0 { 3e-7 } else { -40.0 }, 0);
    for (p, rate) in [(0, 1e-3), (3, 5e-3), (6, 1e-3), (10, 0.025), (11, 2.5e-3)] {
        assert!((params[p * 256] - (1.0 - rate)).abs() < 1e-6, "plane {p}");
        assert!(
            (params[p * 256 + 1] - (1.0 + rate)).abs() < 1e-6,
            "plane {p}"
        );
    }
}

/// A row whose moments were cleared in mid-run: the bias correction is that of the run's step, so that its first step is twice
/// the rate.
#[test]
fn a_cleared_row_steps_by_the_number_of_the_run() {
    let (t, factor) = (500, 0.1 / (1e-3f64 / (1.0 - 0.999f64.powi(500))).sqrt());
    let (params, _) = step_at(0..256, |i| if i % 2 == 0 { 3e-7 } else { -40.0 }, 0, t);
    for (p, rate) in [(0, 1e-3), (10, 0.025)] {
        let moved = [params[p * 256], params[p * 256 + 1]].map(|v| f64::from(v) - 1.0);
        let error = [moved[0] + factor * rate, moved[1] - factor * rate];
        assert!(
            error.iter().all(|e| e.abs() < 1e-5 * rate.max(1e-2)),
            "{moved:?}"
        );
    }
    let step = Step {
        rate: 1.0,
        constants: [0.9, 0.999, 1e-15],
        t,
    };
    let (mut value, mut m, mut v) = ([0.0], [0.0], [0.0]);
    adam(&[-40.0], &step, &mut value, &mut m, &mut v);
    assert!((value[0] - factor).abs() < 1e-9, "{}", value[0]);
}

#[test]
fn gradients_that_are_not_finite_are_counted_and_change_nothing() {
    let bad = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY];
    let (params, status) = step(|i| bad.get(i).copied().unwrap_or(0.0), 0);
    assert_eq!(status[NON_FINITE as usize], 3 * 14);
    assert!(params.iter().all(|p| *p == 1.0));
}

#[test]
fn nothing_happens_after_an_overflow() {
    let (params, _) = step(|_| 1.0, 12345);
    assert!(params.iter().all(|p| *p == 1.0));
}

#[test]
fn a_block_changes_its_own_gaussians_alone() {
    let (params, _) = step_of(64..96, |i| if i < 32 { 1.0 } else { 7.0 }, 0);
    for (i, p) in params.iter().enumerate() {
        assert_eq!(*p != 1.0, (64..96).contains(&(i % 256)), "{i}");
    }
}
