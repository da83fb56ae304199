//! Stiff shapes: long, flat, of very different size, or turned by quaternions of any norm.

use glam::{DQuat, DVec3};

use crate::lab::verify::cases::Case;
use crate::lab::verify::stress::family::{Family, MIXED, each, family, position, powers, uniform};
use crate::scene::{Gaussians, Plane};

fn set_rotation(s: &mut Gaussians, i: usize, q: DQuat) {
    s.scatter(Plane::ROTATION, i, [q.w, q.x, q.y, q.z].map(|v| v as f32));
}

/// Direction from the camera to a Gaussian.
fn sight(s: &Gaussians, i: usize, case: &Case) -> DVec3 {
    (position(s, i) - case.camera.center()).normalize_or(DVec3::Z)
}

pub(super) fn needles() -> Family {
    let case = |ratio: f64| {
        let thin = ratio.ln() as f32;
        let name = format!("needles {ratio:.0e}:1");
        let case = each(&name, 60, [64, 48], 61, |s, i, _| {
            let long = -1.0 - uniform(61, i)[0] as f32;
            s.scatter(Plane::LOG_SCALE, i, [long, long - thin, long - thin]);
        });
        (ratio, case)
    };
    let why = "axis ratios beyond 1e3 leave the short axis below the blur; what is left is the rounding of the long one";
    family(
        "needles",
        "long over short axis",
        MIXED,
        why,
        powers(1..=6, 1).map(case),
    )
}

pub(super) fn pancakes() -> Family {
    let case = |ratio: f64| {
        let thin = ratio.ln() as f32;
        let name = format!("pancakes 1:{ratio:.0e}, edge-on");
        let case = each(&name, 60, [64, 48], 62, |s, i, base| {
            let wide = -1.0 - uniform(62, i)[0] as f32;
            s.scatter(Plane::LOG_SCALE, i, [wide, wide, wide - thin]);
            // The thin axis, z, lies across the line of sight.
            let across = sight(s, i, base).any_orthonormal_vector();
            set_rotation(s, i, DQuat::from_rotation_arc(DVec3::Z, across));
        });
        (ratio, case)
    };
    let why = "as needles: the image of a disc that is seen from its edge is one";
    family(
        "pancakes",
        "wide over thin axis",
        MIXED,
        why,
        powers(1..=6, 1).map(case),
    )
}

pub(super) fn end_on() -> Family {
    let case = |ratio: f64| {
        let thin = ratio.ln() as f32;
        let name = format!("needles {ratio:.0e}:1 along the sight");
        let case = each(&name, 60, [64, 48], 63, |s, i, base| {
            let long = -1.0 - uniform(63, i)[0] as f32;
            s.scatter(Plane::LOG_SCALE, i, [long, long - thin, long - thin]);
            let along = sight(s, i, base);
            set_rotation(s, i, DQuat::from_rotation_arc(DVec3::X, along));
        });
        (ratio, case)
    };
    let why = "the long axis cancels in the image; what is left of it is rounding of its length";
    family(
        "end-on",
        "long over short axis",
        MIXED,
        why,
        powers(1..=6, 1).map(case),
    )
}

pub(super) fn scale_variance() -> Family {
    let case = |variance: f64| {
        let name = format!("scales over {variance:.0e}");
        let case = each(&name, 200, [64, 48], 64, |s, i, _| {
            let [u, a, b, c] = uniform(64, i);
            let scale = -(u * variance.ln());
            let part = [a, b, c].map(|v| (scale + v - 0.5) as f32);
            s.scatter(Plane::LOG_SCALE, i, part);
        });
        (variance, case)
    };
    let why = "every Gaussian for itself is well-conditioned";
    family(
        "scale variance",
        "largest over smallest scale",
        MIXED,
        why,
        powers(1..=7, 2).map(case),
    )
}

pub(super) fn norms() -> Family {
    let case = |norm: f64| {
        let name = format!("quaternions of norm {norm:.0e}");
        let case = each(&name, 60, [40, 32], 72, |s, i, _| {
            let q: [f32; 4] = s.gather(Plane::ROTATION, i);
            s.scatter(Plane::ROTATION, i, q.map(|v| (f64::from(v) * norm) as f32));
        });
        (norm, case)
    };
    let why = "the norm is factored out before anything is squared";
    family(
        "quaternion norm",
        "norm",
        MIXED,
        why,
        powers(-20..=20, 5).map(case),
    )
}
