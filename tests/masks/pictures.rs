//! Masks in pictures of errors, and in scores of a scene without its run.

use std::fs;
use std::path::{Path, PathBuf};

use base64::Engine;
use image::{RgbImage, Rgba, RgbaImage};
use serde_json::Value;

use crate::cli::{done, text};
use crate::dataset::masks::{painted, small};
use mhsplat::capture::Alpha;
use mhsplat::run::report::gallery::{colormap, error_map};

/// The pictures of a report: photo, render and error map of every view shown.
fn pictures(report: &Path) -> Vec<RgbImage> {
    let page = fs::read_to_string(report).unwrap();
    let uris = page.split("src=\"data:image/png;base64,").skip(1);
    let picture = |rest: &str| {
        let end = rest.find('"').unwrap();
        let png = base64::engine::general_purpose::STANDARD
            .decode(&rest[..end])
            .unwrap();
        image::load_from_memory(&png).unwrap().to_rgb8()
    };
    uris.map(picture).collect()
}

#[test]
fn what_is_masked_shows_as_no_error() {
    let dir = tempfile::tempdir().unwrap();
    let data = painted(&dir.path().join("data"), [255, 255, 255], true);
    let run = dir.path().join("run");
    let args = [
        "train",
        text(&data),
        "-o",
        text(&run),
        "--max-size",
        "64",
        "--iterations",
        "8",
    ];
    done(&args);
    let none = colormap(0.0);
    let left = |picture: &RgbImage| {
        let (w, h) = picture.dimensions();
        let at = (0..h).flat_map(|y| (0..w / 2).map(move |x| (x, y)));
        at.map(|(x, y)| picture.get_pixel(x, y).0)
            .collect::<Vec<_>>()
    };
    let right = |picture: &RgbImage| picture.get_pixel(48, 24).0;
    let shown = pictures(&run.join("report.html"));
    assert!(
        shown.len() >= 3 && shown.len().is_multiple_of(3),
        "{}",
        shown.len()
    );
    for view in shown.chunks_exact(3) {
        assert!(left(&view[2]).iter().all(|p| *p == none));
        assert!(
            left(&view[0]).iter().all(|p| *p == [0; 3]),
            "nothing is left of it"
        );
        assert_ne!(
            right(&view[0]),
            [0; 3],
            "the photo is shown where it counts"
        );
        assert!(
            left(&view[1]).iter().any(|p| *p != [0; 3]),
            "the render is shown whole"
        );
    }
    let out = dir.path().join("errors");
    let args = [
        "render",
        text(&run),
        "--dataset",
        text(&data),
        "-o",
        text(&out),
        "--what",
        "error",
    ];
    done(&args);
    let mut seen = 0;
    for file in fs::read_dir(&out).unwrap() {
        let picture = image::open(file.unwrap().path()).unwrap().to_rgb8();
        assert!(left(&picture).iter().all(|p| *p == none));
        let all = picture.pixels().filter(|p| p.0 != none).count();
        assert!(all > 100, "{all} pixels err");
        seen += 1;
    }
    assert_eq!(seen, 5);
    // An error map of the photo without its mask would show.
    let white = [255; 3];
    assert_ne!(error_map(&[0; 3], &white).unwrap(), none);
}

/// The bundled room whose photos are transparent in their left half, with garbage there.
fn holed(dir: &Path) -> PathBuf {
    let path = painted(dir, [255, 0, 255], false);
    fs::remove_dir(path.join("masks")).unwrap();
    for file in fs::read_dir(path.join("images")).unwrap() {
        let file = file.unwrap().path();
        let rgb = image::open(&file).unwrap().into_rgb8();
        let (w, h) = rgb.dimensions();
        let pixel = |x, y| {
            let [r, g, b] = rgb.get_pixel(x, y).0;
            Rgba([r, g, b, if x < w / 2 { 0 } else { 255 }])
        };
        RgbaImage::from_fn(w, h, pixel).save(&file).unwrap();
    }
    path
}

#[test]
fn a_bare_scene_is_scored_with_alpha_as_a_mask_where_asked() {
    let dir = tempfile::tempdir().unwrap();
    let data = holed(&dir.path().join("data"));
    assert_eq!(small(&data).alpha(), Alpha::Transparency);
    let run = dir.path().join("run");
    let args = [
        "train",
        text(&data),
        "-o",
        text(&run),
        "--max-size",
        "64",
        "--iterations",
        "8",
        "--alpha-is-mask",
    ];
    done(&args);
    let scene = run.join("scene.ply");
    let eval = |what: &Path, more: &[&str]| -> Value {
        let mut args = vec![
            "eval",
            text(what),
            text(&data),
            "--max-size",
            "64",
            "--json",
        ];
        args.extend(more);
        serde_json::from_str(&done(&args)).unwrap()
    };
    let by_run = eval(&run, &[]);
    let bare = eval(&scene, &["--alpha-is-mask"]);
    let open = eval(&scene, &[]);
    for key in ["psnr", "ssim", "flip"] {
        assert_eq!(by_run[key], bare[key], "{key}");
        assert_ne!(bare[key], open[key], "{key}");
    }
    let out = dir.path().join("errors");
    let args = [
        "render",
        text(&scene),
        "--dataset",
        text(&data),
        "-o",
        text(&out),
        "--what",
        "error",
        "--max-size",
        "64",
        "--alpha-is-mask",
        "--background",
        "white",
    ];
    done(&args);
    let file = fs::read_dir(&out).unwrap().next().unwrap().unwrap().path();
    let picture = image::open(file).unwrap().to_rgb8();
    assert_eq!(picture.get_pixel(3, 3).0, colormap(0.0));
}
