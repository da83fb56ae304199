//! Captures with little or wrong information: they train, or it is said what is missing.

use std::path::Path;

use glam::DVec3;

use crate::dataset::{assert_refused, load_every, ring, three_points, write_images};
use crate::determinism::trained;
use mhsplat::capture::Camera;
use mhsplat::capture::colmap::{ColmapModel, ColmapPoint};
use mhsplat::config::TrainConfig;

fn written(dir: &Path, views: &[(String, Camera)], points: Vec<ColmapPoint>) {
    let model = ColmapModel::from_views(views, points);
    model.write(&dir.join("sparse/0"), true).unwrap();
    write_images(&dir.join("images"), views);
}

/// Trains on it, with nothing held out; the loss at the end and the number of Gaussians.
fn train(views: &[(String, Camera)], points: Vec<ColmapPoint>) -> (f64, usize) {
    let dir = tempfile::tempdir().unwrap();
    written(dir.path(), views, points);
    let data = load_every(dir.path(), 0).unwrap();
    let config = TrainConfig {
        iterations: 60,
        max_gaussians: Some(2000),
        ..TrainConfig::default()
    };
    let (mut trainer, splats) = trained(&data, &config, 60);
    trainer.finish().unwrap();
    assert_eq!(trainer.non_finite(), 0);
    (trainer.recent_loss().unwrap().unwrap(), splats.len())
}

fn point(position: [f64; 3]) -> ColmapPoint {
    ColmapPoint {
        position,
        ..three_points(DVec3::ZERO)[0]
    }
}

#[test]
fn one_view_trains_and_cannot_be_held_out_as_well() {
    let dir = tempfile::tempdir().unwrap();
    let views = ring(1, DVec3::ZERO);
    written(dir.path(), &views, three_points(DVec3::ZERO));
    assert_refused(
        load_every(dir.path(), 8),
        &["none is left to train on", "--test-every 0"],
    );
    assert!(train(&views, three_points(DVec3::ZERO)).0 < 0.6);
}

#[test]
fn cameras_in_one_place_train() {
    let camera = ring(1, DVec3::ZERO)[0].1;
    let views: Vec<_> = (0..5).map(|i| (format!("v {i:02}.png"), camera)).collect();
    for points in [three_points(DVec3::ZERO), Vec::new()] {
        assert!(train(&views, points).0 < 0.6);
    }
}

#[test]
fn two_points_and_none_train() {
    let views = ring(9, DVec3::ZERO);
    let two = three_points(DVec3::ZERO)[..2].to_vec();
    assert!(train(&views, two).0 < 0.6);
    let (loss, gaussians) = train(&views, Vec::new());
    assert!(loss < 0.6 && gaussians > 100, "{loss}, {gaussians}");
}

#[test]
fn points_far_away_disturb_nobody() {
    let views = ring(9, DVec3::ZERO);
    let near: Vec<ColmapPoint> = (0..200)
        .map(|i| {
            let t = f64::from(i);
            point([(t * 0.7).sin(), (t * 1.3).cos(), (t * 2.1).sin()])
        })
        .collect();
    let (alone, _) = train(&views, near.clone());
    let far = [[1e7, 0.0, 0.0], [0.0, -1e9, 1e3], [-1e5, 1e5, 1e12]].map(point);
    let (with, _) = train(&views, [near, far.to_vec()].concat());
    assert!(
        with < 1.2 * alone,
        "{with} with points far away, {alone} without"
    );
}
