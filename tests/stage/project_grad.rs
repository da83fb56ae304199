//! project_grad: gradients of the raw parameters.

use super::*;
use mhsplat::scene::Plane;

#[test]
fn agrees_with_the_reference() {
    agrees("project_grad");
}

#[test]
fn wrong_gradients_are_rejected() {
    for group in ["position", "log-scale", "rotation", "opacity", "SH"] {
        rejects("project_grad", group, |grads| {
            grads[..60].iter_mut().for_each(|g| *g *= -1.0)
        });
    }
}

/// Planes of the gradients.
fn gradients(out: &Outcome, n: usize) -> Vec<Vec<f64>> {
    let groups = out.quantities.iter().filter(|q| q.stage == "project_grad");
    groups
        .flat_map(|q| q.got.chunks(n).map(<[f64]>::to_vec))
        .collect()
}

#[test]
fn anti_aliasing_has_gradients_of_its_own() {
    let case = anti_aliased();
    let with = run(Tuning::CPU, &case);
    let plain = Case {
        filter_views: Vec::new(),
        ..case
    };
    let without = run(Tuning::CPU, &plain);
    assert_ne!(gradients(&with, 90), gradients(&without, 90));
}

/// Pancakes from 2 % of a turn off edge-on to edge-on exactly, thin ones down to the thinnest there are, with and without a 3D
/// filter worth the name: every gradient is a number.
#[test]
fn anti_aliasing_keeps_gradients_finite_edge_on() {
    for thin in [-6.0f32, -12.0, -30.0, -40.0] {
        let mut case = cases::mild("edge-on", 64, [40, 30], 0, 34).anti_aliased(1);
        case.camera.rotation = glam::DMat3::IDENTITY;
        for i in 0..64 {
            let s = &mut case.splats;
            let tilt = 1e-3 * (i / 2) as f32 / 32.0;
            s.scatter(Plane::POSITION, i, [0.0, 0.0, 0.0]);
            s.scatter(Plane::LOG_SCALE, i, [-1.0, thin, -1.0 - (i % 2) as f32]);
            s.scatter(Plane::ROTATION, i, [1.0, tilt, 0.0, 0.0]);
            s.scatter(Plane::OPACITY, i, [4.0]);
        }
        // Views so near that the filter is nothing, and those of the case.
        for views in [case.filter_views.clone(), vec![fine(&case)]] {
            case.filter_views = views;
            let out = run(Tuning::CPU, &case);
            let grads = gradients(&out, 64).concat();
            assert!(grads.iter().all(|g| g.is_finite()), "{thin}");
            let image = out.got("splat", "image");
            assert!(image.iter().all(|v| v.is_finite()), "{thin}");
        }
    }
}

/// The case's camera with a focal length of a million pixels.
fn fine(case: &Case) -> mhsplat::capture::Camera {
    mhsplat::capture::Camera {
        fx: 1e6,
        fy: 1e6,
        ..case.camera
    }
}

#[test]
fn culled_gaussians_have_the_regularisers_alone() {
    let mut case = cases::mild("behind", 4, [20, 20], 1, 33);
    case.splats.plane_mut(2).fill(-100.0);
    let out = run(Tuning::CPU, &case);
    for (p, plane) in gradients(&out, 4).iter().enumerate() {
        let regularised = p == Plane::OPACITY || (Plane::LOG_SCALE..Plane::ROTATION).contains(&p);
        assert!(
            plane
                .iter()
                .all(|g| if regularised { *g > 0.0 } else { *g == 0.0 }),
            "plane {p}"
        );
    }
}
