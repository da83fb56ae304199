//! Bad input: one clear line that names the place, exit code 2, nothing written and nothing lost.

use std::fs;
use std::path::Path;

use super::{mhsplat, room, scratch_dataset, stderr, stdout, text};
use mhsplat::base::files::FolderLock;
use mhsplat::lab::synth::SynthLayout;

/// Trains on `dataset` and asserts that it is refused in one line that contains every one of `words`, leaving no run.
fn refused(dataset: &Path, words: &[&str]) {
    let out = dataset.parent().unwrap().join("out");
    let args = [
        "train",
        text(dataset),
        "-o",
        text(&out),
        "--iterations",
        "5",
    ];
    let output = mhsplat(&args);
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{message}");
    let errors: Vec<&str> = message
        .lines()
        .filter(|l| l.starts_with("error: "))
        .collect();
    assert_eq!(errors.len(), 1, "{message}");
    for word in words {
        assert!(errors[0].contains(word), "{word:?} is not in: {message}");
    }
    assert!(
        !message.contains("panicked") && stdout(&output).is_empty(),
        "{message}"
    );
    assert!(!out.exists(), "a refused run left its folder");
}

fn replace(file: &Path, from: &str, to: &str) {
    let before = fs::read_to_string(file).unwrap();
    let after = before.replacen(from, to, 1);
    assert_ne!(before, after, "{from:?} is not in {}", file.display());
    fs::write(file, after).unwrap();
}

/// A fresh dataset, damaged by `damage`, must be refused.
fn damaged(layout: SynthLayout, words: &[&str], damage: impl Fn(&Path)) {
    let dir = tempfile::tempdir().unwrap();
    let dataset = scratch_dataset(dir.path(), layout);
    damage(&dataset);
    refused(&dataset, words);
}

fn any_image(dataset: &Path) -> std::path::PathBuf {
    let mut images: Vec<_> = fs::read_dir(dataset.join("images"))
        .unwrap()
        .map(|e| e.unwrap().path())
        .collect();
    images.sort();
    images.swap_remove(3)
}

#[test]
fn missing_images() {
    damaged(SynthLayout::Colmap, &["images"], |d| {
        fs::remove_dir_all(d.join("images")).unwrap();
    });
}

#[test]
fn a_file_that_is_no_image() {
    damaged(SynthLayout::Colmap, &["images/"], |d| {
        fs::write(any_image(d), "not a picture").unwrap();
    });
}

#[test]
fn truncated_models() {
    for file in ["cameras.bin", "images.bin", "points3D.bin"] {
        damaged(SynthLayout::Colmap, &[file], |d| {
            let path = d.join("sparse/0").join(file);
            let bytes = fs::read(&path).unwrap();
            fs::write(&path, &bytes[..bytes.len() - 7]).unwrap();
        });
    }
}

#[test]
fn a_camera_model_that_is_not_taken() {
    damaged(
        SynthLayout::ColmapTxt,
        &["cameras.txt", "EQUIRECTANGULAR", "2 expected"],
        |d| {
            replace(
                &d.join("sparse/0/cameras.txt"),
                " PINHOLE ",
                " EQUIRECTANGULAR ",
            );
        },
    );
}

#[test]
fn a_panorama_of_another_shape() {
    damaged(
        SynthLayout::Transforms,
        &["pixels", "twice as wide as high", "mask"],
        |d| {
            for file in ["transforms_train.json", "transforms_test.json"] {
                let file = d.join(file);
                let text = fs::read_to_string(&file).unwrap();
                let mut all: serde_json::Value = serde_json::from_str(&text).unwrap();
                all["camera_model"] = "EQUIRECTANGULAR".into();
                for key in ["fl_x", "fl_y", "cx", "cy", "camera_angle_x"] {
                    all.as_object_mut().unwrap().remove(key);
                    for frame in all["frames"].as_array_mut().unwrap() {
                        frame.as_object_mut().unwrap().remove(key);
                    }
                }
                fs::write(&file, all.to_string()).unwrap();
            }
        },
    );
}

#[test]
fn points_that_are_no_numbers() {
    damaged(SynthLayout::ColmapTxt, &["points3D.txt"], |d| {
        let path = d.join("sparse/0/points3D.txt");
        let all = fs::read_to_string(&path).unwrap();
        let line = all.lines().find(|l| !l.starts_with('#')).unwrap();
        let mut fields: Vec<&str> = line.split(' ').collect();
        fields[1] = "NaN";
        fs::write(&path, all.replace(line, &fields.join(" "))).unwrap();
    });
}

#[test]
fn no_views() {
    damaged(SynthLayout::ColmapTxt, &["images.txt"], |d| {
        fs::write(d.join("sparse/0/images.txt"), "# none\n").unwrap();
    });
    damaged(SynthLayout::Transforms, &["transforms_train.json"], |d| {
        fs::write(
            d.join("transforms_train.json"),
            r#"{"camera_angle_x": 0.7, "frames": []}"#,
        )
        .unwrap();
    });
}

#[test]
fn json_that_is_none() {
    damaged(SynthLayout::Transforms, &["transforms_train.json"], |d| {
        fs::write(d.join("transforms_train.json"), "{\"frames\": [").unwrap();
    });
}

#[test]
fn a_folder_that_is_no_dataset() {
    let dir = tempfile::tempdir().unwrap();
    let empty = dir.path().join("empty");
    fs::create_dir(&empty).unwrap();
    refused(&empty, &["empty", "sparse/0", "transforms"]);
    refused(&dir.path().join("nowhere"), &["nowhere"]);
}

/// A folder of datasets, with a photo beside them: the datasets are named.
#[test]
fn a_folder_of_datasets() {
    let dir = tempfile::tempdir().unwrap();
    let above = dir.path().join("scenes");
    scratch_dataset(&above.join("attic"), SynthLayout::Colmap);
    fs::rename(above.join("attic/dataset"), above.join("kitchen")).unwrap();
    fs::copy(any_image(&above.join("kitchen")), above.join("cover.png")).unwrap();
    refused(
        &above,
        &["scenes", "kitchen in it is one", "scenes/kitchen"],
    );
    let shed = scratch_dataset(&above.join("attic"), SynthLayout::Transforms);
    fs::rename(shed, above.join("shed")).unwrap();
    refused(&above, &["2 folders", "kitchen, shed"]);
}

#[test]
fn an_existing_run_is_never_touched() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    fs::create_dir(&run).unwrap();
    fs::write(run.join("scene.ply"), "mine").unwrap();
    let output = mhsplat(&["train", &room(), "-o", text(&run)]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("exists already"));
    assert_eq!(fs::read_to_string(run.join("scene.ply")).unwrap(), "mine");
    assert_eq!(fs::read_dir(&run).unwrap().count(), 1);
}

/// A folder that the user made, or a job before.
#[test]
fn an_empty_run_folder_is_used() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    fs::create_dir(&run).unwrap();
    let output = mhsplat(&[
        "train",
        &room(),
        "-o",
        text(&run),
        "--max-size",
        "32",
        "--iterations",
        "2",
    ]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(run.join("run.json").exists());
    assert_eq!(
        fs::read_dir(dir.path()).unwrap().count(),
        1,
        "nothing beside it"
    );
}

#[cfg(target_os = "linux")]
#[test]
fn lost_output_is_a_failure() {
    let full = || {
        fs::OpenOptions::new()
            .write(true)
            .open("/dev/full")
            .unwrap()
    };
    let mut devices = super::program();
    let lost = devices
        .args(["devices", "--json"])
        .stdout(full())
        .output()
        .unwrap();
    assert_eq!(lost.status.code(), Some(2));
    assert!(
        stderr(&lost).contains("standard output"),
        "{}",
        stderr(&lost)
    );
}

#[test]
fn an_output_that_cannot_be_written() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("file");
    fs::write(&file, "mine").unwrap();
    let output = mhsplat(&["train", &room(), "-o", text(&file.join("run"))]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("cannot be made"));
    assert_eq!(fs::read_to_string(&file).unwrap(), "mine");
}

#[test]
fn configurations_that_make_no_sense() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("config.toml");
    let out = dir.path().join("out");
    for (config, word) in [
        ("iteratoins = 5", "iteratoins"),
        ("iterations = 0", "iterations"),
        ("sh-degree = 4", "sh-degree"),
        ("image-budget = 0", "image-budget"),
        ("image-budget = \"much\"", "image-budget"),
        ("[optimizer]\nlr-scale = -1.0", "optimizer"),
        ("[mh]\nvoxel-edge = [0.0, 0.1]", "mh"),
        ("[mh]\nweight-opacity = nan", "mh"),
        ("not toml", "config.toml"),
    ] {
        fs::write(&file, config).unwrap();
        let output = mhsplat(&["train", &room(), "-o", text(&out), "--config", text(&file)]);
        assert_eq!(output.status.code(), Some(2), "{config}");
        assert!(
            stderr(&output).contains(word),
            "{config}: {}",
            stderr(&output)
        );
        assert!(!out.exists());
    }
    for (flag, value) in [
        ("--sh-degree", "9"),
        ("--time-budget", "soon"),
        ("--background", "plaid"),
        ("--init", "nowhere.ply"),
        ("--max-size", "0"),
        ("--clearance", "1"),
        ("--clearance", "nan"),
        ("--image-budget", "0"),
        ("--image-budget", "much"),
        ("--image-budget", "1K"),
    ] {
        let output = mhsplat(&["train", &room(), "-o", text(&out), flag, value]);
        assert_eq!(output.status.code(), Some(2), "{flag} {value}");
        assert!(!out.exists(), "{flag} {value} left a folder");
    }
}

/// What is only shown has one background.
#[test]
fn backgrounds_that_change_are_for_training() {
    let dir = tempfile::tempdir().unwrap();
    let (run, out) = (dir.path().join("run"), dir.path().join("out"));
    let (data, short) = (room(), ["--iterations", "1", "--max-size", "32"]);
    let train = [&["train", &data, "-o", text(&run)][..], &short].concat();
    assert_eq!(mhsplat(&train).status.code(), Some(0));
    for value in ["auto", "random", "plaid"] {
        let eval = ["eval", text(&run), &data, "--background", value];
        let orbit = ["render", text(&run), "--orbit", "1", "-o", text(&out)];
        let render = [&orbit[..], &["--background", value]].concat();
        for args in [&eval[..], &render] {
            let output = mhsplat(args);
            assert_eq!(output.status.code(), Some(2), "{args:?}");
            let message = stderr(&output);
            assert!(message.contains("black, white or R,G,B"), "{message}");
        }
    }
    assert!(!out.exists());
}

/// A number below 0 is a wrong value, not an unknown option.
#[test]
fn negative_numbers_are_named() {
    for (flag, value) in [
        ("--iterations", "-5"),
        ("--max-size", "-1"),
        ("--seed", "-2"),
    ] {
        let output = mhsplat(&["train", &room(), flag, value]);
        assert_eq!(output.status.code(), Some(2));
        let message = stderr(&output);
        assert!(
            message.contains(&format!("invalid value '{value}' for '{flag}")),
            "{message}"
        );
    }
}

/// Two jobs of a cluster may have been given one folder.
#[test]
fn a_folder_that_another_process_works_in_is_left_alone() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    let short = ["--iterations", "1", "--max-size", "32"];
    let data = room();
    let train = [&["train", &data, "-o", text(&run)][..], &short].concat();
    assert_eq!(mhsplat(&train).status.code(), Some(0));
    let resume = || mhsplat(&["train", "--resume", text(&run)]);
    let lock = FolderLock::take(&run).unwrap();
    let refused = resume();
    assert_eq!(refused.status.code(), Some(2));
    assert!(
        stderr(&refused).contains("another process"),
        "{}",
        stderr(&refused)
    );
    drop(lock);
    assert_eq!(resume().status.code(), Some(0));
}

/// Other formats of scenes, and a target that is missing.
#[test]
fn scenes_are_told_the_way_on() {
    let dir = tempfile::tempdir().unwrap();
    for (name, way) in [
        (
            "scene.spz",
            "give a scene of PLY, compressed PLY, SPZ, SOG, .splat or .glb",
        ),
        ("scene.splat", "export the .splat file again"),
        ("scene.ksplat", "convert it to .ply, .spz or .glb"),
        ("scene.sog", "export the SOG file again"),
    ] {
        let file = dir.path().join(name);
        fs::write(&file, "mine").unwrap();
        let output = mhsplat(&["eval", text(&file), &room()]);
        assert_eq!(output.status.code(), Some(2));
        assert!(stderr(&output).contains(way), "{}", stderr(&output));
    }
    let ply = dir.path().join("scene.ply");
    fs::write(&ply, "mine").unwrap();
    let (out, ply) = (dir.path().join("out"), text(&ply));
    for args in [&["eval", ply][..], &["render", ply, "-o", text(&out)]] {
        let output = mhsplat(args);
        assert_eq!(output.status.code(), Some(2));
        let way = match args[0] {
            "eval" => "after it",
            _ => "--orbit N",
        };
        assert!(stderr(&output).contains(way), "{}", stderr(&output));
    }
}

#[test]
fn nothing_to_resume() {
    let dir = tempfile::tempdir().unwrap();
    let output = mhsplat(&["train", &room(), "--resume", text(dir.path())]);
    assert_eq!(output.status.code(), Some(2));
    assert!(
        stderr(&output).contains("checkpoint"),
        "{}",
        stderr(&output)
    );
    assert!(
        dir.path().exists(),
        "the folder to resume must not be removed"
    );
}

#[test]
fn scenes_that_are_none() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("scene.ply");
    for bytes in [
        &b""[..],
        b"ply\n",
        b"solid cube\n",
        b"ply\nformat ascii 1.0\nend_header\n",
    ] {
        fs::write(&file, bytes).unwrap();
        let output = mhsplat(&["eval", text(&file), &room()]);
        assert_eq!(output.status.code(), Some(2));
        assert!(stderr(&output).contains("scene.ply"));
    }
    let output = mhsplat(&["eval", text(&dir.path().join("no.ply")), &room()]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("no.ply"));
}
