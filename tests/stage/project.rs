//! project: projected Gaussians.

use super::*;
use mhsplat::scene::Plane;

#[test]
fn agrees_with_the_reference() {
    agrees("project");
}

#[test]
fn a_wrong_record_is_rejected() {
    rejects("project", "quadratic form", |form| {
        form.iter_mut().step_by(3).for_each(|a| *a *= 1.001)
    });
}

#[test]
fn culls_what_is_behind_faint_or_not_finite() {
    let mut case = cases::mild("culled", 8, [32, 32], 0, 30);
    for i in 0..8 {
        case.splats.scatter(Plane::POSITION, i, [0.0, 0.0, 0.0]);
        case.splats.scatter(Plane::OPACITY, i, [3.0]);
    }
    case.splats.scatter(Plane::POSITION, 1, [0.0, 0.0, -50.0]);
    case.splats.scatter(Plane::OPACITY, 2, [-6.0]);
    case.splats
        .scatter(Plane::POSITION, 3, [f32::NAN, 0.0, 0.0]);
    case.splats
        .scatter(Plane::LOG_SCALE, 4, [f32::NAN, 0.0, 0.0]);
    case.splats
        .scatter(Plane::ROTATION, 5, [f32::INFINITY, 0.0, 0.0, 0.0]);
    case.splats.scatter(Plane::OPACITY, 6, [f32::NAN]);
    case.splats.scatter(Plane::SH, 7, [f32::NAN, 0.0, 0.0]);
    let out = run(Tuning::for_device(device().info()), &case);
    let forms = out.got("project", "quadratic form").chunks(3);
    let visible: Vec<bool> = forms.map(|form| form != [0.0; 3]).collect();
    assert_eq!(
        visible[..7],
        [true, false, false, false, false, false, false]
    );
    let mut splat = out.quantities.iter().filter(|q| q.stage == "splat");
    assert!(splat.all(|q| q.got.iter().all(|v| v.is_finite())));
}
