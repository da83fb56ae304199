//! project: records.

use super::*;
use mhsplat::scene::Plane;

#[test]
fn agrees_with_the_reference() {
    agrees("project");
}

#[test]
fn a_wrong_record_is_rejected() {
    rejects("project", |out| {
        for r in out.records.iter_mut().flatten() {
            r.a *= 1.001;
        }
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
    let device = device();
    let out = chain::run::<f32>(&device, Tuning::for_device(device.info()), &case).unwrap();
    let visible: Vec<bool> = out.records.iter().map(Option::is_some).collect();
    assert_eq!(
        visible[..7],
        [true, false, false, false, false, false, false]
    );
    assert!(
        out.image
            .iter()
            .chain(&out.transmittance)
            .all(|v| v.is_finite())
    );
}
