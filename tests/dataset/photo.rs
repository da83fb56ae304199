//! Photos: area filter, alpha, shapes.

use std::fs;

use glam::DVec3;

use super::{assert_refused, colmap_scene, load_every, ring};
use mhsplat::capture::{Alpha, LoadOptions, Photo, load, shrink};

#[test]
fn area_filter_is_exact() {
    // 3 → 2: each target covers one and a half sources, hence weights 2/3 and 1/3.
    let row = [30_u8, 60, 240];
    let bytes: Vec<u8> = row.iter().flat_map(|&v| [v, v, 0]).collect();
    let photo = shrink(3, 1, Alpha::None, &bytes, 2, 1).unwrap();
    assert_eq!(photo.data, [40, 180, 40, 180, 0, 0]);
    // 4×2 → 2×1: plain means of 2×2 blocks.
    let bytes: Vec<u8> = [0, 10, 20, 100, 40, 50, 60, 120]
        .iter()
        .flat_map(|&v| [v, 255, v])
        .collect();
    let photo = shrink(4, 2, Alpha::None, &bytes, 2, 1).unwrap();
    assert_eq!(photo.data, [25, 75, 255, 255, 25, 75]);
}

#[test]
fn area_filter_keeps_the_mean_at_any_ratio() {
    let (w, h) = (37_u32, 23_u32);
    let bytes: Vec<u8> = (0..w * h * 3).map(|i| (i * 7919 % 251) as u8).collect();
    let mean = |data: &[u8]| data.iter().map(|&v| f64::from(v)).sum::<f64>() / data.len() as f64;
    for (tw, th) in [(36, 22), (20, 13), (7, 23), (1, 1)] {
        let photo = shrink(w, h, Alpha::None, &bytes, tw, th).unwrap();
        let off = (mean(&photo.data) - mean(&bytes)).abs();
        // Rounding to bytes alone: half a level at worst, far less on average over many pixels.
        assert!(off < 0.5, "{tw}×{th}: mean off by {off}");
    }
    let flat = shrink(w, h, Alpha::None, &vec![255; bytes.len()], 11, 5).unwrap();
    assert!(flat.data.iter().all(|&v| v == 255));
}

#[test]
fn transparent_pixels_do_not_bleed() {
    let bytes = [255, 0, 0, 255, 0, 255, 0, 0];
    let photo = shrink(2, 1, Alpha::Transparency, &bytes, 1, 1).unwrap();
    assert_eq!(photo.data, [128, 0, 0, 128]);
    assert_eq!(photo.rgb_over([0.0, 0.0, 1.0]), [128, 0, 127]);
}

#[test]
fn area_filter_refuses_nonsense() {
    let bytes = [0; 12];
    assert!(shrink(2, 2, Alpha::None, &bytes, 3, 2).is_err());
    assert!(shrink(2, 2, Alpha::None, &bytes, 0, 2).is_err());
    assert!(shrink(2, 2, Alpha::None, &bytes[..11], 1, 1).is_err());
    assert!(Photo::from_interleaved(2, 2, Alpha::None, &bytes[..11]).is_err());
    assert!(Photo::from_interleaved(0, 2, Alpha::None, &[]).is_err());
}

#[test]
fn composites_over_a_background() {
    let photo = Photo::from_interleaved(
        1,
        2,
        Alpha::Transparency,
        &[200, 100, 0, 0, 10, 20, 30, 255],
    )
    .unwrap();
    assert_eq!(photo.rgb_over([1.0, 0.5, 0.0]), [255, 128, 0, 10, 20, 30]);
    let photo = Photo::from_interleaved(1, 1, Alpha::None, &[1, 2, 3]).unwrap();
    assert_eq!(photo.rgb_over([1.0; 3]), [1, 2, 3]);
    assert_eq!(photo.data, [1, 2, 3]);
}

#[test]
fn photos_shrink_with_their_cameras() {
    let dir = colmap_scene(3, DVec3::ZERO, true);
    let options = LoadOptions {
        max_size: 5,
        test_every: 0,
        ..LoadOptions::default()
    };
    let d = load(dir.path(), &options).unwrap();
    let view = &d.train[0];
    let photo = view.photo.load().unwrap();
    assert_eq!((photo.width, photo.height), (5, 4));
    let c = &view.camera;
    assert_eq!((c.width, c.height), (5, 4));
    let expected = [21.5 * 5.0 / 16.0, 20.25 / 3.0, 8.5 * 5.0 / 16.0, 5.75 / 3.0];
    for (found, expected) in [c.fx, c.fy, c.cx, c.cy].into_iter().zip(expected) {
        assert!((found - expected).abs() < 1e-12, "{found} {expected}");
    }
    let full = load_every(dir.path(), 0).unwrap();
    assert_eq!(full.train[0].photo.load().unwrap().width, 16);
    assert_eq!(full.train[0].camera.fx, 21.5);
}

#[test]
fn photos_of_another_size_rescale_their_cameras() {
    let dir = colmap_scene(2, DVec3::ZERO, true);
    let file = dir.path().join("images/v 00.png");
    image::RgbImage::new(32, 24).save(&file).unwrap();
    let d = load_every(dir.path(), 0).unwrap();
    assert_eq!((d.train[0].camera.fx, d.train[0].camera.cy), (43.0, 11.5));
    assert_eq!(d.train[1].camera.fx, 21.5);
    image::RgbImage::new(32, 30).save(&file).unwrap();
    assert_refused(load_every(dir.path(), 0), &["v 00.png", "32×30", "16×12"]);
}

#[test]
fn one_photo_with_alpha_gives_all_an_alpha_plane() {
    let dir = colmap_scene(3, DVec3::ZERO, true);
    let file = dir.path().join("images/v 01.png");
    let opaque = image::RgbaImage::from_pixel(16, 12, image::Rgba([9, 8, 7, 255]));
    opaque.save(&file).unwrap();
    let d = load_every(dir.path(), 0).unwrap();
    assert_eq!(d.alpha(), Alpha::None);
    assert!(d.train.iter().all(|v| v.photo.alpha() == Alpha::None));
    let mut photo = opaque;
    photo.put_pixel(3, 3, image::Rgba([9, 8, 7, 0]));
    photo.save(&file).unwrap();
    let d = load_every(dir.path(), 0).unwrap();
    assert_eq!(d.alpha(), Alpha::Transparency);
    for view in &d.train {
        let photo = view.photo.load().unwrap();
        assert_eq!(
            (photo.alpha, photo.data.len()),
            (Alpha::Transparency, 4 * 16 * 12)
        );
    }
    let photo = d.train[0].photo.load().unwrap();
    assert!(photo.data[3 * 16 * 12..].iter().all(|&a| a == 255));
}

#[test]
fn what_is_no_image_is_named() {
    let dir = colmap_scene(2, DVec3::ZERO, true);
    let name = ring(2, DVec3::ZERO)[1].0.clone();
    let file = dir.path().join("images").join(&name);
    let whole = fs::read(&file).unwrap();
    fs::write(&file, b"not a photo").unwrap();
    assert_refused(load_every(dir.path(), 0), &[&name, "not a readable image"]);
    fs::write(&file, &whole[..whole.len() / 2]).unwrap();
    assert_refused(load_every(dir.path(), 0), &[&name, "not a readable image"]);
    fs::write(&file, b"").unwrap();
    assert_refused(load_every(dir.path(), 0), &[&name, "not a readable image"]);
}
