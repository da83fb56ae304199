//! Photos that are not needed are left in their files.

use std::fs;
use std::path::Path;

use glam::DVec3;

use crate::dataset::colmap_scene;
use crate::photos::{painted, with_alpha};
use mhsplat::base::error::Result;
use mhsplat::capture::{Dataset, LoadOptions, Needed, PhotoSource, View, load};

/// Every second photo held out.
fn needing(path: &Path, photos: Needed) -> Result<Dataset> {
    let options = LoadOptions {
        test_every: 2,
        photos,
        ..LoadOptions::default()
    };
    load(path, &options)
}

#[test]
fn photos_that_are_not_needed_are_left_in_their_files() {
    for (dir, alpha) in painted() {
        let all = needing(dir.path(), Needed::All).unwrap();
        assert_eq!((all.train.len(), all.test.len()), (2, 3));
        for (photos, in_memory) in [
            (Needed::HeldOut, [false, true]),
            (Needed::Training, [true, false]),
        ] {
            let data = needing(dir.path(), photos).unwrap();
            assert_eq!(data.fingerprint(), all.fingerprint());
            assert_eq!(data.alpha(), alpha);
            for (views, others, in_memory) in [
                (&data.train, &all.train, in_memory[0]),
                (&data.test, &all.test, in_memory[1]),
            ] {
                for (view, other) in views.iter().zip(others) {
                    let memory = matches!(view.photo, PhotoSource::Memory(_));
                    assert_eq!(memory, in_memory, "{photos:?} {}", view.name);
                    assert_eq!(view.photo.load().unwrap(), other.photo.load().unwrap());
                }
            }
        }
    }
}

#[test]
fn broken_photos_are_told_where_they_are_needed_or_may_be_transparent() {
    let dir = colmap_scene(4, DVec3::ZERO, true);
    let all = needing(dir.path(), Needed::All).unwrap();
    let file = dir.path().join("images").join(&all.train[0].name);
    // The header is in order.
    let break_it = || {
        let whole = fs::read(&file).unwrap();
        fs::write(&file, &whole[..whole.len() / 2]).unwrap();
    };
    let refused = |photos| needing(dir.path(), photos).is_err();
    break_it();
    assert!(!refused(Needed::HeldOut) && refused(Needed::Training) && refused(Needed::All));
    let image = image::RgbaImage::from_pixel(16, 12, image::Rgba([200, 100, 50, 255]));
    image.save(&file).unwrap();
    break_it();
    assert!(refused(Needed::HeldOut) && !refused(Needed::None));
}

/// Masks decide which photos count, and are in the fingerprint.
#[test]
fn photos_that_are_not_needed_have_their_masks() {
    let dir = colmap_scene(6, DVec3::ZERO, true);
    let mask = |photo: &str, value| {
        let folder = dir.path().join("masks");
        fs::create_dir_all(&folder).unwrap();
        let mask = image::GrayImage::from_fn(16, 12, |x, _| image::Luma([value * u8::from(x > 7)]));
        mask.save(folder.join(photo)).unwrap();
    };
    let names = |views: &[View]| views.iter().map(|v| v.name.clone()).collect::<Vec<_>>();
    let before = needing(dir.path(), Needed::All).unwrap();
    for views in [&before.train, &before.test] {
        mask(&views[0].name, 0);
        mask(&views[1].name, 255);
    }
    let all = needing(dir.path(), Needed::All).unwrap();
    assert_eq!(
        all.masked_out,
        [&before.train[0].name, &before.test[0].name].map(String::clone)
    );
    assert_ne!(all.fingerprint(), before.fingerprint());
    for photos in [Needed::HeldOut, Needed::Training] {
        let data = needing(dir.path(), photos).unwrap();
        assert_eq!(data.masked_out, all.masked_out, "{photos:?}");
        assert_eq!(data.fingerprint(), all.fingerprint(), "{photos:?}");
        assert_eq!(names(&data.train), names(&all.train));
        for (view, other) in data.views().zip(all.views()) {
            assert_eq!(view.photo.load().unwrap(), other.photo.load().unwrap());
        }
    }
}

#[test]
fn all_photos_are_needed_where_none_is_held_out() {
    let dir = colmap_scene(3, DVec3::ZERO, true);
    let options = LoadOptions {
        test_every: 0,
        photos: Needed::HeldOut,
        ..LoadOptions::default()
    };
    assert!(!load(dir.path(), &options).unwrap().photos_on_demand());
}

/// One photo with alpha widens them all.
#[test]
fn the_budget_counts_the_alpha_plane_that_all_photos_will_have() {
    let dir = colmap_scene(5, DVec3::ZERO, true);
    with_alpha(dir.path(), true);
    for (bytes, on_demand) in [(5 * 16 * 12 * 4, false), (5 * 16 * 12 * 4 - 1, true)] {
        let options = LoadOptions {
            test_every: 0,
            image_budget: Some(bytes),
            ..LoadOptions::default()
        };
        let data = load(dir.path(), &options).unwrap();
        assert_eq!(data.photos_on_demand(), on_demand, "{bytes}");
    }
}
