//! Several cameras and sizes in one set: what a set cut out of the bundled room teaches, and how it is scored.

use std::fs;
use std::path::{Path, PathBuf};

use image::{GrayImage, Luma, Rgb, imageops};

use crate::determinism::{room, trained};
use mhsplat::TrainConfig;
use mhsplat::capture::colmap::ColmapModel;
use mhsplat::capture::transforms::write_transforms;
use mhsplat::capture::{Alpha, Camera, Dataset, LoadOptions, View, load, point_cloud};
use mhsplat::config::Sampler;
use mhsplat::device::{Defines, Device};
use mhsplat::evaluate::{Evaluator, ViewScore};
use mhsplat::pipeline::buffers::ViewSet;
use mhsplat::pipeline::photos::Photos;
use mhsplat::run::FinalRecord;

/// Left, top, width and height of what is kept of every other photo, and of the same of every fourth: upright, and small.
const CROPS: [[u32; 4]; 2] = [[96, 0, 144, 192], [10, 60, 128, 96]];
const ITERATIONS: u32 = 160;

/// How a view of the room is cut, by its place in the order of names.
fn crop(index: usize) -> Option<[u32; 4]> {
    match index % 4 {
        1 => Some(CROPS[0]),
        3 => Some(CROPS[1]),
        _ => None,
    }
}

/// A camera of the cut photo; the principal point moves with the corner.
fn cut(camera: &Camera, [left, top, width, height]: [u32; 4]) -> Camera {
    Camera {
        cx: camera.cx - f64::from(left),
        cy: camera.cy - f64::from(top),
        width,
        height,
        ..*camera
    }
}

/// The bundled room in the dataset's frame: its cameras, every other one cut.
fn cameras() -> Vec<(String, Camera)> {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/room-tiny");
    let data = load(&source, &LoadOptions::default()).unwrap();
    let mut views: Vec<View> = data.train.into_iter().chain(data.test).collect();
    views.sort_by(|a, b| a.name.cmp(&b.name));
    let named = |(k, view): (usize, View)| {
        let mut camera = view.camera;
        let center = data.frame.to_dataset(camera.center());
        camera.translation = -(camera.rotation * center);
        (view.name, crop(k).map_or(camera, |c| cut(&camera, c)))
    };
    views.into_iter().enumerate().map(named).collect()
}

/// Writes the photos of [`cameras`] below `dir/images`. With `masks` every third one has a white box on it, which its mask
/// leaves out.
fn write_photos(dir: &Path, views: &[(String, Camera)], masks: bool) {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/room-tiny/images");
    for folder in ["images", "masks"] {
        fs::create_dir_all(dir.join(folder)).unwrap();
    }
    for (k, (name, camera)) in views.iter().enumerate() {
        let mut photo = image::open(source.join(name)).unwrap().into_rgb8();
        if let Some([left, top, width, height]) = crop(k) {
            photo = imageops::crop_imm(&photo, left, top, width, height).to_image();
        }
        assert_eq!(photo.dimensions(), (camera.width, camera.height));
        if masks && k % 3 == 0 {
            let hidden = |x: u32, y: u32| x < camera.width / 3 && y < camera.height / 2;
            for (x, y, pixel) in photo.enumerate_pixels_mut() {
                if hidden(x, y) {
                    *pixel = Rgb([255; 3]);
                }
            }
            let (w, h) = photo.dimensions();
            GrayImage::from_fn(w, h, |x, y| Luma([if hidden(x, y) { 0 } else { 255 }]))
                .save(dir.join("masks").join(format!("{name}.png")))
                .unwrap();
        }
        photo.save(dir.join("images").join(name)).unwrap();
    }
}

/// The set as a COLMAP model.
fn colmap(dir: &Path, views: &[(String, Camera)], masks: bool) -> PathBuf {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/room-tiny/sparse/0");
    let points = ColmapModel::read(&source, true).unwrap().points;
    let model = ColmapModel::from_views(views, points);
    assert_eq!(model.cameras.len(), 3);
    model.write(&dir.join("sparse/0"), true).unwrap();
    write_photos(dir, views, masks);
    dir.to_path_buf()
}

/// The set as a transforms file with intrinsics of each frame's own.
fn transforms(dir: &Path, views: &[(String, Camera)], masks: bool) -> PathBuf {
    let room = room(256);
    point_cloud::write(&dir.join("points.ply"), &room.points, &room.frame).unwrap();
    let named = |(name, camera): &(String, Camera)| (format!("images/{name}"), *camera);
    let named: Vec<(String, Camera)> = views.iter().map(named).collect();
    write_transforms(&dir.join("transforms.json"), &named, Some("points.ply")).unwrap();
    write_photos(dir, views, masks);
    dir.to_path_buf()
}

fn small(path: &Path) -> Dataset {
    let options = LoadOptions {
        max_size: 64,
        test_every: 5,
        ..LoadOptions::default()
    };
    load(path, &options).unwrap()
}

/// Scores of the held-out views after a few iterations.
fn scores(data: &Dataset) -> Vec<ViewScore> {
    let config = TrainConfig {
        sampler: Sampler::Mh,
        iterations: ITERATIONS,
        max_size: 64,
        sh_degree: 1,
        seed: 3,
        ..TrainConfig::default()
    };
    let (mut trainer, _) = trained(data, &config, ITERATIONS);
    let device = Device::open(None).unwrap();
    let photos = Photos::new(&device, data.image_budget);
    let views = ViewSet::new(&photos, data.test.iter().cloned()).unwrap();
    let evaluator = Evaluator::new(&device, Defines::new(device.tuning()), views).unwrap();
    let scene = &mut trainer;
    evaluator.score_all(scene, [0.0; 3], true).unwrap()
}

fn psnr(scores: &[ViewScore]) -> f64 {
    FinalRecord::of(scores.to_vec()).unwrap().mean.psnr
}

fn sizes(views: &[View]) -> Vec<(u32, u32)> {
    let mut sizes: Vec<(u32, u32)> = views
        .iter()
        .map(|v| (v.camera.width, v.camera.height))
        .collect();
    sizes.sort_unstable();
    sizes.dedup();
    sizes
}

#[test]
fn cameras_of_several_sizes_train_and_are_scored() {
    let dir = tempfile::tempdir().unwrap();
    let views = cameras();
    let whole = psnr(&scores(&small(
        &Path::new(env!("CARGO_MANIFEST_DIR")).join("data/room-tiny"),
    )));
    let by_colmap = small(&colmap(&dir.path().join("colmap"), &views, false));
    let by_transforms = dir.path().join("transforms");
    fs::create_dir(&by_transforms).unwrap();
    let by_transforms = small(&transforms(&by_transforms, &views, false));
    let mut got = Vec::new();
    for data in [&by_colmap, &by_transforms] {
        for part in [&data.train, &data.test] {
            assert_eq!(sizes(part), [(48, 64), (64, 48)]);
        }
        let scores = scores(data);
        assert_eq!(scores.len(), data.test.len());
        got.push(psnr(&scores));
    }
    println!("whole photos {whole:.2} dB, cut ones {got:.2?} dB");
    assert!(got.iter().all(|cut| *cut > whole - 2.0), "{got:?}, {whole}");
    // The principal point is what tells where in the scene a cut photo was taken from.
    let mut wrong = views;
    for (k, (_, camera)) in wrong.iter_mut().enumerate() {
        if crop(k).is_some() {
            camera.cx = f64::from(camera.width) / 2.0;
            camera.cy = f64::from(camera.height) / 2.0;
        }
    }
    let wrong = psnr(&scores(&small(&colmap(
        &dir.path().join("wrong"),
        &wrong,
        false,
    ))));
    println!("with their principal points in the middle {wrong:.2} dB");
    assert!(got[0] > wrong + 1.5, "{got:?}, {wrong}");
}

#[test]
fn masks_of_some_photos_of_several_sizes_count_there_alone() {
    let dir = tempfile::tempdir().unwrap();
    let views = cameras();
    let masked = small(&colmap(&dir.path().join("masked"), &views, true));
    let bare = colmap(&dir.path().join("bare"), &views, true);
    fs::remove_dir_all(bare.join("masks")).unwrap();
    let bare = small(&bare);
    assert_eq!((masked.alpha(), bare.alpha()), (Alpha::Mask, Alpha::None));
    let hidden = |view: &View| {
        let photo = view.photo.load().unwrap();
        let n = (photo.width * photo.height) as usize;
        photo.data[3 * n..].contains(&0)
    };
    let all = masked.train.iter().chain(&masked.test);
    assert_eq!(all.filter(|v| hidden(v)).count(), views.len().div_ceil(3));
    let clean = small(&colmap(&dir.path().join("clean"), &views, false));
    let [masked, bare, clean] = [masked, bare, clean].map(|data| {
        let scores = scores(&data);
        assert_eq!(scores.len(), data.test.len());
        psnr(&scores)
    });
    println!("{clean:.2} dB without boxes, {masked:.2} with masked ones, {bare:.2} with bare ones");
    assert!(masked > clean - 1.5, "{masked}, {clean}");
    assert!(masked > bare + 1.5, "{masked}, {bare}");
}
