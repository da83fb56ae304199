//! Births in image space.

use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;

use super::step::{breaches, context};
use super::{Scene, on_threads};
use mhsplat::config::MhConfig;
use mhsplat::density::mh::MetropolisHastings;
use mhsplat::density::{Colors, DensityControl, Edit, Outcome, Picture, StepContext};

const SIZE: [usize; 2] = [40, 30];
/// Values from one row of a plane of the render to the next.
const STRIDE: usize = 48;

/// A plane with one value in its left half and one in its right half, and another in the padding.
fn padded(halves: [f32; 2]) -> Cow<'static, [f32]> {
    in_rows(0..SIZE[1], halves)
}

/// [`padded`] in some rows, and 0 in the others.
fn in_rows(rows: Range<usize>, [left, right]: [f32; 2]) -> Cow<'static, [f32]> {
    let value = |i: usize| match i % STRIDE {
        column if column >= SIZE[0] => 0.123,
        _ if !rows.contains(&(i / STRIDE)) => 0.0,
        column if column < SIZE[0] / 2 => left,
        _ => right,
    };
    (0..STRIDE * SIZE[1]).map(value).collect()
}

/// Looks along +x from (1, 2, 3). The left half is opaque at depth 5, the right half is empty; errors are in the rows from
/// 10 to 19, three times as large in the right half.
pub fn picture() -> Picture<'static> {
    let pixels = SIZE[0] * SIZE[1];
    let right = |i: usize| i % SIZE[0] >= SIZE[0] / 2;
    let make = |f: &dyn Fn(usize) -> f32| (0..pixels).map(f).collect::<Vec<f32>>();
    Picture {
        size: SIZE,
        stride: STRIDE,
        intrinsics: [50.0, 50.0, 20.0, 15.0],
        // Rows: camera x is −z of the scene, y is y, z is x.
        rotation: [0.0, 0.0, -1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0],
        center: [1.0, 2.0, 3.0],
        photo: Arc::new([0.25f32, 0.5, 0.75].map(|c| make(&|i| if right(i) { c } else { 0.0 }))),
        error: in_rows(10..20, [0.1, 0.3]),
        depth: padded([5.0, f32::NAN]),
        transmittance: padded([0.0, 1.0]),
    }
}

/// A photo of which all is masked.
#[derive(Debug)]
struct Hidden;

impl Colors for Hidden {
    fn at(&self, _pixel: usize) -> [f32; 3] {
        [0.0; 3]
    }

    fn is_masked(&self, _pixel: usize) -> bool {
        true
    }
}

fn config() -> MhConfig {
    MhConfig {
        pixel_proposals: 300,
        coarse_proposals: 0,
        fine_proposals: 0,
        pixel_surface: 1.0,
        pixel_tolerance: 0.0,
        ..MhConfig::paper()
    }
}

fn step(config: &MhConfig, at: &StepContext<'_>) -> Outcome {
    let scene = Scene::random(500, 3);
    let outcome = MetropolisHastings::new(config)
        .step(at, &scene.state(), &scene.errors())
        .unwrap();
    assert_eq!(breaches(500, &outcome), Vec::<String>::new());
    outcome
}

/// Pixel coordinates and depth of a birth.
fn seen(e: &Edit) -> [f64; 3] {
    let [x, y, z] = e.position.map(f64::from);
    let depth = x - 1.0;
    [
        20.0 - 50.0 * (z - 3.0) / depth,
        15.0 + 50.0 * (y - 2.0) / depth,
        depth,
    ]
}

#[test]
fn births_lie_behind_the_pixels_that_err() {
    let pictures = [picture()];
    let at = StepContext {
        pictures: &pictures,
        ..context(700, 0.0, 1)
    };
    let config = config();
    let outcome = step(&config, &at);
    let stats = outcome.stats;
    assert_eq!(stats.proposed, stats.pixel[0]);
    assert_eq!(stats.accepted, stats.pixel[1]);
    assert!(stats.pixel[1] > 50 && stats.pixel[1] < stats.pixel[0]);
    let births: Vec<&Edit> = outcome.edits.iter().filter(|e| e.dst >= 500).collect();
    assert_eq!(births.len() as u64, stats.accepted);
    let mut right = 0;
    for e in &births {
        let [u, v, depth] = seen(e);
        assert!((10.0..20.0).contains(&v) && (0.0..40.0).contains(&u));
        let color = e.color.get().unwrap();
        if u >= 20.0 {
            right += 1;
            assert!((2.0..=20.0).contains(&depth), "{depth}");
            assert!(color[0] < 0.0 && color[1] == 0.0 && color[2] > 0.0);
        } else {
            assert!((depth - 5.0).abs() < 1e-4, "{depth}");
        }
        // Two pixels wide at its depth.
        let scale = f64::from(e.log_scale[0]).exp();
        assert!((scale / (2.0 * depth / 50.0) - 1.0).abs() < 1e-4);
        assert!((e.opacity_logit + 9f32.ln()).abs() < 1e-5);
    }
    // Three times the error; drawn without repetition, and accepted a little more often.
    let share = right as f64 / births.len() as f64;
    assert!((0.6..0.9).contains(&share), "{share}");
}

#[test]
fn nothing_is_born_close_to_a_camera() {
    let pictures = [picture()];
    let at = StepContext {
        pictures: &pictures,
        ..context(700, 0.0, 1)
    };
    let depths = |pixel_near: f64| -> Vec<f64> {
        let config = MhConfig {
            pixel_near,
            ..config()
        };
        let outcome = step(&config, &at);
        let births = outcome.edits.iter().filter(|e| e.dst >= 500);
        births.map(|e| seen(e)[2]).collect()
    };
    let (all, far) = (depths(0.0), depths(6.0));
    assert!(all.iter().any(|z| *z < 6.0) && !far.is_empty());
    assert!(far.iter().all(|z| *z > 6.0 - 1e-4));
    assert_eq!(all.iter().filter(|z| **z >= 6.0).count(), far.len());
}

#[test]
fn a_surface_of_zero_leaves_what_is_opaque_alone() {
    let pictures = [picture()];
    let at = StepContext {
        pictures: &pictures,
        ..context(700, 0.0, 1)
    };
    let outcome = |pixel_surface: f64| {
        step(
            &MhConfig {
                pixel_surface,
                ..config()
            },
            &at,
        )
    };
    // Three quarters of the error lie where nothing is rendered: so many of the 300 draws are left, less what repeats.
    let proposed = |surface: f64| outcome(surface).stats.pixel[0];
    assert!(proposed(0.0) <= 225 && proposed(0.0) > 100);
    assert!(proposed(0.0) < proposed(0.5) && proposed(0.5) < proposed(1.0));
    let share = |pixel_surface: f64| {
        let outcome = outcome(pixel_surface);
        let births: Vec<&Edit> = outcome.edits.iter().filter(|e| e.dst >= 500).collect();
        assert!(births.len() > 30);
        let left = births.iter().filter(|e| seen(e)[0] < 20.0).count();
        left as f64 / births.len() as f64
    };
    assert_eq!(share(0.0), 0.0);
    assert!(share(0.3) > 0.0 && share(0.3) < share(1.0));
}

/// Numbers of births at the opaque half of the first picture, whose surface is 5 away, and at the empty half.
fn halves(pixel_tolerance: f64, pictures: &[Picture<'_>]) -> (usize, usize) {
    let at = StepContext {
        pictures,
        ..context(700, 0.0, 1)
    };
    let config = MhConfig {
        pixel_tolerance,
        ..config()
    };
    let outcome = step(&config, &at);
    let births = outcome.edits.iter().filter(|e| e.dst >= 500).map(seen);
    let (left, right): (Vec<_>, Vec<_>) = births.partition(|b| b[0] < 20.0);
    (left.len(), right.len())
}

/// A birth on a surface needs another view that shows the surface, and none that sees through it.
#[test]
fn views_have_to_agree_about_a_surface() {
    // Beside the first camera, at the same distance from the wall, which is rendered at `depth` there.
    let aside = |depth: f32| {
        let mut other = picture();
        other.center[1] += 0.5;
        other.error = padded([0.0; 2]);
        other.transmittance = padded([0.0; 2]);
        other.depth = padded([depth; 2]);
        other
    };
    let births = |pixel_tolerance: f64, others: &[f32]| {
        let others = others.iter().map(|depth| aside(*depth));
        halves(
            pixel_tolerance,
            &[picture()].into_iter().chain(others).collect::<Vec<_>>(),
        )
    };
    let unasked = |others: &[f32]| {
        let (left, right) = births(0.0, others);
        assert!(left > 10 && right > 10);
        (left, right)
    };
    // What hides the surface from one view does not speak against it.
    for others in [&[5.0][..], &[5.4, 4.6], &[2.0, 5.0]] {
        assert_eq!(births(0.1, others), unasked(others), "{others:?}");
    }
    assert_eq!(births(0.7, &[8.0]), unasked(&[8.0]));
    for others in [
        &[][..],
        // Seen through, by an empty pixel too; hidden; seen by one and seen through by another.
        &[8.0],
        &[f32::NAN],
        &[2.0],
        &[5.0, 8.0],
        &[8.0, 5.0],
    ] {
        assert_eq!(births(0.1, others), (0, unasked(others).1), "{others:?}");
    }
    // What a mask hides speaks neither for nor against it.
    let hidden = |depths: &[f32]| {
        let others = depths.iter().map(|depth| aside(*depth));
        let mut pictures: Vec<_> = [picture()].into_iter().chain(others).collect();
        pictures[1].photo = Arc::new(Hidden);
        halves(0.1, &pictures).0
    };
    assert_eq!(hidden(&[5.0]), 0);
    assert_eq!(hidden(&[8.0, 5.0]), births(0.1, &[5.0, 5.0]).0);
    // A view does not confirm itself.
    assert_eq!(halves(0.1, &[picture(), picture()]).0, 0);
}

#[test]
fn a_point_projects_to_the_pixel_that_shows_it() {
    let picture = picture();
    for (at, z) in [([0.5, 0.5], 2.0), ([39.5, 29.5], 7.0), ([12.3, 20.7], 0.5)] {
        let (depth, pixel) = picture.project(picture.point(at, z)).unwrap();
        assert!((depth - z).abs() < 1e-9);
        assert_eq!([pixel % SIZE[0], pixel / SIZE[0]], at.map(|v| v as usize));
    }
    for (at, z) in [
        ([-0.1, 5.0], 2.0),
        ([40.1, 5.0], 2.0),
        ([5.0, 30.1], 2.0),
        ([5.0, -0.1], 2.0),
        ([20.0, 15.0], -1.0),
    ] {
        assert_eq!(picture.project(picture.point(at, z)), None, "{at:?} {z}");
    }
}

#[test]
fn they_are_the_same_on_any_number_of_threads_and_fade() {
    let pictures = [picture(), picture()];
    let at = |progress: f64| StepContext {
        pictures: &pictures,
        ..context(700, progress, 1)
    };
    let config = config();
    let run = || step(&config, &at(0.0)).edits;
    assert!(on_threads(1, run) == on_threads(2, run));
    let late = step(&config, &at(0.9)).stats.pixel;
    assert!(late[0] > 0 && late[0] <= 30, "{late:?}");
    // Of twice as many steps each has half of them, where Gaussians die by turnover.
    let of = |turnover: f64, spacing: f64| {
        let config = MhConfig {
            turnover,
            relocation: false,
            ..config
        };
        let at = StepContext { spacing, ..at(0.0) };
        f64::from(step(&config, &at).stats.pixel[0] as u32)
    };
    let [all, half] = [1.0, 0.5].map(|steps| of(1.6, steps / 15.0));
    assert!((0.4..0.6).contains(&(half / all)), "{half} of {all}");
    assert_eq!(of(0.0, 1.0 / 60.0), all);
}

#[test]
fn without_proposals_no_view_is_rendered() {
    let wanted = |pixel_proposals: u32| {
        MetropolisHastings::new(&MhConfig {
            pixel_proposals,
            ..MhConfig::paper()
        })
        .pictures(0.3)
    };
    assert_eq!((wanted(0), wanted(10)), (0, 4));
    let none = step(&config(), &context(700, 0.0, 1));
    assert_eq!(none.stats.pixel, [0, 0]);
}

#[test]
fn the_upper_bound_holds_and_what_broke_is_left_out() {
    let mut broken = picture();
    broken.depth = padded([f32::NAN; 2]);
    broken.transmittance = padded([f32::NAN; 2]);
    let pictures = [broken];
    let at = StepContext {
        pictures: &pictures,
        ..context(700, 0.0, 1)
    };
    assert_eq!(step(&config(), &at).stats.pixel, [0, 0]);
    let pictures = [picture()];
    let at = StepContext {
        pictures: &pictures,
        max_gaussians: Some(510),
        ..context(700, 0.0, 1)
    };
    let bounded = step(
        &MhConfig {
            pixel_proposals: 300,
            ..MhConfig::paper()
        },
        &at,
    );
    assert_eq!(bounded.rows, 510);
    assert_eq!(bounded.stats.pixel[1], 10, "they come first");
}

/// The place of a birth within its pixel and along its ray depends on the seed, and none lies in front of what is rendered.
#[test]
fn places_follow_the_seed_and_stay_behind_the_surface() {
    let mut half = picture();
    half.transmittance = padded([0.5; 2]);
    // Weighted by opacity: 8 away.
    half.depth = padded([4.0; 2]);
    let pictures = [half];
    let births = |seed: u64| -> Vec<[f64; 3]> {
        let at = StepContext {
            pictures: &pictures,
            ..context(700, 0.0, seed)
        };
        let outcome = step(&config(), &at);
        let births = outcome.edits.iter().filter(|e| e.dst >= 500);
        births.map(seen).collect()
    };
    let [first, second] = [1, 2].map(births);
    let beyond = |b: &&[f64; 3]| b[2] > 8.001;
    assert!(first.iter().filter(beyond).count() > 10);
    assert!(first.iter().all(|b| b[2] > 8.0 - 1e-3), "one is in front");
    let pixel = |b: &[f64; 3]| [b[0], b[1]].map(|v| v.floor() as i64);
    let common = first
        .iter()
        .filter_map(|a| Some((a, second.iter().find(|b| pixel(b) == pixel(a))?)));
    let common: Vec<_> = common.collect();
    assert!(common.len() > 10, "{}", common.len());
    assert!(common.iter().all(|(a, b)| a != b));
}
