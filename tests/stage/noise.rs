//! noise: random steps of the positions.

use glam::{DMat3, DQuat, DVec3};

use super::*;
use mhsplat::base::rng::{Philox, Stream};
use mhsplat::density::NoiseLaw;
use mhsplat::device::tuning::status::OVERFLOW;
use mhsplat::pipeline::buffers::{GaussianBuffers, ViewBuffers};
use mhsplat::pipeline::stage::noise::perturb;
use mhsplat::scene::{Gaussians, Plane};

/// [MCMC]'s gate: k = 100, x₀ = 0.005.
const PUBLISHED: [f64; 2] = [100.0, 0.005];

#[test]
fn agrees_with_the_reference() {
    agrees("noise");
}

#[test]
fn a_wrong_step_is_rejected() {
    rejects("noise", "displacement", |moved| moved[67] *= 1.001);
}

/// `n` Gaussians at the origin with these scales, this rotation and this opacity.
fn alike(n: usize, scale: [f64; 3], rotation: [f32; 4], opacity: f64) -> Gaussians {
    let mut s = Gaussians::zeros(0, n);
    for i in 0..n {
        s.scatter(Plane::LOG_SCALE, i, scale.map(|v| v.ln() as f32));
        s.scatter(Plane::ROTATION, i, rotation);
        s.scatter(Plane::OPACITY, i, [(opacity / (1.0 - opacity)).ln() as f32]);
    }
    s
}

struct Draw {
    seed: u64,
    iteration: u32,
    rate: f64,
    overflow: u32,
    tuning: Tuning,
}

impl Draw {
    fn new(seed: u64, iteration: u32, rate: f64) -> Self {
        Self {
            seed,
            iteration,
            rate,
            overflow: 0,
            tuning: Tuning::for_device(device().info()),
        }
    }

    /// Positions x, y, z of all rows of the stride, after one step in f64.
    fn positions(&self, splats: &Gaussians) -> [Vec<f64>; 3] {
        let device = device();
        let kernels = Kernels::new(&device, Defines::new(self.tuning));
        let scene = GaussianBuffers::<f64>::upload(&device, splats, 0).unwrap();
        let frame = ViewBuffers::new(&device, &self.tuning, false).unwrap();
        let flag = OVERFLOW as usize;
        frame.status.write(flag, &[self.overflow]).unwrap();
        let law = NoiseLaw {
            rate: self.rate,
            steepness: PUBLISHED[0],
            opacity: PUBLISHED[1],
        };
        let stream = Stream::Noise.stream(self.iteration);
        let stage = kernels.build::<f64>("noise").unwrap();
        perturb(&stage, &scene, &frame, &law, [self.seed, stream]).unwrap();
        let plane = |k| scene.params.read(k * scene.stride, scene.stride).unwrap();
        [plane(0), plane(1), plane(2)]
    }
}

#[test]
fn the_step_is_the_published_one() {
    let (rotation, scale, opacity) = ([0.9f32, -0.3, 0.5, 0.2], [0.02, 0.3, 0.001], 0.012);
    let splats = alike(33, scale, rotation, opacity);
    let rate = 5e5 * 1.6e-4;
    let [xs, ys, zs] = Draw::new(9, 41, rate).positions(&splats);
    // As the released code writes it: L = R·S, covariance L·Lᵀ, gate on 1 − o. All in f64, from the f32 parameters.
    let [w, x, y, z] = rotation.map(f64::from);
    let r = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
    let [l]: [[f32; 3]; 1] = [splats.gather(Plane::LOG_SCALE, 0)];
    let l = r * DMat3::from_diagonal(DVec3::from_array(l.map(|v| f64::from(v).exp())));
    let [logit]: [f32; 1] = splats.gather(Plane::OPACITY, 0);
    let o = 1.0 / (1.0 + (-f64::from(logit)).exp());
    let gate = 1.0 / (1.0 + (-100.0 * ((1.0 - o) - 0.995)).exp());
    let steps = xs.iter().zip(&ys).zip(&zs).take(33);
    for (i, ((x, y), z)) in steps.enumerate() {
        let [a, b, c, _] = Philox::normal(9, Stream::Noise.stream(41), i as u64);
        let want = l * l.transpose() * DVec3::new(a, b, c) * gate * rate;
        let step = DVec3::new(*x, *y, *z);
        assert!(
            (step - want).length() <= 1e-9 * want.length(),
            "{i}: {step} {want}"
        );
    }
}

#[test]
fn steps_have_mean_zero_and_the_covariance_squared() {
    let n = 40_000;
    // A turn by 90° about z: the first axis of the Gaussian is the scene's y.
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let (scale, opacity) = ([0.3, 0.1, 0.05], 0.005);
    let splats = alike(n, scale, [half, 0.0, 0.0, half], opacity);
    let rate = 10.0;
    let got = Draw::new(3, 5, rate).positions(&splats);
    // The gate is one half at x₀; a step along an axis of scale s has the deviation s²·rate/2.
    for (axis, s) in [(1, 0.3), (0, 0.1), (2, 0.05)] {
        let want: f64 = s * s * rate / 2.0;
        let values = &got[axis][..n];
        let mean = values.iter().sum::<f64>() / n as f64;
        let deviation = (values.iter().map(|v| v * v).sum::<f64>() / n as f64).sqrt();
        // Five standard errors of the mean and of the deviation.
        assert!(
            mean.abs() < 5.0 * want / (n as f64).sqrt(),
            "{axis}: {mean}"
        );
        let off = (deviation / want - 1.0).abs();
        assert!(off < 5.0 / (2.0 * n as f64).sqrt(), "{axis}: {deviation}");
        let fourth = values.iter().map(|v| (v / want).powi(4)).sum::<f64>() / n as f64;
        assert!((fourth - 3.0).abs() < 5.0 * (96.0 / n as f64).sqrt());
    }
    let cross: f64 = (0..n).map(|i| got[0][i] * got[1][i]).sum::<f64>() / n as f64;
    let unit = 0.1f64.powi(2) * 0.3f64.powi(2) * (rate / 2.0).powi(2);
    assert!((cross / unit).abs() < 5.0 / (n as f64).sqrt(), "{cross}");
}

#[test]
fn what_is_opaque_stays() {
    let step = |opacity| {
        let got =
            Draw::new(1, 1, 1.0).positions(&alike(16, [1.0; 3], [1.0, 0.0, 0.0, 0.0], opacity));
        got[0][..16].iter().map(|v| v.abs()).fold(0.0, f64::max)
    };
    assert!(step(0.001) > 0.3);
    assert!(step(0.5) < 1e-20 && step(0.5) > 0.0);
}

#[test]
fn numbers_are_keyed_by_seed_iteration_and_index_alone() {
    let splats = alike(100, [0.5; 3], [1.0, 0.0, 0.0, 0.0], 0.005);
    let one = Draw::new(7, 3, 1.0).positions(&splats);
    assert!(one == Draw::new(7, 3, 1.0).positions(&splats));
    let differs = |other: [Vec<f64>; 3]| (0..100).all(|i| other[0][i] != one[0][i]);
    assert!(differs(Draw::new(8, 3, 1.0).positions(&splats)));
    assert!(differs(Draw::new(7 | 1 << 32, 3, 1.0).positions(&splats)));
    assert!(differs(Draw::new(7, 4, 1.0).positions(&splats)));
    // Another vector width rounds alike to 1e-14 and draws the same.
    let scalar = Draw {
        tuning: Tuning {
            chunks: 64,
            ..Tuning::GPU
        },
        ..Draw::new(7, 3, 1.0)
    };
    let other = scalar.positions(&splats);
    for k in 0..3 {
        assert!((0..100).all(|i| (other[k][i] - one[k][i]).abs() < 1e-14));
        let beyond = one[k][100..].iter().chain(&other[k][100..]);
        assert!(
            beyond.copied().all(|v| v == 0.0),
            "rows beyond the last Gaussian stay"
        );
    }
}

#[test]
fn nothing_moves_after_an_overflow_or_to_infinity() {
    let splats = alike(20, [0.5; 3], [1.0, 0.0, 0.0, 0.0], 0.005);
    let stopped = Draw {
        overflow: 12,
        ..Draw::new(7, 3, 1.0)
    };
    let zero = |p: [Vec<f64>; 3]| p.iter().flatten().all(|v| *v == 0.0);
    assert!(zero(stopped.positions(&splats)));
    assert!(zero(Draw::new(7, 3, f64::INFINITY).positions(&splats)));
    assert!(!zero(Draw::new(7, 3, 1.0).positions(&splats)));
}
