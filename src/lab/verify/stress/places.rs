//! Stiff places: near, far, beside and around the camera.

use glam::{DMat3, DVec3};

use crate::base::constants::NEAR;
use crate::lab::verify::cases::{Case, mild};
use crate::lab::verify::stress::family::{
    Family, MIXED, WELL, each, family, position, powers, uniform,
};
use crate::scene::Plane;

/// A case whose scene and camera distance are `by` times as large.
fn scaled(mut case: Case, by: f64) -> Case {
    case.camera.translation *= by;
    for i in 0..case.splats.len() {
        let x = position(&case.splats, i) * by;
        case.splats
            .scatter(Plane::POSITION, i, x.as_vec3().to_array());
        let scales: [f32; 3] = case.splats.gather(Plane::LOG_SCALE, i);
        let larger = scales.map(|l| (f64::from(l) + by.ln()) as f32);
        case.splats.scatter(Plane::LOG_SCALE, i, larger);
    }
    case
}

pub(super) fn depth() -> Family {
    let case = |by: f64| {
        let name = format!("scene and distance times {by:.0e}");
        let mut case = scaled(mild(&name, 100, [64, 48], 1, 65), by);
        // The regulariser of the scales grows with them, and would be all that there is in their gradient.
        case.lambdas[2] = 0.0;
        (by, case)
    };
    let why = "as well-conditioned as at 1, with the regulariser of the scales beside gradients of another size";
    family(
        "depth",
        "distance, local units",
        MIXED,
        why,
        powers(-3..=6, 1).map(case),
    )
}

/// A case whose camera looks along z from the origin, so that depths are exact.
fn straight(mut case: Case) -> Case {
    case.camera.rotation = DMat3::IDENTITY;
    case.camera.translation = DVec3::ZERO;
    case
}

pub(super) fn near_plane() -> Family {
    let case = |steps: i32| {
        let apart = 2f64.powi(-steps);
        let name = format!("near plane ± 2^-{steps} of it");
        let case = straight(each(&name, 40, [64, 48], 66, |s, i, _| {
            let [u, v, ..] = uniform(66, i);
            let side = [-1.0, 0.0, 1.0, 2.0][i % 4];
            let z = f64::from(NEAR as f32) * (1.0 + side * apart);
            let at = [0.3 * (u - 0.5) * z, 0.3 * (v - 0.5) * z, z];
            s.scatter(Plane::POSITION, i, at.map(|v| v as f32));
            s.scatter(Plane::LOG_SCALE, i, [(0.05 * NEAR).ln() as f32; 3]);
        }));
        (1.0 / apart, case)
    };
    let why = "at the plane itself a Gaussian is culled; the others are well-conditioned";
    family(
        "near plane",
        "1 over the distance to it",
        MIXED,
        why,
        [4, 8, 12, 16, 20].map(case),
    )
}

pub(super) fn inside() -> Family {
    let case = |size: f64| {
        let name = format!("camera within Gaussians of {size:.0e}");
        let case = straight(each(&name, 10, [64, 48], 67, |s, i, _| {
            let [u, v, w, o] = uniform(67, i);
            let at = [u - 0.5, v - 0.5, 0.5 + w].map(|v| (0.5 * v) as f32);
            s.scatter(Plane::POSITION, i, at);
            s.scatter(Plane::LOG_SCALE, i, [size.ln() as f32; 3]);
            s.scatter(Plane::OPACITY, i, [(2.0 * o - 2.0) as f32]);
        }));
        (size, case)
    };
    let why = "an image that changes little over the picture: differences of near equals in the gradients";
    family(
        "inside",
        "scale, distances 0.25 to 0.75",
        WELL,
        why,
        powers(-1..=3, 1).map(case),
    )
}

pub(super) fn aside() -> Family {
    let case = |tangent: f64| {
        let name = format!("{tangent:.0e} beside the sight");
        let case = straight(each(&name, 40, [64, 48], 68, |s, i, _| {
            let [u, v, w, _] = uniform(68, i);
            let z = 0.5 + w;
            // Half of them beside, large enough to reach in; half in view.
            let x = if i % 2 == 0 {
                tangent * z
            } else {
                0.4 * (u - 0.5)
            };
            s.scatter(
                Plane::POSITION,
                i,
                [x, 0.4 * (v - 0.5), z].map(|v| v as f32),
            );
            let scale = if i % 2 == 0 { (0.5 * x).ln() } else { -3.0 };
            s.scatter(Plane::LOG_SCALE, i, [scale as f32; 3]);
        }));
        (tangent, case)
    };
    let why = "beyond 1.3 times the field of view the slope is held; positions reach far beyond the picture";
    family(
        "aside",
        "tangent of the angle to the sight",
        MIXED,
        why,
        powers(0..=4, 1).map(case),
    )
}
