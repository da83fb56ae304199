//! Masks: where they are found, what they do to photos, training and scores.

use std::fs;
use std::path::{Path, PathBuf};

use glam::DVec3;
use image::{GrayImage, Luma, Rgb, RgbImage, Rgba, RgbaImage};
use tempfile::TempDir;

use super::{assert_refused, colmap_scene};
use crate::cli::{done, mhsplat, stderr, text};
use crate::determinism::trained;
use mhsplat::capture::{Alpha, Dataset, LoadOptions, load};
use mhsplat::config::{Sampler, TrainConfig};
use mhsplat::run::PlanRecord;
use mhsplat::train::Plan;

/// The bundled room with a box painted over the left of every photo, which masks leave out if `masked`.
pub fn painted(dir: &Path, colour: [u8; 3], masked: bool) -> PathBuf {
    let from = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/room-tiny");
    for folder in ["images", "sparse/0", "masks"] {
        fs::create_dir_all(dir.join(folder)).unwrap();
    }
    for entry in fs::read_dir(from.join("sparse/0")).unwrap() {
        let file = entry.unwrap().path();
        fs::copy(&file, dir.join("sparse/0").join(file.file_name().unwrap())).unwrap();
    }
    for entry in fs::read_dir(from.join("images")).unwrap() {
        let file = entry.unwrap().path();
        let name = file.file_name().unwrap().to_str().unwrap().to_owned();
        let mut photo = image::open(&file).unwrap().into_rgb8();
        let (w, h) = photo.dimensions();
        for (x, _, pixel) in photo.enumerate_pixels_mut() {
            if x < w / 2 {
                *pixel = Rgb(colour);
            }
        }
        photo.save(dir.join("images").join(&name)).unwrap();
        if masked {
            let mask = GrayImage::from_fn(w, h, |x, _| Luma([if x < w / 2 { 0 } else { 255 }]));
            mask.save(dir.join("masks").join(name + ".png")).unwrap();
        }
    }
    dir.to_path_buf()
}

pub fn small(path: &Path) -> Dataset {
    let options = LoadOptions {
        max_size: 128,
        ..LoadOptions::default()
    };
    load(path, &options).unwrap()
}

#[test]
fn what_is_masked_makes_no_difference_to_training() {
    let dir = tempfile::tempdir().unwrap();
    let [white, black] = [255, 0].map(|v| painted(&dir.path().join(v.to_string()), [v; 3], true));
    let [white, black] = [small(&white), small(&black)];
    assert_eq!(white.alpha(), Alpha::Mask);
    let config = TrainConfig {
        sampler: Sampler::Mh,
        iterations: 60,
        max_size: 128,
        ..TrainConfig::default()
    };
    let kept = PlanRecord::of(&Plan::new(&white, &config).unwrap()).kept;
    assert!(kept.iter().any(|i| i.what == "masks"));
    let scene = |data: &Dataset| trained(data, &config, 60).1;
    let seen = scene(&white);
    assert!(seen == scene(&black));
    // It would without masks.
    let bare = painted(&dir.path().join("bare"), [255; 3], false);
    let bare = small(&bare);
    assert_eq!(bare.alpha(), Alpha::None);
    assert!(seen != scene(&bare));
}

#[test]
fn a_mask_with_partly_masked_pixels_keeps_colours() {
    let dir = tempfile::tempdir().unwrap();
    let data = small(&painted(dir.path(), [9, 9, 9], true));
    let photo = data.train[0].photo.load().unwrap();
    let n = (photo.width * photo.height) as usize;
    assert_eq!((photo.alpha, photo.data.len()), (Alpha::Mask, 4 * n));
    let mask = &photo.data[3 * n..];
    let half = photo.width as usize / 2;
    for (i, m) in mask.iter().enumerate() {
        assert_eq!(
            *m,
            if i % photo.width as usize >= half {
                255
            } else {
                0
            }
        );
        assert!(*m > 0 || photo.data[i] == 0);
    }
}

/// A COLMAP scene of three views of 16 × 12 pixels, with a mask of this size under this name.
fn scene_with(name: &str, size: [u32; 2]) -> TempDir {
    let dir = colmap_scene(3, DVec3::ZERO, true);
    let folder = dir.path().join("masks");
    fs::create_dir_all(&folder).unwrap();
    let mask = GrayImage::from_fn(size[0], size[1], |x, _| Luma([if x < 8 { 0 } else { 255 }]));
    mask.save(folder.join(name)).unwrap();
    dir
}

#[test]
fn masks_are_found_by_the_names_that_tools_give_them() {
    for name in ["v 00.png.png", "v 00.png"] {
        let dir = scene_with(name, [16, 12]);
        let data = load(dir.path(), &LoadOptions::default()).unwrap();
        let views = data.train.iter().chain(&data.test);
        for view in views {
            // Those without a mask count as a whole.
            let photo = view.photo.load().unwrap();
            let black = photo.data[3 * 192..].iter().filter(|m| **m == 0).count();
            assert_eq!(photo.alpha, Alpha::Mask);
            assert_eq!(
                black,
                if view.name == "v 00.png" { 96 } else { 0 },
                "{name}"
            );
        }
    }
}

#[test]
fn a_mask_of_another_size_is_refused_by_name() {
    let dir = scene_with("v 00.png", [8, 6]);
    assert_refused(
        load(dir.path(), &LoadOptions::default()),
        &["v 00.png", "8×6", "16×12"],
    );
}

#[test]
fn a_fingerprint_tells_masks_apart_by_what_is_in_them() {
    let dir = scene_with("v 00.png", [16, 12]);
    let within = |budget| {
        let options = LoadOptions {
            image_budget: budget,
            ..LoadOptions::default()
        };
        load(dir.path(), &options).unwrap().fingerprint()
    };
    let file = dir.path().join("masks/v 00.png");
    let first = within(None);
    let mut seen = vec![first.clone()];
    // One pixel; two alike, each in the last byte of a word of eight; white all over.
    for change in [&[(3, 0)][..], &[(7, 2), (15, 2)], &[(7, 2), (7, 3)]] {
        let mut mask = image::open(&file).unwrap().into_luma8();
        for (x, y) in change {
            mask.put_pixel(*x, *y, Luma([128]));
        }
        mask.save(&file).unwrap();
        seen.push(within(None));
        assert_eq!(seen.last(), Some(&within(Some(1000))), "left in the files");
    }
    GrayImage::from_pixel(16, 12, Luma([255]))
        .save(&file)
        .unwrap();
    seen.push(within(None));
    for (i, a) in seen.iter().enumerate() {
        assert!(!seen[..i].contains(a), "{i}: {seen:?}");
    }
    // The colours are not in it, nor is how the mask's file says it.
    let mask = GrayImage::from_fn(16, 12, |x, _| Luma([if x < 8 { 0 } else { 255 }]));
    image::DynamicImage::from(mask)
        .into_rgb8()
        .save(&file)
        .unwrap();
    assert_eq!(first, within(None));
}

/// A run goes on with its own masks alone, and runs with others are not compared.
#[test]
fn a_run_with_other_masks_is_not_gone_on_with() {
    let dir = tempfile::tempdir().unwrap();
    let data = painted(&dir.path().join("data"), [9, 9, 9], true);
    let [first, second] = ["first", "second"].map(|r| dir.path().join(r));
    let train = |run: &Path| {
        let args = ["train", text(&data), "-o", text(run), "--iterations", "4"];
        done(&[&args[..], &["--max-size", "64"]].concat());
    };
    train(&first);
    let file = data.join("masks/view_0003.png.png");
    let mut mask = image::open(&file).unwrap().into_luma8();
    let (w, h) = mask.dimensions();
    for (x, y) in (0..w).flat_map(|x| (0..h).map(move |y| (x, y))) {
        mask.put_pixel(x, y, Luma([if y < h / 2 { 0 } else { 255 }]));
    }
    mask.save(&file).unwrap();
    train(&second);
    for (args, word) in [
        (
            ["train", text(&data), "--resume", text(&first)],
            "its views are not those of",
        ),
        (
            ["compare", text(&first), text(&second), "--json"],
            "another dataset",
        ),
    ] {
        let refused = mhsplat(&args);
        let said = stderr(&refused);
        assert_eq!(refused.status.code(), Some(2), "{said}");
        assert!(said.contains(word) && said.contains("masks"), "{said}");
    }
}

#[test]
fn alpha_is_transparency_unless_it_is_said_to_be_a_mask() {
    let dir = colmap_scene(3, DVec3::ZERO, false);
    let path = dir.path();
    let file = path.join("images/v 00.png");
    let rgb: RgbImage = image::open(&file).unwrap().into_rgb8();
    let holed = RgbaImage::from_fn(16, 12, |x, y| {
        let [r, g, b] = rgb.get_pixel(x, y).0;
        Rgba([r, g, b, if x < 4 { 0 } else { 255 }])
    });
    holed.save(&file).unwrap();
    for (alpha_is_mask, alpha) in [(false, Alpha::Transparency), (true, Alpha::Mask)] {
        let options = LoadOptions {
            alpha_is_mask,
            ..LoadOptions::default()
        };
        let data = load(path, &options).unwrap();
        assert_eq!(data.alpha(), alpha);
        // Left in their files they say the same.
        let options = LoadOptions {
            image_budget: Some(1000),
            ..options
        };
        assert_eq!(load(path, &options).unwrap().alpha(), alpha);
    }
}

/// The masks of three views, inverted or not, as they are decoded, and as they are read on demand.
fn planes(path: &Path, inverted: bool, alpha_is_mask: bool) -> Vec<Vec<u8>> {
    let of = |image_budget| -> Vec<Vec<u8>> {
        let options = LoadOptions {
            test_every: 0,
            invert_masks: inverted,
            alpha_is_mask,
            image_budget,
            ..LoadOptions::default()
        };
        let data = load(path, &options).unwrap();
        assert_eq!(data.alpha(), Alpha::Mask);
        let plane = |v: &mhsplat::capture::View| v.photo.load().unwrap().data[3 * 192..].to_vec();
        data.train.iter().map(plane).collect()
    };
    let whole = of(None);
    assert_eq!(whole, of(Some(1000)));
    whole
}

#[test]
fn masks_are_inverted_if_asked() {
    let dir = scene_with("v 00.png", [16, 12]);
    let [plain, inverted] = [false, true].map(|inverted| planes(dir.path(), inverted, false));
    let opposite: Vec<u8> = plain[0].iter().map(|m| 255 - m).collect();
    assert!(inverted[0] == opposite && plain[0] != opposite);
    // A photo without a mask counts as a whole either way.
    assert!(inverted[1] == plain[1] && plain[1].iter().all(|m| *m == 255));
    // Alpha is a mask if it is said to be one, and transparency beside one otherwise.
    let file = dir.path().join("images/v 01.png");
    let clear =
        |x: u32, y: u32| Rgba([90, 80, 70, if (x + y).is_multiple_of(3) { 0 } else { 255 }]);
    RgbaImage::from_fn(16, 12, clear).save(&file).unwrap();
    let [plain, inverted] = [false, true].map(|inverted| planes(dir.path(), inverted, true));
    let opposite: Vec<u8> = plain[1].iter().map(|m| 255 - m).collect();
    assert!(inverted[1] == opposite && plain[1] != opposite);
    assert_eq!(planes(dir.path(), true, false)[1], plain[1]);
    // Nothing to invert is a mistake.
    fs::remove_dir_all(dir.path().join("masks")).unwrap();
    let refused = mhsplat(&["info", text(dir.path()), "--invert-masks"]);
    assert_eq!(refused.status.code(), Some(2));
    let said = stderr(&refused);
    assert!(
        said.contains("--invert-masks") && said.contains("no photo has a mask"),
        "{said}"
    );
    done(&[
        "info",
        text(dir.path()),
        "--invert-masks",
        "--alpha-is-mask",
    ]);
}

/// A COLMAP scene of three views of 16 × 12 pixels, the first held out, with black masks for some.
fn blackened(names: &[&str]) -> TempDir {
    let dir = colmap_scene(3, DVec3::ZERO, true);
    let folder = dir.path().join("masks");
    fs::create_dir_all(&folder).unwrap();
    for name in names {
        GrayImage::new(16, 12).save(folder.join(name)).unwrap();
    }
    dir
}

#[test]
fn photos_of_which_masks_leave_nothing_are_left_out_by_name() {
    // In memory, and left in their files.
    for image_budget in [None, Some(1000)] {
        let options = LoadOptions {
            image_budget,
            ..LoadOptions::default()
        };
        let all = blackened(&["v 01.png", "v 02.png"]);
        let words = &["no pixel of any training photo", "--invert-masks"];
        assert_refused(load(all.path(), &options), words);
        let some = blackened(&["v 00.png", "v 02.png"]);
        let data = load(some.path(), &options).unwrap();
        assert_eq!(data.masked_out, ["v 02.png", "v 00.png"]);
        let names: Vec<&str> = data.train.iter().map(|v| v.name.as_str()).collect();
        assert!(names == ["v 01.png"] && data.test.is_empty());
    }
    let held_out = blackened(&["v 00.png"]);
    let run = held_out.path().join("run");
    let (data, run) = (text(held_out.path()), text(&run));
    done(&["train", data, "-o", run, "--iterations", "1"]);
    let eval = mhsplat(&["eval", run, data, "--require-psnr", "0"]);
    assert_eq!(eval.status.code(), Some(2), "{}", stderr(&eval));
    for words in [
        "1 image is masked out completely: v 00.png",
        "no held-out view",
    ] {
        assert!(stderr(&eval).contains(words), "{}", stderr(&eval));
    }
}
