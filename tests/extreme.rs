//! Broken and extreme parameters: culled or bounded, never NaN, and never anybody else's problem.

use crate::device;
use mhsplat::device::tuning::Tuning;
use mhsplat::lab::verify::cases::{Case, mild};
use mhsplat::lab::verify::pass::Outcome;
use mhsplat::lab::verify::pass::run;
use mhsplat::scene::{Gaussians, Plane};

/// A plane of every parameter group: x, a log-scale, w and z of the quaternion, opacity, SH degree 0 and 3.
const ONE_OF_EACH: [usize; 7] = [0, 4, 6, 9, Plane::OPACITY, Plane::SH, Plane::SH + 40];

fn assert_finite(case: &Case, out: &Outcome) {
    let arrays = ["splat", "loss", "project_grad", "importance"];
    for q in out.quantities.iter().filter(|q| arrays.contains(&q.stage)) {
        let name = (&case.name, q.stage, q.name);
        assert!(q.got.iter().all(|v| v.is_finite()), "{name:?}");
    }
    assert_eq!(out.non_finite, 0, "{}", case.name);
}

fn render(case: &Case) -> Outcome {
    let device = device();
    let own = Tuning::for_device(device.info());
    let [own, group] = [own, Tuning::GPU].map(|t| run::<f32>(&device, t, case, None).unwrap());
    assert_finite(case, &own);
    assert_finite(case, &group);
    own
}

fn image(out: &Outcome) -> &[f64] {
    out.got("splat", "image")
}

/// True if the first Gaussian is culled.
fn culled(out: &Outcome) -> bool {
    out.got("project", "quadratic form")[..3] == [0.0; 3]
}

/// Gaussians of each tile.
fn tiles(out: &Outcome) -> Vec<&[f64]> {
    let lists = out.got("sort", "tile lists");
    let (_, closed) = lists.split_last().unwrap();
    closed.split(|g| *g < 0.0).collect()
}

/// `case` with its first Gaussian changed.
fn with_first(case: &Case, name: &str, change: impl Fn(&mut Gaussians)) -> Case {
    let mut case = case.clone();
    case.name = name.into();
    change(&mut case.splats);
    case
}

fn base() -> Case {
    let mut case = mild("base", 40, [35, 27], 3, 51);
    // The first Gaussian in full view, so that what becomes of it matters.
    case.splats.scatter(Plane::POSITION, 0, [0.0; 3]);
    case.splats.scatter(Plane::OPACITY, 0, [1.0]);
    case
}

#[test]
fn a_broken_gaussian_is_culled_and_disturbs_nobody() {
    let base = base();
    let full = render(&base);
    let without = render(&with_first(&base, "faint", |s| {
        s.scatter(Plane::OPACITY, 0, [-40.0])
    }));
    assert_ne!(
        image(&full),
        image(&without),
        "the first Gaussian must be seen"
    );
    for plane in ONE_OF_EACH {
        for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            // An infinite logit is an opacity of 0 or 1, not a defect.
            if plane == Plane::OPACITY && value > 0.0 {
                continue;
            }
            let name = format!("plane {plane} = {value}");
            let out = render(&with_first(&base, &name, |s| s.plane_mut(plane)[0] = value));
            assert!(culled(&out), "{name} is not culled");
            assert!(image(&out) == image(&without), "{name} changed the picture");
        }
    }
}

#[test]
fn huge_and_tiny_values_stay_finite() {
    let base = base();
    for plane in ONE_OF_EACH {
        for value in [
            1e-45,
            -1e-45,
            1e-30,
            1e10,
            -1e10,
            1e30,
            -1e30,
            f32::MAX,
            f32::MIN,
        ] {
            let name = format!("plane {plane} = {value:e}");
            render(&with_first(&base, &name, |s| s.plane_mut(plane)[0] = value));
        }
    }
}

#[test]
fn the_zero_quaternion_is_the_identity() {
    let base = base();
    let with = |q: [f32; 4]| {
        render(&with_first(&base, "quaternion", |s| {
            s.scatter(Plane::ROTATION, 0, q)
        }))
    };
    let identity = with([1.0, 0.0, 0.0, 0.0]);
    assert!(image(&with([0.0; 4])) == image(&identity));
    for norm in [1e-20, 1e-3, 1e20] {
        assert!(
            image(&with([norm, 0.0, 0.0, 0.0])) == image(&identity),
            "{norm:e}"
        );
    }
    assert!(image(&with([0.5, 0.5, 0.5, 0.5])) != image(&identity));
}

#[test]
fn opacities_saturate() {
    let base = base();
    let with = |logit: f32| {
        render(&with_first(&base, "logit", |s| {
            s.scatter(Plane::OPACITY, 0, [logit])
        }))
    };
    let (opaque, more) = (with(20.0), with(100.0));
    assert!(image(&opaque) == image(&more));
    assert!(culled(&with(-20.0)) && culled(&with(-100.0)));
}

#[test]
fn the_camera_inside_behind_and_far_away() {
    let mut inside = base();
    inside.name = "inside".into();
    let center = inside.camera.center().as_vec3().to_array();
    inside.splats.scatter(Plane::POSITION, 0, center);
    inside.splats.scatter(Plane::LOG_SCALE, 0, [0.0; 3]);
    assert!(culled(&render(&inside)), "at the near plane");
    for far in [1e3, 1e6, 1e20] {
        let mut case = base();
        case.name = format!("{far:e} away");
        for i in 0..case.splats.len() {
            case.splats.scatter(Plane::POSITION, i, [far, -far, far]);
        }
        render(&case);
    }
}

#[test]
fn nothing_visible_leaves_the_background_and_the_regularisers() {
    let mut case = base();
    case.name = "behind".into();
    for i in 0..case.splats.len() {
        case.splats.scatter(Plane::POSITION, i, [0.0, 0.0, -90.0]);
    }
    let out = render(&case);
    let n = 35 * 27;
    for (c, value) in case.background.iter().enumerate() {
        assert!(
            image(&out)[c * n..(c + 1) * n]
                .iter()
                .all(|v| *v == f64::from(*value))
        );
    }
    assert!(out.got("splat", "transmittance").iter().all(|t| *t == 1.0));
    let moved = |group: &str| out.got("project_grad", group).iter().any(|v| *v != 0.0);
    assert!(!moved("position") && !moved("rotation") && !moved("SH"));
    assert!(moved("log-scale") && moved("opacity"));
}

#[test]
fn ten_thousand_layers_on_one_pixel() {
    let mut case = mild("layers", 10_000, [4, 4], 0, 52);
    for i in 0..case.splats.len() {
        case.splats
            .scatter(Plane::POSITION, i, [0.0, 0.0, 1e-4 * i as f32]);
        case.splats.scatter(Plane::OPACITY, i, [-3.0]);
    }
    let out = render(&case);
    assert!(out.got("splat", "transmittance").iter().any(|t| *t < 1e-3));
}

#[test]
fn one_gaussian_over_every_tile_and_all_in_one() {
    let mut wide = mild("wide", 1, [250, 130], 0, 53);
    wide.splats.scatter(Plane::POSITION, 0, [0.0; 3]);
    wide.splats.scatter(Plane::LOG_SCALE, 0, [3.0; 3]);
    wide.splats.scatter(Plane::OPACITY, 0, [3.0]);
    let out = render(&wide);
    assert!(tiles(&out).iter().all(|t| *t == [0.0]), "every tile has it");
    let mut crowd = mild("crowd", 3000, [64, 64], 0, 54);
    for i in 0..crowd.splats.len() {
        crowd.splats.scatter(Plane::POSITION, i, [0.0; 3]);
        crowd.splats.scatter(Plane::LOG_SCALE, i, [-9.0; 3]);
        crowd.splats.scatter(Plane::OPACITY, i, [2.0]);
    }
    let out = render(&crowd);
    let tiles = tiles(&out);
    let full: Vec<usize> = tiles.iter().map(|t| t.len()).filter(|n| *n > 0).collect();
    assert!(full.iter().all(|n| *n == 3000) && !full.is_empty());
    // Equal depths: ties go by index.
    let list = tiles.iter().find(|t| !t.is_empty()).unwrap();
    assert!(list.windows(2).all(|w| w[0] < w[1]));
}
