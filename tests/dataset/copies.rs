//! Copies of a dataset on several nodes: compared to the byte.

use std::fs;
use std::path::Path;

use glam::DVec3;
use image::{GrayImage, Luma};

use super::colmap_scene;
use mhsplat::capture::{Dataset, Digests, LoadOptions, load};

fn read(path: &Path) -> Dataset {
    let options = LoadOptions {
        digests: true,
        ..LoadOptions::default()
    };
    load(path, &options).unwrap()
}

fn digests(path: &Path) -> Digests {
    read(path).digests.unwrap()
}

/// The difference in words once the last byte of these files is another one; they are put back.
fn difference(root: &Path, files: &[&str]) -> Option<String> {
    let own = digests(root);
    let paths = files.iter().map(|file| root.join(file));
    let before: Vec<_> = paths.map(|p| (fs::read(&p).unwrap(), p)).collect();
    for (bytes, path) in &before {
        // After the end of an image: the same pixels.
        let longer = path.extension().is_some_and(|e| e == "png");
        let mut other = bytes.clone();
        match other.last_mut().filter(|_| !longer) {
            Some(last) => *last ^= 1,
            None => other.push(0),
        }
        fs::write(path, other).unwrap();
    }
    let other = digests(root).numbers();
    for (bytes, path) in &before {
        fs::write(path, bytes).unwrap();
    }
    assert_eq!(own.difference(&digests(root).numbers()), None, "put back");
    own.difference(&other)
}

#[test]
fn copies_are_compared_to_the_byte_and_what_differs_is_named() {
    let dir = colmap_scene(3, DVec3::ZERO, true);
    let root = dir.path();
    fs::create_dir_all(root.join("masks")).unwrap();
    GrayImage::from_pixel(16, 12, Luma([255]))
        .save(root.join("masks/v 01.png"))
        .unwrap();
    let options = LoadOptions::default();
    assert_eq!(load(root, &options).unwrap().digests, None);
    assert_eq!(digests(root).files.len(), 4);
    let named = |files: &[&str], word: &str| {
        let said = difference(root, files).unwrap();
        assert!(said.ends_with(word), "{files:?}: {said}");
    };
    named(&["images/v 00.png"], "images/v 00.png");
    named(&["masks/v 01.png"], "masks/v 01.png");
    let several = ["images/v 01.png", "images/v 02.png", "masks/v 01.png"];
    named(&several, "images/v 01.png and 2 more");
    assert_eq!(difference(root, &[]), None);
    // Colours of the last point, or what it is seen by: the sparse points are those of the model.
    let own = digests(root);
    let mut other = own.numbers();
    *other.last_mut().unwrap() ^= 1;
    assert_eq!(own.difference(&other).unwrap(), "the sparse points");
    other.pop();
    assert!(own.difference(&other).unwrap().contains("number"));
}

#[test]
fn points_tell_copies_apart() {
    let at = |middle: DVec3| {
        let dir = colmap_scene(3, middle, true);
        digests(dir.path()).points
    };
    assert_eq!(at(DVec3::ZERO), at(DVec3::ZERO));
    assert_ne!(at(DVec3::ZERO), at(DVec3::X));
}
