//! When anti-aliasing switches itself on: by the sampling rates of the training views.

use std::sync::Arc;

use glam::{DMat3, DVec3};

use crate::determinism::room;
use mhsplat::capture::{Alpha, Camera, Dataset, Lens, Photo, PhotoSource, View};
use mhsplat::config::AntiAliasing;
use mhsplat::run::PlanRecord;
use mhsplat::train::reasons::Decided;
use mhsplat::train::sampling_rates::{MIN_SPREAD, MIN_SPREAD_WITHIN, Spreads};
use mhsplat::{Plan, TrainConfig};

fn decided(data: &Dataset, config: &TrainConfig) -> Decided<bool> {
    Plan::new(data, config).unwrap().anti_aliasing
}

fn record(data: &Dataset, config: &TrainConfig) -> PlanRecord {
    PlanRecord::of(&Plan::new(data, config).unwrap())
}

/// The room with every other view moved back along its axis to `factor` times the median depth of the points it sees.
fn two_distances(factor: f64) -> Dataset {
    let mut data = room(64);
    let points = data.points.positions.clone();
    for view in data.train.iter_mut().step_by(2) {
        let c = &mut view.camera;
        let depth =
            |p: &[f32; 3]| (c.rotation * DVec3::from_array(p.map(f64::from)) + c.translation).z;
        let mut depths: Vec<f64> = points.iter().map(depth).filter(|z| *z > 0.0).collect();
        depths.sort_by(f64::total_cmp);
        c.translation.z += (factor - 1.0) * depths[depths.len() / 2];
    }
    data
}

#[test]
fn auto_is_off_for_one_distance_and_on_for_two() {
    let auto = TrainConfig::default();
    assert_eq!(auto.anti_aliasing, AntiAliasing::Auto);
    let (plain, apart) = (two_distances(1.0), two_distances(8.0));
    let spreads = [&plain, &apart].map(Spreads::of);
    println!("spreads of the sampling rates: {spreads:?}");
    assert!(
        spreads
            .iter()
            .all(|s| s.within.unwrap() < 0.85 * MIN_SPREAD_WITHIN)
    );
    let [low, high] = spreads.map(|s| s.across.unwrap());
    assert!(low < 0.75 * MIN_SPREAD, "{low}");
    assert!(high > 1.25 * MIN_SPREAD, "{high}");
    assert!(!decided(&plain, &auto).value && decided(&apart, &auto).value);
    let what = |items: &[mhsplat::run::Item]| items.iter().any(|i| i.what == "anti-aliasing");
    assert!(what(&record(&plain, &auto).left_out) && what(&record(&apart, &auto).kept));
    let set = |anti_aliasing| TrainConfig {
        anti_aliasing,
        ..TrainConfig::default()
    };
    assert!(decided(&plain, &set(AntiAliasing::On)).value);
    assert!(!decided(&apart, &set(AntiAliasing::Off)).value);
}

/// The room with half of its points brought towards the first camera, so that each view sees things near and far.
#[test]
fn auto_is_on_where_views_see_near_and_far() {
    let auto = TrainConfig::default();
    let mut data = room(64);
    let plain = Spreads::of(&data);
    assert!(
        plain.within.unwrap() < 0.85 * MIN_SPREAD_WITHIN,
        "{plain:?}"
    );
    // All views from where the first stands, so that no point is seen from two distances.
    let first = data.train[0].camera;
    for view in &mut data.train {
        view.camera = first;
    }
    assert!(!decided(&data, &auto).value);
    let center = first.center();
    for p in data.points.positions.iter_mut().step_by(2) {
        let q = center + 0.1 * (DVec3::from_array(p.map(f64::from)) - center);
        *p = q.to_array().map(|v| v as f32);
    }
    let spreads = Spreads::of(&data);
    println!("spreads of the sampling rates: {spreads:?}, before {plain:?}");
    assert!((spreads.across.unwrap() - 1.0).abs() < 1e-6);
    assert!(spreads.within.unwrap() > 1.25 * MIN_SPREAD_WITHIN);
    let filters = decided(&data, &auto);
    let why = filters.why.to_string();
    assert!(
        filters.value && why.contains("within views (auto asks for 3 or more)"),
        "{why}"
    );
    assert!(
        !why.contains("from view to view"),
        "only what meets its bar: {why}"
    );
    let left_out = decided(&room(64), &auto).why.to_string();
    assert!(left_out.contains("from view to view") && left_out.contains("within views"));
    let mut two = data.clone();
    two.train.truncate(2);
    assert_eq!(Spreads::of(&two).across, None, "three views make a spread");
    assert!(decided(&two, &auto).value);
    // The camera's own points, so that it sees all of them.
    let inside = |p: &[f32; 3]| {
        first
            .sampling_rate(DVec3::from_array(p.map(f64::from)))
            .is_some()
    };
    data.points.positions.retain(inside);
    data.points.positions.truncate(20);
    assert!(Spreads::of(&data).within.is_some());
    let away = DMat3::from_rotation_y(std::f64::consts::PI);
    let n = data.train.len();
    for (turned, some) in [(n / 2, true), (n / 2 + 1, false)] {
        let mut data = data.clone();
        for view in &mut data.train[..turned] {
            view.camera.rotation = away * view.camera.rotation;
            view.camera.translation = away * view.camera.translation;
        }
        assert_eq!(
            Spreads::of(&data).within.is_some(),
            some,
            "{turned} of {n} look away"
        );
    }
    data.points.positions.truncate(19);
    assert_eq!(Spreads::of(&data).within, None, "too few points");
    assert!(!decided(&data, &auto).value);
}

/// Views on a circle around the origin, every other one `factor` times as far; no points.
fn circle(factor: f64) -> Dataset {
    let view = |k: usize| {
        let far = if k.is_multiple_of(2) { 1.0 } else { factor };
        let photo = Photo {
            width: 32,
            height: 32,
            alpha: Alpha::None,
            data: vec![0; 3 * 32 * 32],
        };
        View {
            name: format!("{k:02}"),
            camera: Camera {
                rotation: DMat3::from_rotation_y(0.5 * k as f64),
                translation: DVec3::new(0.0, 0.0, far),
                fx: 30.0,
                fy: 30.0,
                cx: 16.0,
                cy: 16.0,
                width: 32,
                height: 32,
            },
            lens: Lens::Pinhole,
            photo: PhotoSource::Memory(Arc::new(photo)),
        }
    };
    let mut data = room(64);
    data.points = mhsplat::capture::Points::default();
    data.train = (0..12).map(view).collect();
    data
}

#[test]
fn without_points_the_rates_are_compared_where_the_views_look() {
    let across = |data: &Dataset| Spreads::of(data).across;
    let same = across(&circle(1.0)).unwrap();
    assert!((same - 1.0).abs() < 1e-9, "{same}");
    let apart = across(&circle(8.0)).unwrap();
    assert!((apart - 8.0).abs() < 1e-9, "{apart}");
    let mut parallel = circle(1.0);
    for view in &mut parallel.train {
        view.camera.rotation = DMat3::IDENTITY;
    }
    assert_eq!(across(&parallel), None);
    assert_eq!(Spreads::of(&parallel).within, None);
    assert!(!decided(&parallel, &TrainConfig::default()).value);
}
