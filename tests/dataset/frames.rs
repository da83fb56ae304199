//! Datasets far from their origin and in extreme units train as the recentred one does.

use std::fs;
use std::path::Path;

use glam::{DMat3, DQuat, DVec3};

use mhsplat::Plan;
use mhsplat::TrainConfig;
use mhsplat::base::rng::{Philox, Stream};
use mhsplat::capture::colmap::ColmapModel;
use mhsplat::capture::{Frame, LoadOptions, load};
use mhsplat::device::Device;
use mhsplat::run::initial_gaussians;
use mhsplat::train::Trainer;

/// The bundled scene, every position x as scale·x + offset.
fn moved(dir: &Path, scale: f64, offset: DVec3) {
    let room = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/room-tiny");
    let mut model: ColmapModel = ColmapModel::read(&room.join("sparse/0"), true).unwrap();
    for image in &mut model.images {
        let [w, x, y, z] = image.rotation;
        let rotation = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
        let center = -(rotation.transpose() * DVec3::from_array(image.translation));
        image.translation = (-(rotation * (scale * center + offset))).to_array();
    }
    for point in &mut model.points {
        point.position = (scale * DVec3::from_array(point.position) + offset).to_array();
    }
    fs::create_dir_all(dir.join("sparse/0")).unwrap();
    model.write(&dir.join("sparse/0"), true).unwrap();
    fs::create_dir_all(dir.join("images")).unwrap();
    for entry in fs::read_dir(room.join("images")).unwrap() {
        let entry = entry.unwrap();
        fs::copy(entry.path(), dir.join("images").join(entry.file_name())).unwrap();
    }
}

/// Local positions of the points, and the loss after a short training.
fn trained(scale: f64, offset: DVec3) -> (Vec<f32>, f64) {
    let dir = tempfile::tempdir().unwrap();
    moved(dir.path(), scale, offset);
    let options = LoadOptions {
        max_size: 64,
        ..LoadOptions::default()
    };
    let data = load(dir.path(), &options).unwrap();
    let config = TrainConfig {
        iterations: 120,
        max_size: 64,
        ..TrainConfig::default()
    };
    let device = Device::open(None).unwrap();
    let splats = initial_gaussians(&data, &Plan::new(&data, &config).unwrap()).unwrap();
    let mut trainer =
        Trainer::new(&device, &data, &Plan::new(&data, &config).unwrap(), &splats).unwrap();
    trainer.advance_to(config.iterations).unwrap();
    let loss = trainer.recent_loss().unwrap().unwrap();
    (data.points.positions.concat(), loss)
}

#[test]
fn far_from_the_origin_and_in_any_unit_training_is_the_same() {
    let (points, loss) = trained(1.0, DVec3::ZERO);
    let there = DVec3::new(1.0, -0.7, 0.4);
    for (scale, offset) in [
        (1.0, 1e3 * there),
        (1.0, 1e5 * there),
        (1.0, 1e7 * there),
        (1e-6, DVec3::ZERO),
        (1e6, DVec3::ZERO),
        (1e3, 1e9 * there),
    ] {
        let (local, ended) = trained(scale, offset);
        let apart = points.iter().zip(&local).map(|(a, b)| (a - b).abs());
        let apart = apart.fold(0.0f32, f32::max);
        println!(
            "scale {scale:e}, offset {offset}: points apart {apart:e}, loss {ended} against {loss}"
        );
        assert!(apart < 2e-6, "scale {scale:e}, offset {offset}: {apart:e}");
        // Last bits differ, and a short training lets them grow.
        assert!((ended / loss - 1.0).abs() < 0.03, "{ended} against {loss}");
    }
}

/// The names left out, and the extent, of a ring of 40 cameras of which some are moved.
fn ring_with(moved: impl Fn(usize) -> Option<DVec3>) -> (Vec<String>, f64) {
    let dir = tempfile::tempdir().unwrap();
    let mut views = super::ring(40, DVec3::splat(7.0));
    for (k, (name, camera)) in views.iter_mut().enumerate() {
        *name = format!("v {k:02}.png");
        if let Some(center) = moved(k) {
            camera.translation = -(camera.rotation * center);
        }
    }
    ColmapModel::from_views(&views, Vec::new())
        .write(&dir.path().join("sparse/0"), true)
        .unwrap();
    super::write_images(&dir.path().join("images"), &views);
    let data = load(dir.path(), &LoadOptions::default()).unwrap();
    (data.outliers, data.frame.scale)
}

#[test]
fn cameras_astray_are_left_out_by_name() {
    let (outliers, whole) = ring_with(|_| None);
    assert!(outliers.is_empty());
    let (outliers, scale) = ring_with(|k| [3, 8].contains(&k).then(|| DVec3::new(5e3, -2e4, 1e3)));
    assert_eq!(outliers, ["v 03.png", "v 08.png"]);
    assert!((scale / whole - 1.0).abs() < 0.1, "{scale} {whole}");
    // Three of forty are part of the scene, and so is a wide ring about a close one.
    let (outliers, scale) = ring_with(|k| (k < 3).then(|| DVec3::new(5e3, -2e4, 1e3)));
    assert!(outliers.is_empty() && scale > 1e4);
    let (outliers, _) =
        ring_with(|k| (k == 5).then(|| DVec3::splat(7.0) + DVec3::new(30.0, 0.0, 9.0)));
    assert!(outliers.is_empty());
    // Two of three views from a tripod that shakes a little say nothing against the others.
    let shaken = |k: usize| {
        (!k.is_multiple_of(3)).then(|| DVec3::splat(7.0) + DVec3::splat(1e-3 * k as f64))
    };
    let (outliers, scale) = ring_with(shaken);
    assert!(outliers.is_empty() && scale > 2.0, "{outliers:?} {scale}");
}

/// Cameras and points in a cube of edge 6, moved or scaled: f64 coordinates at 10⁷ units resolve 2e-9 units, and local ones are
/// rounded to f32.
#[test]
fn far_offsets_and_extreme_units_leave_the_local_frame() {
    let place = |seed: u64, n: u64| -> Vec<DVec3> {
        let at = |i| {
            let [x, y, z, _] = Philox::uniform(seed, Stream::Synthetic.stream(3), i);
            6.0 * (DVec3::new(x, y, z) - 0.5)
        };
        (0..n).map(at).collect()
    };
    let (cameras, points) = (place(1, 40), place(2, 1000));
    let local = |change: &dyn Fn(DVec3) -> DVec3| -> Vec<f32> {
        let moved = |all: &[DVec3]| all.iter().map(|p| change(*p)).collect::<Vec<_>>();
        let (cameras, points) = (moved(&cameras), moved(&points));
        let frame = Frame::fit(&cameras, &points);
        let all = cameras.iter().chain(&points);
        all.flat_map(|p| frame.to_local(*p).as_vec3().to_array())
            .collect()
    };
    let want = local(&|p| p);
    let largest = want.iter().fold(0.0f32, |l, w| l.max(w.abs()));
    let assert_same = |got: Vec<f32>, case: String| {
        let apart = |(g, w): (&f32, &f32)| f64::from(*g) - f64::from(*w);
        let mut errors = got.iter().zip(&want).map(apart);
        let bound = 1e-6 * f64::from(largest);
        assert!(errors.all(|e| e.abs() <= bound), "{case}");
    };
    for by in [1e3, 1e4, 1e5, 1e6, 1e7] {
        let to = DVec3::new(by, -0.7 * by, 0.4 * by);
        assert_same(local(&|p| p + to), format!("offset {by:e}"));
    }
    for by in [1e-6, 1e-3, 1.0, 1e3, 1e6] {
        assert_same(local(&|p| p * by), format!("unit {by:e}"));
    }
}
