//! Photos that are not needed are left in their files.

use std::fs;
use std::path::Path;

use glam::DVec3;

use crate::dataset::colmap_scene;
use crate::photos::with_alpha;
use mhsplat::base::error::Result;
use mhsplat::capture::{Alpha, Dataset, LoadOptions, Needed, PhotoSource, load};

/// Every second photo held out.
fn needing(path: &Path, photos: Needed) -> Result<Dataset> {
    let options = LoadOptions {
        test_every: 2,
        image_budget: None,
        photos,
        ..LoadOptions::default()
    };
    load(path, &options)
}

#[test]
fn photos_that_are_not_needed_are_left_in_their_files() {
    for (painted, alpha) in [
        (None, Alpha::None),
        (Some(false), Alpha::None),
        (Some(true), Alpha::Transparency),
    ] {
        let dir = colmap_scene(5, DVec3::ZERO, true);
        if let Some(transparent) = painted {
            with_alpha(dir.path(), transparent);
        }
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
