//! The reference itself against numbers known by other means, and the comparator against results it must refuse.

use mhsplat::base::math::sigmoid;
use mhsplat::lab::error::{Tolerance, compare};
use mhsplat::lab::verify::{cases, definition};
use mhsplat::pipeline::reference::{Camera64, Options, Scene64, TILE, rotation, unit_quaternion};
use mhsplat::pipeline::stage::bin::bin;
use mhsplat::pipeline::stage::loss::loss;
use mhsplat::pipeline::stage::project::project;
use mhsplat::pipeline::stage::splat;
use mhsplat::scene::{Gaussians, Plane, sh};

/// One Gaussian of the given log-scale in front of a camera that looks along z from the origin.
fn alone(log_scale: f32, logit: f32, depth: f32) -> (Scene64, Camera64, Options) {
    let mut splats = Gaussians::zeros(0, 1);
    splats.scatter(Plane::POSITION, 0, [0.0, 0.0, depth]);
    splats.scatter(Plane::LOG_SCALE, 0, [log_scale; 3]);
    splats.scatter(Plane::ROTATION, 0, [1.0, 0.0, 0.0, 0.0]);
    splats.scatter(Plane::OPACITY, 0, [logit]);
    let mut case = cases::mild("alone", 1, [32, 32], 0, 1);
    case.splats = splats;
    case.background = [0.0; 3];
    let camera = &mut case.camera;
    camera.rotation = glam::DMat3::IDENTITY;
    camera.translation = glam::DVec3::ZERO;
    (camera.cx, camera.cy, camera.fx, camera.fy) = (16.5, 16.5, 40.0, 40.0);
    definition::inputs(&case)
}

#[test]
fn an_isotropic_gaussian_projects_as_a_round_blur() {
    // σ = e^-2 at depth 2 under a focal length of 40: (40/2)²·e^-4 + 0.3 pixels² in each direction, no correlation.
    let (scene, camera, options) = alone(-2.0, 0.0, 2.0);
    let projected = project(&scene, 0, &camera, &options).unwrap();
    let variance = 400.0 * (-4.0f64).exp() + 0.3;
    let half_log2e = 0.5 * std::f64::consts::LOG2_E;
    assert_eq!(projected.mean, [16.5, 16.5]);
    assert!((projected.a - half_log2e / variance).abs() < 1e-12);
    assert!((projected.c - half_log2e / variance).abs() < 1e-12);
    assert!(projected.r.abs() < 1e-15);
    assert!((projected.lo + 1.0).abs() < 1e-12, "log2 of opacity ½");
    // Support: |d|² ≤ 2 variance ln(255 · ½); bounds hold the pixels whose centres are inside.
    let reach = (2.0 * variance * (255.0f64 * 0.5).ln()).sqrt();
    let first = (16.5 - reach - 0.5).ceil() as i32;
    assert_eq!(projected.bounds[0], [first, 32 - first]);
}

#[test]
fn with_anti_aliasing_the_blur_is_a_tenth_and_takes_its_share_of_the_opacity() {
    // Without a 3D filter (0): det0 = s², det = (s + 0.1)² with s = 400·e^-4.
    let (mut scene, camera, options) = alone(-2.0, 0.0, 2.0);
    scene.filter = Some(vec![0.0]);
    let projected = project(&scene, 0, &camera, &options).unwrap();
    let own = 400.0 * (-4.0f64).exp();
    let half_log2e = 0.5 * std::f64::consts::LOG2_E;
    assert!((projected.a - half_log2e / (own + 0.1)).abs() < 1e-12);
    let opacity = 0.5 * own / (own + 0.1);
    assert!((projected.lo - opacity.log2()).abs() < 1e-12);
}

#[test]
fn the_centre_pixel_shows_opacity_times_colour() {
    let (scene, camera, options) = alone(-2.0, 0.0, 2.0);
    let all = vec![project(&scene, 0, &camera, &options)];
    let tiles = bin(&all, &camera, TILE, options.alpha_min);
    let (image, transmittance) = splat::splat(&all, &tiles, &camera, &options);
    // SH coefficient 0 gives colour ½; the mean lies on the centre of pixel (16, 16).
    let at = 16 * 32 + 16;
    assert!((image[at] - 0.25).abs() < 1e-12, "{}", image[at]);
    assert!((transmittance[at] - 0.5).abs() < 1e-12);
    assert_eq!(transmittance[0], 1.0, "the corner is beyond the support");
}

#[test]
fn identical_images_have_no_loss_and_noise_has_some() {
    let x: Vec<f64> = (0..3 * 20 * 14)
        .map(|i| f64::from(i * 37 % 101) / 100.0)
        .collect();
    let same = loss(&x, &x, [20, 14], 0.2);
    assert!(same.l1 == 0.0 && (same.ssim - 1.0).abs() < 1e-12);
    let y: Vec<f64> = x.iter().map(|v| 1.0 - v).collect();
    let other = loss(&x, &y, [20, 14], 0.2);
    assert!(other.l1 > 0.1 && other.ssim < 0.0, "{other:?}");
    // Two flat images: SSIM = (2ab + C1)/(a² + b² + C1) away from the border, L1 = |a − b|.
    let flat = |v: f64| vec![v; 3 * 160 * 160];
    let l = loss(&flat(0.25), &flat(0.75), [160, 160], 0.2);
    assert!((l.l1 - 0.5).abs() < 1e-12);
    let inner = (2.0 * 0.25 * 0.75 + 1e-4) / (0.0625 + 0.5625 + 1e-4);
    assert!((l.ssim - inner).abs() < 0.03, "{} against {inner}", l.ssim);
}

#[test]
fn spherical_harmonics_are_orthonormal() {
    // ∫ Y_a Y_b over the sphere by the product of Gauss-like rules: midpoints in z are exact enough at this order.
    let (n, m) = (400, 64);
    let mut gram = [[0.0; 16]; 16];
    for i in 0..n {
        let z = (2.0 * (f64::from(i) + 0.5) / f64::from(n)) - 1.0;
        for j in 0..m {
            let phi = std::f64::consts::TAU * (f64::from(j) + 0.5) / f64::from(m);
            let s = (1.0 - z * z).sqrt();
            let basis = sh::basis([s * phi.cos(), s * phi.sin(), z]);
            for (a, row) in gram.iter_mut().enumerate() {
                for (b, v) in row.iter_mut().enumerate() {
                    *v += basis[a] * basis[b];
                }
            }
        }
    }
    let weight = 4.0 * std::f64::consts::PI / f64::from(n * m);
    for (a, row) in gram.iter().enumerate() {
        for (b, v) in row.iter().enumerate() {
            let want = f64::from(u8::from(a == b));
            assert!((v * weight - want).abs() < 1e-4, "{a} {b}: {}", v * weight);
        }
    }
}

#[test]
fn quaternions_of_any_norm_are_rotations() {
    for scale in [1e-200, 1e-20, 1.0, 1e20, 1e200] {
        let (q, norm) = unit_quaternion([0.3, -0.4, 0.5, 0.1].map(|v| v * scale));
        assert!((q.iter().map(|v| v * v).sum::<f64>() - 1.0).abs() < 1e-14);
        assert!((norm / scale - 0.51f64.sqrt()).abs() < 1e-14);
        let r = rotation(q);
        for a in 0..3 {
            for b in 0..3 {
                let dot: f64 = (0..3).map(|k| r[a][k] * r[b][k]).sum();
                assert!((dot - f64::from(u8::from(a == b))).abs() < 1e-14);
            }
        }
    }
    assert_eq!(unit_quaternion([0.0; 4]), ([1.0, 0.0, 0.0, 0.0], 0.0));
    assert_eq!((sigmoid(800.0), sigmoid(-800.0)), (1.0, 0.0));
}

#[test]
fn the_comparator_refuses_what_it_must() {
    let want = [1.0, -2.0, 3.0, 0.5];
    let t = Tolerance::all(1e-3);
    let fails = |got: &[f64]| compare(got, &want, t).is_err();
    assert!(!fails(&want));
    assert!(!fails(&[1.0005, -2.0, 3.0, 0.5]));
    assert!(fails(&[1.01, -2.0, 3.0, 0.5]), "an element");
    assert!(fails(&[1.0, -2.0, 3.0]), "a length");
    assert!(fails(&[1.0, -2.0, f64::NAN, 0.5]), "a NaN");
    assert!(fails(&[1.0, -2.0, f64::INFINITY, 0.5]), "an infinity");
    assert!(fails(&[0.0; 4]), "silently zero");
    assert!(fails(&want.map(|v| -v)), "a sign");
    let loose = Tolerance { element: 10.0, ..t };
    assert!(
        compare(&want.map(|v| 1.1 * v), &want, loose).is_err(),
        "the norm"
    );
    let no_norm = Tolerance { l2: 10.0, ..loose };
    assert!(
        compare(&[3.0, 2.0, 1.0, -0.5], &want, no_norm).is_err(),
        "the angle"
    );
    let one_flip = t.with_flips(1, 1.0);
    assert!(compare(&[1.5, -2.0, 3.0, 0.5], &want, one_flip).is_ok());
    assert!(
        compare(&[1.5, -2.5, 3.0, 0.5], &want, one_flip).is_err(),
        "two flips"
    );
    // Noise where in truth there is nothing, beside terms of 1.
    let floored = Tolerance { floor: 1.0, ..t };
    let (nothing, noise) = ([1e-9, 0.0, -2e-9], [3e-5, -4e-5, 0.0]);
    assert!(compare(&noise, &nothing, t).is_err());
    assert!(compare(&noise, &nothing, floored).is_ok());
    assert!(compare(&[0.0; 3], &nothing, floored).is_ok());
    let wrong = [3e-5, -4e-3, 0.0];
    assert!(compare(&wrong, &nothing, floored).is_err(), "the floor");
    assert!(compare(&[0.0; 4], &want, floored).is_err(), "still zero");
}
