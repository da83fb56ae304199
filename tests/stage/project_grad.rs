//! project_grad: gradients of the raw parameters.

use super::*;
use mhsplat::model::Plane;

#[test]
fn agrees_with_the_reference() {
    agrees("project_grad");
}

#[test]
fn wrong_gradients_are_rejected() {
    for plane in [
        Plane::POSITION,
        Plane::LOG_SCALE,
        Plane::ROTATION,
        Plane::OPACITY,
        Plane::SH,
    ] {
        rejects("project_grad", |out| {
            out.grads[plane].iter_mut().for_each(|g| *g *= -1.0)
        });
    }
}

#[test]
fn culled_gaussians_have_the_regularisers_alone() {
    let device = device();
    let mut case = cases::mild("behind", 4, [20, 20], 1, 33);
    case.splats.plane_mut(2).fill(-100.0);
    let out = chain::run::<f32>(&device, Tuning::CPU, &case).unwrap();
    for (p, plane) in out.grads.iter().enumerate() {
        let regularised = p == Plane::OPACITY || (Plane::LOG_SCALE..Plane::ROTATION).contains(&p);
        assert!(
            plane
                .iter()
                .all(|g| if regularised { *g > 0.0 } else { *g == 0.0 }),
            "plane {p}"
        );
    }
}
