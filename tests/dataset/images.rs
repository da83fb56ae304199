//! Photos found by name, wherever they lie, and what is said about it.

use std::fs;
use std::path::Path;

use glam::DVec3;
use serde_json::json;
use tempfile::TempDir;

use super::{assert_refused, colmap_scene, load_every, ring};
use crate::cli::{done, mhsplat, program, stderr, text};
use mhsplat::capture::transforms::write_transforms;
use mhsplat::capture::{Dataset, LoadOptions, load};

/// A COLMAP scene of three views whose photos are moved: from their names to where each is to lie below the dataset.
fn moved(to: impl Fn(&str) -> String) -> TempDir {
    let dir = colmap_scene(3, DVec3::ZERO, true);
    for (name, _) in ring(3, DVec3::ZERO) {
        let file = dir.path().join(to(&name));
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        fs::rename(dir.path().join("images").join(&name), file).unwrap();
    }
    let images = dir.path().join("images");
    if fs::read_dir(&images).unwrap().next().is_none() {
        fs::remove_dir(images).unwrap();
    }
    dir
}

fn asked(path: &Path, folder: &str) -> mhsplat::base::error::Result<Dataset> {
    let options = LoadOptions {
        test_every: 0,
        images: Some(folder.into()),
        ..LoadOptions::default()
    };
    load(path, &options)
}

#[test]
fn photos_are_found_by_their_file_names() {
    for (to, place) in [
        ("images/front/", "photos by file name in images/front"),
        ("images_4/", "photos by file name in images_4"),
        ("", "photos by file name in this folder"),
        ("a/b/c/", "photos by file name in a/b/c"),
    ] {
        let dir = moved(|name| format!("{to}{name}"));
        let data = load_every(dir.path(), 0).unwrap();
        assert_eq!((data.train.len(), data.missing.len()), (3, 0), "{to}");
        assert_eq!(data.place, format!("sparse/0, {place}"));
    }
    // Where the dataset says they are nothing is looked for; another extension is no other name.
    let dir = moved(|name| format!("images/{}", name.replace(".png", ".webp")));
    let data = load_every(dir.path(), 0).unwrap();
    assert_eq!(data.place, "sparse/0, photos in images");
    assert_eq!(data.train.len(), 3);
    let dir = moved(|name| format!("elsewhere/{}", name.replace(".png", ".webp")));
    assert_eq!(load_every(dir.path(), 0).unwrap().train.len(), 3);
    // Masks are no photos, nor are depths and normals, whatever they are called.
    for folder in ["masks", "Mask", "depth", "normals", "a/depth_maps"] {
        let dir = moved(|name| format!("{folder}/{name}"));
        let words = ["images", "no such folder", "--images"];
        assert_refused(load_every(dir.path(), 0), &words);
        assert_eq!(asked(dir.path(), folder).unwrap().train.len(), 3);
    }
}

#[test]
fn photos_in_a_format_that_is_converted_first() {
    let dir = moved(|name| format!("images/{name}"));
    let images = dir.path().join("sparse/0/images.bin");
    let text = fs::read(&images).unwrap();
    let renamed: Vec<u8> = text
        .windows(4)
        .enumerate()
        .filter(|(_, w)| w == b".png")
        .fold(text.clone(), |mut all, (i, _)| {
            all[i..i + 4].copy_from_slice(b".tif");
            all
        });
    fs::write(&images, renamed).unwrap();
    // PNGs are found by the names of what they were converted from, whether that is there or not.
    assert_eq!(load_every(dir.path(), 0).unwrap().train.len(), 3);
    let photos = fs::read_dir(dir.path().join("images")).unwrap();
    let photos: Vec<_> = photos.map(|e| e.unwrap().path()).collect();
    for photo in &photos {
        fs::write(photo.with_extension("tif"), b"II*\0\x08\0\0\0").unwrap();
    }
    assert_eq!(load_every(dir.path(), 0).unwrap().train.len(), 3);
    for photo in photos {
        fs::remove_file(photo).unwrap();
    }
    let words = [".tif", "Tiff", "mogrify -colorspace sRGB", "16 *.tif"];
    assert_refused(load_every(dir.path(), 0), &words);
}

#[test]
fn one_name_in_several_places_is_refused() {
    let dir = moved(|name| format!("images_2/{name}"));
    let [half, quarter] = ["images_2", "images_4"].map(|name| dir.path().join(name));
    fs::create_dir(&quarter).unwrap();
    for (name, _) in ring(3, DVec3::ZERO) {
        fs::copy(half.join(&name), quarter.join(&name)).unwrap();
    }
    let words = ["images_2", "images_4", "--images"];
    assert_refused(load_every(dir.path(), 0), &words);
    for name in ["images_2", "images_4", text(&quarter)] {
        let data = asked(dir.path(), name).unwrap();
        assert_eq!(data.train.len(), 3, "{name}");
        assert!(data.place.ends_with(&name[name.len() - 8..]));
    }
    assert_refused(asked(dir.path(), "images_8"), &["images_8", "--images"]);
    // Of folders with the same files, one of them is called as the model calls it.
    let views = ring(3, DVec3::ZERO);
    let transforms = tempfile::tempdir().unwrap();
    let named: Vec<_> = views
        .iter()
        .map(|(name, camera)| (format!("left/{name}"), *camera))
        .collect();
    write_transforms(&transforms.path().join("transforms.json"), &named, None).unwrap();
    for (from, to) in [(&half, "data/left"), (&quarter, "data/right")] {
        let to = transforms.path().join(to);
        fs::create_dir_all(to.parent().unwrap()).unwrap();
        fs::rename(from, to).unwrap();
    }
    let data = load_every(transforms.path(), 0).unwrap();
    let place = "transforms.json, photos by file name in data/left";
    assert_eq!(data.place, place);
}

/// A transforms file of full-sized photos, and smaller ones in another folder.
#[test]
fn smaller_photos_scale_the_cameras_of_a_transforms_file() {
    let views = ring(3, DVec3::ZERO);
    let dir = tempfile::tempdir().unwrap();
    let named: Vec<_> = views
        .iter()
        .map(|(name, camera)| (format!("images/{name}"), *camera))
        .collect();
    let file = dir.path().join("transforms.json");
    write_transforms(&file, &named, None).unwrap();
    fs::create_dir(dir.path().join("images_2")).unwrap();
    for (name, _) in &views {
        let photo = image::RgbImage::new(8, 6);
        photo.save(dir.path().join("images_2").join(name)).unwrap();
    }
    let data = asked(dir.path(), "images_2").unwrap();
    assert_eq!(data.train.len(), 3);
    let camera = data.train[0].camera;
    assert_eq!((camera.width, camera.fx, camera.cy), (8, 10.75, 2.875));
    // Without a size in the file, nobody knows what its focal length is of.
    let whole = fs::read_to_string(&file).unwrap();
    let mut parsed: serde_json::Value = serde_json::from_str(&whole).unwrap();
    for frame in parsed["frames"].as_array_mut().unwrap() {
        frame.as_object_mut().unwrap().remove("w");
    }
    fs::write(&file, parsed.to_string()).unwrap();
    let words = ["fl_x", "--images", "add w and h"];
    assert_refused(asked(dir.path(), "images_2"), &words);
    parsed = json!({"camera_angle_x": 0.7, "frames": parsed["frames"]});
    for frame in parsed["frames"].as_array_mut().unwrap() {
        for key in ["fl_x", "fl_y", "cx", "cy"] {
            frame.as_object_mut().unwrap().remove(key);
        }
    }
    fs::write(&file, parsed.to_string()).unwrap();
    assert_eq!(asked(dir.path(), "images_2").unwrap().train.len(), 3);
}

/// The whole dataset is named in one line, and a run remembers which photos it had.
#[test]
fn the_layout_is_told_at_the_start_and_kept_by_the_run() {
    let dir = moved(|name| format!("images_2/{name}"));
    let run = dir.path().join("run");
    let args = ["train", text(dir.path()), "-o", text(&run)];
    let asked = ["--images", "images_2", "--iterations", "1"];
    let output = mhsplat(&[&args[..], &asked].concat());
    let said = stderr(&output);
    assert!(output.status.success(), "{said}");
    let line = "colmap-bin (sparse/0, photos in images_2), 2 training views";
    assert!(said.contains(line), "{said}");
    // A second folder of the same names would be ambiguous without the run's.
    let other = dir.path().join("images_4");
    fs::create_dir(&other).unwrap();
    for (name, _) in ring(3, DVec3::ZERO) {
        fs::copy(dir.path().join("images_2").join(&name), other.join(&name)).unwrap();
    }
    done(&["eval", text(&run), "--json"]);
    let info = done(&["info", text(dir.path()), "--images", "images_4", "--json"]);
    let info: serde_json::Value = serde_json::from_str(&info).unwrap();
    assert_eq!(info["place"], "sparse/0, photos in images_4");
    // Another place of the dataset may have its photos elsewhere.
    let copy = tempfile::tempdir().unwrap();
    let moved = copy.path().join("dataset");
    fs::remove_dir_all(&other).unwrap();
    fs::create_dir(&moved).unwrap();
    fs::rename(dir.path().join("images_2"), moved.join("images")).unwrap();
    fs::rename(dir.path().join("sparse"), moved.join("sparse")).unwrap();
    done(&["eval", text(&run), text(&moved), "--json"]);
}

/// A folder outside of the dataset is found from wherever a program is started.
#[test]
fn a_run_keeps_the_place_of_photos_that_are_elsewhere() {
    let dir = moved(|name| format!("images/{name}"));
    let elsewhere = tempfile::tempdir().unwrap();
    let photos = elsewhere.path().join("photos");
    fs::rename(dir.path().join("images"), &photos).unwrap();
    let run = dir.path().join("run");
    let train = |more: &[&str]| {
        let output = program()
            .args(["train", text(dir.path()), "-o", text(&run)])
            .args(["--iterations", "1", "--images", "photos", "-q"])
            .args(more)
            .current_dir(elsewhere.path())
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
    };
    train(&[]);
    let record = mhsplat::RunRecord::read(&run).unwrap();
    assert_eq!(record.config.images, Some(photos));
    // The same command again is the same run.
    train(&["--resume-or-start"]);
    done(&["eval", text(&run), "--json"]);
}
