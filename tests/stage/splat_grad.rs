//! splat_grad: derivative of the compositing.

use super::*;
use mhsplat::scene::Plane;

#[test]
fn agrees_with_the_reference() {
    agrees("splat_grad");
}

#[test]
fn wrong_sums_are_rejected() {
    rejects("splat_grad", "sums", |sums| {
        sums.iter_mut().skip(3).step_by(9).for_each(|s| *s = -*s)
    });
    rejects("splat_grad", "sums", |sums| sums.fill(0.0));
}

/// Tiles with several segments of pairs, beside others with none or one, and some of them opaque after the first segment: faint Gaussians,
/// most of them over the left of the image, some in the middle not faint.
fn long_tiles() -> Case {
    let mut case = cases::mild("long tiles", 1500, [70, 40], 0, 29);
    for i in 0..case.splats.len() {
        let dense = i % 10 > 0;
        let opacity = if dense && i % 5 == 2 && i > 400 {
            0.0
        } else {
            -4.0
        };
        case.splats.scatter(Plane::OPACITY, i, [opacity]);
        if dense {
            let place = [-0.5, 0.0, 1e-3 * i as f32];
            case.splats.scatter(Plane::POSITION, i, place);
            case.splats.scatter(Plane::LOG_SCALE, i, [-1.0; 3]);
        }
    }
    case
}

#[test]
fn long_tiles_agree_with_the_reference() {
    let case = long_tiles();
    let out = run(Tuning::GPU, &case);
    let lists = out.got("sort", "tile lists");
    let (_, closed) = lists.split_last().unwrap();
    let longest = closed.split(|g| *g < 0.0).map(<[f64]>::len).max();
    let segment = Tuning::GPU.grad_segment as usize;
    assert!(longest > Some(4 * segment), "{longest:?}");
    let opaque = out
        .got("splat", "transmittance")
        .iter()
        .filter(|t| **t < 1e-4);
    assert!(opaque.count() > 256, "no tile is opaque");
    for row in verify_case(&device(), &case).unwrap() {
        assert!(row.pass && row.non_finite == 0, "{row:?}");
    }
    let reference = Reference::new(&case);
    let sizes = |splat_group, grad_group, grad_segment, grad_sums| Tuning {
        splat_group,
        grad_group,
        grad_segment,
        grad_sums,
        ..Tuning::GPU
    };
    for tuning in [
        Tuning::GPU,
        Tuning::GPU_WIDE,
        sizes(64, 64, 64, 7),
        sizes(256, 256, 4096, 1),
    ] {
        assert_eq!(tuning.fault(device().info()), None);
        let double = pass::run::<f64>(&device(), tuning, &case, Some(&reference)).unwrap();
        for row in check(&case, &double, "f64", EXACT) {
            assert!(row.pass, "{tuning}: {row:?}");
        }
    }
}
