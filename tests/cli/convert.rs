//! `mhsplat convert`, `train --export`, and scenes of other formats wherever a PLY may stand.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::{done, mhsplat, room, scratch_dataset, stderr, stdout, text};
use mhsplat::capture::{Frame, LoadOptions, load};
use mhsplat::lab::synth::SynthLayout;
use mhsplat::scene::formats::{self, SceneFile, Sphere};
use mhsplat::scene::{Gaussians, Plane, morton, ply};

/// A scene of 20 Gaussians along the x axis, the last of which is as good as invisible.
fn scene(dir: &Path) -> PathBuf {
    let file = dir.join("scene.ply");
    let mut splats = Gaussians::zeros(2, 20);
    for i in 0..20 {
        splats.plane_mut(0)[i] = i as f32;
    }
    splats.plane_mut(Plane::OPACITY)[19] = -7.0;
    for v in &mut splats.plane_mut(Plane::LOG_SCALE)[..] {
        *v = -3.0;
    }
    ply::write(&file, &splats, &Frame::IDENTITY).unwrap();
    file
}

fn read(file: &Path) -> SceneFile {
    formats::read(file, &Frame::IDENTITY).unwrap()
}

#[test]
fn there_and_back_again() {
    let dir = tempfile::tempdir().unwrap();
    let file = scene(dir.path());
    for name in ["a.spz", "a.compressed.ply", "a.splat"] {
        let there = dir.path().join(name);
        let said = done(&["convert", text(&file), text(&there)]);
        assert!(said.contains("20 Gaussians"), "{said}");
        let back = dir.path().join(format!("{name}.ply"));
        let json = done(&["convert", text(&there), text(&back), "--json"]);
        let json: Value = serde_json::from_str(&json).unwrap();
        assert_eq!(json["gaussians"], 20);
        assert_eq!(json["bytes"], fs::metadata(&back).unwrap().len());
        let splats = read(&back).splats.in_morton_order(morton::NO_UP);
        assert_eq!(splats.len(), 20);
        for i in 0..20 {
            let [x, y, z] = splats.gather(Plane::POSITION, i);
            assert!(
                (x - i as f32).abs() < 0.01 && y == 0.0 && z == 0.0,
                "{name} {x} {y} {z}"
            );
        }
    }
}

#[test]
fn a_run_over_the_mean_color_shows_it_everywhere() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    let args = ["--iterations", "60", "--max-size", "64", "--export", "glb"];
    done(&[&["train", &room(), "-o", text(&run)][..], &args].concat());
    let record = fs::read(run.join("run.json")).unwrap();
    let record: Value = serde_json::from_slice(&record).unwrap();
    let color = &record["background"];
    assert!(color[0].as_f64().unwrap() > 0.1, "{color}");
    assert_eq!(record["config"]["background"], "auto");
    let scored = |scene: &Path, more: &[&str]| {
        let args = ["--max-size", "64", "--json"];
        let data = room();
        let said = done(&[&["eval", text(scene), &data][..], &args, more].concat());
        let json: Value = serde_json::from_str(&said).unwrap();
        (json["psnr"].as_f64().unwrap(), json["gaussians"].clone())
    };
    let psnr = record["final"]["psnr"].as_f64().unwrap();
    let count = &record["gaussians"];
    let file = run.join("scene.ply");
    for scene in [&run, &file] {
        let (own, gaussians) = scored(scene, &[]);
        assert!((own - psnr).abs() < 1e-4, "{own} {psnr}");
        assert_eq!(gaussians, *count);
    }
    let (shown, all) = scored(&run.join("scene.glb"), &[]);
    assert!((shown - psnr).abs() < 0.01, "{shown} {psnr}");
    assert_eq!(all.as_u64(), count.as_u64().map(|n| n + 2048));
    let (black, _) = scored(&run, &["--background", "black"]);
    assert!(black < psnr - 0.1, "{black} {psnr}");
    let said = done(&["info", text(&file), "--json"]);
    let said: Value = serde_json::from_str(&said).unwrap();
    assert_eq!(
        (&said["background"], &said["gaussians"]),
        (color, count),
        "{said}"
    );
    assert!(done(&["info", text(&file)]).contains("background: "));
    // Gaussians of a file that a run begins with are those alone.
    let [whole, part] = ["whole.ply", "part.ply"].map(|name| dir.path().join(name));
    done(&["convert", text(&file), text(&whole)]);
    let [own, again] = [&file, &whole].map(|file| read(file));
    assert!(again.splats == own.splats && own.background.is_some());
    assert_eq!(again.background, own.background);
    let crop = "--crop=-2,-2,-2,2,2,2";
    done(&["convert", text(&file), text(&part), crop]);
    assert_eq!(read(&part).background, None);
    let bare = dir.path().join("bare.glb");
    done(&["convert", text(&file), text(&bare), "--no-background"]);
    assert_eq!(Some(read(&bare).splats.len() as u64), count.as_u64());
}

#[test]
fn parts_are_kept() {
    let dir = tempfile::tempdir().unwrap();
    let file = scene(dir.path());
    let convert = |name: &str, options: &[&str]| {
        let out = dir.path().join(name);
        let args = [&["convert", text(&file), text(&out)][..], options].concat();
        done(&args);
        read(&out).splats
    };
    // Corners in any order; their faces belong to the box.
    let cropped = convert("a.ply", &["--crop", "7,-1,1,3,1,-1"]);
    assert_eq!(cropped.planes()[0], [3.0, 4.0, 5.0, 6.0, 7.0]);
    assert_eq!(convert("c.ply", &["--min-opacity", "0.01"]).len(), 19);
    assert_eq!(convert("d.ply", &["--min-opacity", "0"]).len(), 20);
    assert_eq!(convert("e.ply", &["--sh-degree", "1"]).sh_degree(), 1);
    assert_eq!(convert("f.ply", &["--sh-degree", "3"]).sh_degree(), 2);
    let both = ["--crop", "0,0,0,9,0,0", "--sh-degree", "0"];
    let both = convert("g.spz", &both);
    assert_eq!((both.len(), both.sh_degree()), (10, 0));
}

#[test]
fn what_cannot_be_converted_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let file = scene(dir.path());
    let taken = dir.path().join("taken.spz");
    fs::write(&taken, "mine").unwrap();
    let out = dir.path().join("out.spz");
    let [scene, taken_name, out_name] = [&file, &taken, &out].map(|p| text(p));
    let (none, empty) = (dir.path().join("none.ply"), dir.path().join("empty"));
    fs::create_dir(&empty).unwrap();
    for (args, word) in [
        (vec![scene, taken_name], "name another file"),
        (vec![scene, scene], "name another file"),
        (vec![scene, "out.sog"], ".compressed.ply"),
        (vec![scene, "out"], ".spz"),
        (vec![text(&none), out_name], "none.ply"),
        (vec![taken_name, out_name], "taken.spz"),
        (
            vec![text(&empty), out_name],
            "a scene file or the folder of a run",
        ),
        (vec![scene, out_name, "--crop", "1,2,3"], "six numbers"),
        (
            vec![scene, out_name, "--crop", "1,2,3,4,5,nan"],
            "six numbers",
        ),
        (vec![scene, out_name, "--min-opacity", "2"], "0 to 1"),
        (vec![scene, out_name, "--sh-degree", "4"], "--sh-degree"),
    ] {
        let output = mhsplat(&[&["convert"][..], &args[..]].concat());
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{args:?}: {said}");
        assert!(said.contains(word), "{args:?}: {said}");
        assert!(!out.exists(), "{args:?}");
    }
    assert_eq!(fs::read_to_string(&taken).unwrap(), "mine");
}

/// Opacities of 0 and 1 are told once, by everything that reads scenes.
#[test]
fn saturated_opacities_are_told_once() {
    let dir = tempfile::tempdir().unwrap();
    let file = scene(dir.path());
    let mut bytes = fs::read(&file).unwrap();
    // The opacity of the last Gaussian: eight values before its end, of which three are scales and four the rotation.
    let at = bytes.len() - 8 * 4;
    bytes[at..at + 4].copy_from_slice(&f32::NEG_INFINITY.to_le_bytes());
    fs::write(&file, bytes).unwrap();
    let data = scratch_dataset(dir.path(), SynthLayout::Colmap);
    let [scene, data] = [&file, &data].map(|p| text(p));
    let out = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let [spz, views, run] = ["a.spz", "views", "run"].map(out);
    let train = [
        "train",
        data,
        "-o",
        &run,
        "--iterations",
        "2",
        "--sampler",
        "none",
        "--init",
        scene,
    ];
    for args in [
        &["convert", scene, &spz][..],
        &["eval", scene, data],
        &["render", scene, "--orbit", "1", "-o", &views],
        &train,
    ] {
        let output = mhsplat(args);
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(0), "{args:?}: {said}");
        let told = said.matches("1 opacities are exactly 0 or 1").count();
        assert_eq!(told, 1, "{args:?}: {said}");
    }
}

#[test]
fn a_run_exports_what_is_asked_for() {
    let dir = tempfile::tempdir().unwrap();
    let data = scratch_dataset(dir.path(), SynthLayout::Colmap);
    let run = dir.path().join("run");
    let args = [
        "train",
        text(&data),
        "-o",
        text(&run),
        "--iterations",
        "4",
        "--export",
        "spz,compressed-ply,splat",
        "--anti-aliasing",
        "on",
    ];
    let output = mhsplat(&args);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(0), "{said}");
    // .splat has no mark of anti-aliasing, which is told once.
    assert_eq!(
        said.matches("scene.splat: the mark of").count(),
        1,
        "{said}"
    );
    let own = read(&run.join("scene.ply"));
    assert!(own.up.is_some() && own.anti_aliased);
    let frame = load(&data, &LoadOptions::default()).unwrap().frame;
    let (center, radius) = (frame.center, frame.scale);
    assert_eq!(own.cameras, Some(Sphere { center, radius }));
    let told = done(&["info", text(&run.join("scene.ply"))]);
    assert!(told.contains("cameras: within"), "{told}");
    let json = done(&["info", text(&run.join("scene.ply")), "--json"]);
    let json: Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["cameras"]["radius"], radius);
    // Their backgrounds are Gaussians.
    let shell = 2048;
    for (name, marked, more) in [
        ("scene.spz", true, shell),
        ("scene.compressed.ply", true, 0),
        ("scene.splat", false, shell),
    ] {
        let other = read(&run.join(name));
        assert_eq!(other.splats.len(), own.splats.len() + more, "{name}");
        assert_eq!(other.anti_aliased, marked, "{name}");
    }
    // Rendered as the PLY is, and gone on from.
    let score = |name: &str| -> f64 {
        let file = run.join(name);
        let json = done(&["eval", text(&file), text(&data), "--json"]);
        let json: Value = serde_json::from_str(&json).unwrap();
        json["psnr"].as_f64().unwrap()
    };
    let (ply, spz, packed) = (
        score("scene.ply"),
        score("scene.spz"),
        score("scene.compressed.ply"),
    );
    assert!(
        (ply - spz).abs() < 0.5 && (ply - packed).abs() < 0.5,
        "{ply} {spz} {packed}"
    );
    let (on, init) = (dir.path().join("on"), run.join("scene.spz"));
    let args = [
        "train",
        text(&data),
        "-o",
        text(&on),
        "--iterations",
        "2",
        "--init",
        text(&init),
        "-v",
    ];
    let output = mhsplat(&args);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(
        stderr(&output).contains("were trained with it"),
        "{}",
        stderr(&output)
    );
    let wrong = mhsplat(&["train", &room(), "--export", "ply"]);
    assert_eq!(wrong.status.code(), Some(2), "{}", stdout(&wrong));
}
