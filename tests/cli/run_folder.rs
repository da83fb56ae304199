//! What train leaves behind, and what eval and render make of it.

use std::fs;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

use serde_json::Value;

use super::{done, mhsplat, program, room, stderr, text};
use mhsplat::lab::synth::SynthLayout;
use mhsplat::run::{DensityRow, read_rows};

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap()
}

fn train(run: &Path, more: &[&str]) -> Value {
    let room = room();
    let mut args = vec!["train", room.as_str(), "-o", text(run), "--json"];
    args.extend(["--max-size", "64", "--iterations", "80"]);
    args.extend(more);
    json(&done(&args))
}

#[test]
fn the_run_folder_keeps_the_contract() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    let printed = train(&run, &["--seed", "3"]);
    assert_eq!(
        printed,
        json(&fs::read_to_string(run.join("run.json")).unwrap())
    );
    let checkout = Path::new(env!("CARGO_MANIFEST_DIR")).join(".git").exists();
    assert!(!checkout || printed["commit"] != "unknown");
    for key in "version commit config seed dataset device plan iterations gaussians train_seconds wall_seconds cpu_seconds \
                peak_rss_bytes photos stages density final"
        .split_whitespace()
    {
        assert!(!printed[key].is_null(), "run.json lacks {key}");
    }
    assert_eq!(printed["seed"], 3);
    described(&run, &printed);
    assert_eq!(printed["iterations"], 80);
    assert_eq!(printed["dataset"]["train_views"], 35);
    assert_eq!(printed["dataset"]["test_views"], 5);
    assert_eq!(printed["dataset"]["width"], 64);
    let views = printed["final"]["per_view"].as_array().unwrap();
    assert_eq!(views.len(), 5);
    assert!(views.iter().all(|v| v["flip"].as_f64() > Some(0.0)));
    assert!(!printed["plan"]["left_out"].as_array().unwrap().is_empty());
    assert!(printed["density"]["proposed"].as_u64() > Some(0));
    let table = fs::read_to_string(run.join("metrics.csv")).unwrap();
    let mut lines = table.lines();
    assert_eq!(
        lines.next(),
        Some(
            "iteration,train_seconds,wall_seconds,cpu_seconds,loss,psnr,ssim,gaussians,proposed,accepted,relocated,pruned,non_finite"
        )
    );
    let last = lines.next_back().unwrap();
    assert!(last.starts_with("80,") && last.ends_with(",0"), "{last}");
    let report = fs::read_to_string(run.join("report.html")).unwrap();
    assert!(report.contains("<svg") && report.contains("data:image/png"));
    // Photo, render and error of three training views.
    let (_, training) = report.split_once("<h2>Training views</h2>").unwrap();
    assert_eq!(training.matches("data:image/jpeg").count(), 9);
    assert!(report.len() < 2 << 20, "{} bytes", report.len());
    assert!(run.join("checkpoint").is_dir());
    shows_the_scene(&run, &printed, &report);

    evaluated_alike(&run, &printed);
    rendered(&run, dir.path());
    nonsense_is_refused(&run, dir.path());
}

/// `scene.html` has the run's Gaussians, cameras, scores and photos, and the report leads to it.
fn shows_the_scene(run: &Path, printed: &Value, report: &str) {
    let page = fs::read_to_string(run.join("scene.html")).unwrap();
    let inside = crate::viewer::pages::meta(&page);
    assert_eq!(inside["packed"]["count"], printed["gaussians"]);
    let cameras = inside["cameras"].as_array().unwrap();
    assert_eq!((cameras.len(), &inside["start"]), (40, &Value::from(5)));
    let views = printed["final"]["per_view"].as_array().unwrap();
    for (camera, view) in cameras.iter().zip(views) {
        assert_eq!(camera["name"], view["view"]);
        assert_eq!(camera["psnr"], view["psnr"]);
        assert!(camera["photo"].as_str().unwrap().len() > 500);
    }
    assert_eq!(cameras[5]["held_out"], false);
    assert!(printed["remarks"].is_null());
    assert!(report.contains("<a href=\"scene.html\">"));
}

/// `info` of the dataset, the run and its scene agree with the record.
fn described(run: &Path, record: &Value) {
    let info = |path: &Path| json(&done(&["info", text(path), "--json"]));
    let of_run = info(run);
    for key in ["gaussians", "iterations", "commit", "plan", "dataset"] {
        assert_eq!(of_run[key], record[key], "{key}");
    }
    let scene = info(&run.join("scene.ply"));
    assert_eq!(scene["gaussians"], record["gaussians"]);
    assert_eq!(scene["sh_degree"], 3);
    let opacity = scene["quantiles"]["opacity"].as_array().unwrap();
    let opacity: Vec<f64> = opacity.iter().map(|v| v.as_f64().unwrap()).collect();
    assert!(opacity.is_sorted() && opacity[0] >= 0.0 && opacity[4] <= 1.0);
    let room = room();
    let data = info(Path::new(&room));
    assert_eq!(data["training_views"], record["dataset"]["train_views"]);
    assert_eq!(data["layout"], record["dataset"]["layout"]);
    assert_eq!(data["lenses"]["no distortion"], 40);
    let stops = data["brightness_stops"].as_f64().unwrap();
    assert!((0.0..3.0).contains(&stops), "{stops}");
    let dir = tempfile::tempdir().unwrap();
    let temporary = dir.path().join("temporary");
    fs::create_dir(&temporary).unwrap();
    let timed = super::program()
        .args(["info", &room, "--max-size", "64", "--time", "--json"])
        .env("TMPDIR", &temporary)
        .output()
        .unwrap();
    assert!(timed.status.success(), "{}", stderr(&timed));
    let expected = &json(&super::stdout(&timed))["expected_seconds"];
    assert!(expected.as_f64() > Some(0.5), "{expected}");
    let left = fs::read_dir(&temporary).unwrap();
    assert_eq!(left.count(), 0, "the run is removed");
    let words = done(&["info", &room, "--max-size", "64"]);
    assert!(
        words.contains("40 of 64x48") && words.contains("because"),
        "{words}"
    );
    let nowhere = mhsplat(&["info", "nowhere"]);
    assert_eq!(nowhere.status.code(), Some(2));
}

fn nonsense_is_refused(run: &Path, dir: &Path) {
    let room = room();
    let refused = |args: &[&str], word: &str| {
        let output = mhsplat(args);
        assert_eq!(output.status.code(), Some(2), "{args:?}");
        assert!(stderr(&output).contains(word), "{}", stderr(&output));
    };
    let nowhere = dir.join("nowhere");
    for (flag, value) in [("--width", "0"), ("--height", "70000"), ("--orbit", "0")] {
        let mut args = vec!["render", text(run), "-o", text(&nowhere), flag, value];
        if flag != "--orbit" {
            args.extend(["--orbit", "1"]);
        }
        refused(&args, value);
        assert!(!nowhere.exists());
    }
    refused(&["eval", text(run), &room, "--require-psnr", "nan"], "nan");
    refused(&["eval", text(run), &room, "--near", "0"], "above 0");
    let before = fs::read(run.join("scene.ply")).unwrap();
    let other = super::scratch_dataset(dir, SynthLayout::Colmap);
    refused(&["train", text(&other), "--resume", text(run)], "not those");
    // Scores of another dataset's photos would be low without a word.
    let of_other = ["eval", text(run), text(&other)];
    refused(&of_other, "not the dataset that the run was trained on");
    refused(
        &[&of_other[..], &["--test-every", "2"]].concat(),
        "not the dataset",
    );
    let target = dir.join("of-other");
    let render = [
        "render",
        text(run),
        "--dataset",
        text(&other),
        "-o",
        text(&target),
    ];
    refused(&render, "not the dataset");
    done(&[&of_other[..], &["--allow-different"]].concat());
    assert_eq!(fs::read(run.join("scene.ply")).unwrap(), before);
    fs::write(run.join("run.json"), "{").unwrap();
    refused(&["eval", text(run), &room], "run.json");
}

#[test]
fn no_more_gaussians_than_allowed() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    let record = train(&run, &["--max-gaussians", "500"]);
    let count = |name: &str| record[name].as_u64().unwrap_or(0);
    let left = count("gaussians") + count("removed");
    assert!(left > 250 && left <= 500, "{left}");
    let ply = run.join("scene.ply");
    let (room, other) = (room(), dir.path().join("b"));
    let args = [
        "train",
        &room,
        "-o",
        text(&other),
        "--init",
        text(&ply),
        "--max-gaussians",
        "100",
    ];
    let output = mhsplat(&args);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("--max-gaussians"));
}

/// One command line serves a job whenever it is queued.
#[test]
fn a_job_that_is_queued_again_goes_on() {
    let dir = tempfile::tempdir().unwrap();
    let (room, run) = (room(), dir.path().join("run"));
    let job = ["train", &room, "-o", text(&run), "--resume-or-start"];
    let size = ["--max-size", "64"];
    let args = [&job[..], &size, &["--iterations", "60"]].concat();
    done(&args);
    let scene = fs::read(run.join("scene.ply")).unwrap();
    // The run has come to its end; what it may change on the way may be another.
    done(&[&args[..], &["--checkpoint-every", "7", "--eval-every", "9"]].concat());
    assert_eq!(fs::read(run.join("scene.ply")).unwrap(), scene);
    for (other, key) in [
        (["--iterations", "61"], "iterations"),
        (["--seed", "1"], "seed"),
    ] {
        let mut args = [&job[..], &size, &other].concat();
        if key != "iterations" {
            args.extend(["--iterations", "60"]);
        }
        let output = mhsplat(&args);
        assert_eq!(output.status.code(), Some(2));
        assert!(
            stderr(&output).contains(&format!("another `{key}`")),
            "{}",
            stderr(&output)
        );
    }
    assert_eq!(fs::read(run.join("scene.ply")).unwrap(), scene);
}

#[test]
fn progress_is_told_in_the_form_that_is_asked_for() {
    let dir = tempfile::tempdir().unwrap();
    let said = |name: &str, more: &[&str]| {
        let (room, run) = (room(), dir.path().join(name));
        let args = ["train", &room, "-o", text(&run), "--max-size", "64"];
        let output = mhsplat(&[&args[..], &["--iterations", "40"], more].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        assert!(super::stdout(&output).contains("scene.ply"));
        stderr(&output)
    };
    let log = said("log", &["--eval-every", "2"]);
    let lines = log.lines().filter(|l| l.contains("/40, ")).count();
    assert!(lines >= 18, "{log}");
    assert!(
        log.contains("left out: ") && !log.contains("because"),
        "{log}"
    );
    let reasons = said("reasons", &["-v"]);
    assert!(
        reasons.contains("left out: masks, because there is no mask"),
        "{reasons}"
    );
    let objects = said("json", &["--progress", "json", "--eval-every", "2"]);
    let rows: Vec<Value> = objects
        .lines()
        .filter(|l| l.starts_with('{'))
        .map(json)
        .collect();
    assert!(rows.len() >= 18, "{objects}");
    let last = rows.last().unwrap();
    assert!(last["psnr"].as_f64() > Some(5.0) && last["iterations"] == 40);
    assert!(last["loss"].as_f64() > Some(0.0), "{last}");
    assert_eq!(said("quiet", &["-q"]), "");
}

/// Births wait until what points show is in place; of a random start nothing is.
#[test]
fn a_random_start_has_births_at_once() {
    let dir = tempfile::tempdir().unwrap();
    let steps = |start: &str| {
        let (room, run) = (room(), dir.path().join(start));
        let args = ["train", &room, "-o", text(&run), "--init", start];
        done(&[&args[..], &["--max-size", "64", "--iterations", "450"]].concat());
        let rows = read_rows::<DensityRow>(run.join("density.csv")).unwrap();
        rows.iter()
            .map(|row| row.stats.proposed > 0)
            .collect::<Vec<_>>()
    };
    let (placed, random) = (steps("points"), steps("random"));
    assert_eq!(placed.len(), random.len());
    assert!(!placed[0] && random[0], "{placed:?} {random:?}");
    assert!(placed[2] && random[2], "{placed:?} {random:?}");
}

fn evaluated_alike(run: &Path, record: &Value) {
    let scores = json(&done(&["eval", text(run), &room(), "--json"]));
    for key in ["psnr", "ssim", "flip"] {
        let (a, b) = (&scores[key], &record["final"][key]);
        let difference = (a.as_f64().unwrap() - b.as_f64().unwrap()).abs();
        // The scene went through the dataset's frame and back: f32 rounding of positions and scales.
        assert!(difference < 1e-3, "{key}: {a} against {b}");
    }
    let psnr = |more: &[&str]| {
        let room = room();
        let args = [&["eval", text(run), &room, "--json"], more].concat();
        json(&done(&args))["psnr"].as_f64().unwrap()
    };
    // Viewers with other near planes show the same, on the training views, too; one beyond the scene shows nothing.
    for views in [&[][..], &["--training-views"]] {
        let own = psnr(views);
        for near in ["0.01", "0.2"] {
            let other = psnr(&[views, &["--near", near]].concat());
            assert!(
                (own - other).abs() < 0.05,
                "{views:?} {near}: {own} {other}"
            );
        }
    }
    assert!(psnr(&["--training-views"]) != psnr(&[]));
    // The run knows its dataset, and another split of it is the same.
    let known = json(&done(&["eval", text(run), "--json"]));
    assert_eq!(known["per_view"], scores["per_view"]);
    done(&[
        "eval",
        text(run),
        &room(),
        "--test-every",
        "4",
        "--max-size",
        "32",
    ]);
    assert!(psnr(&["--near", "1000", "--background", "black"]) < 12.0);
    let missed = mhsplat(&["eval", text(run), &room(), "--require-psnr", "99"]);
    assert_eq!(missed.status.code(), Some(1));
    let met = mhsplat(&["eval", text(run), &room(), "--require-psnr", "1"]);
    assert_eq!(met.status.code(), Some(0));
}

fn rendered(run: &Path, dir: &Path) {
    for what in ["color", "depth", "alpha", "error"] {
        let folder = dir.join(what);
        let room = room();
        let args = [
            "render",
            text(run),
            "--dataset",
            &room,
            "-o",
            text(&folder),
            "--what",
            what,
            "--json",
        ];
        let listed = json(&done(&args));
        let images = listed["images"].as_array().unwrap();
        assert_eq!(images.len(), 5);
        let picture = image::open(images[0].as_str().unwrap()).unwrap().to_rgb8();
        assert_eq!(picture.dimensions(), (64, 48));
        let first = picture.get_pixel(0, 0);
        assert!(
            picture.pixels().any(|p| p != first),
            "{what} is one flat colour"
        );
        assert_eq!(
            mhsplat(&args).status.code(),
            Some(2),
            "an existing folder must be refused"
        );
    }
    let ply = run.join("scene.ply");
    let orbit = dir.join("orbit");
    let args = [
        "render",
        text(&ply),
        "--orbit",
        "2",
        "-o",
        text(&orbit),
        "--width",
        "40",
        "--height",
        "30",
    ];
    done(&args);
    assert_eq!(fs::read_dir(&orbit).unwrap().count(), 2);
}

#[test]
fn same_seed_same_scene_file() {
    let dir = tempfile::tempdir().unwrap();
    let scene = |name: &str, seed: &str| {
        let run = dir.path().join(name);
        train(&run, &["--seed", seed]);
        fs::read(run.join("scene.ply")).unwrap()
    };
    let first = scene("a", "1");
    assert!(first == scene("b", "1"), "two runs at one seed differ");
    assert!(first != scene("c", "2"), "the seed has no effect");
}

#[test]
fn a_small_image_budget_ends_with_the_same_scene_and_says_so() {
    let dir = tempfile::tempdir().unwrap();
    let (whole, part) = (dir.path().join("whole"), dir.path().join("part"));
    let all = train(&whole, &[]);
    let some = train(&part, &["--image-budget", "30K"]);
    let scene = |run: &Path| fs::read(run.join("scene.ply")).unwrap();
    assert!(scene(&whole) == scene(&part));
    assert_eq!(all["final"], some["final"]);
    let ahead = |record: &Value, list: &str| {
        let items = record["plan"][list].as_array().unwrap().clone();
        let found = items.into_iter().find(|i| i["what"] == "photo prefetch");
        found.map(|i| i["why"].as_str().unwrap().to_owned())
    };
    assert!(ahead(&all, "left_out").unwrap().contains("fit in memory"));
    assert!(ahead(&some, "kept").is_some());
    assert_eq!(all["photos"]["decoded"], 0);
    assert_eq!(some["config"]["image-budget"], 30 * 1024);
    assert!(some["photos"]["decoded"].as_u64() >= Some(80));
    assert!(some["photos"]["peak_bytes"].as_u64() <= Some(30 * 1024));
    assert_eq!(some["photos"]["total_bytes"], 40 * 64 * 48 * 3);
}

#[test]
fn a_recorded_configuration_trains_the_same_scene_again() {
    let dir = tempfile::tempdir().unwrap();
    let (a, b) = (dir.path().join("a"), dir.path().join("b"));
    train(&a, &["--seed", "4", "--sh-degree", "1"]);
    let config = a.join("run.json");
    let room = room();
    done(&["train", &room, "-o", text(&b), "--config", text(&config)]);
    let scene = |run: &Path| fs::read(run.join("scene.ply")).unwrap();
    assert!(scene(&a) == scene(&b));
}

#[test]
fn ctrl_c_leaves_a_checkpoint_that_resumes_to_the_same_scene() {
    let dir = tempfile::tempdir().unwrap();
    let (whole, cut) = (dir.path().join("whole"), dir.path().join("cut"));
    let room = room();
    let common = [
        "--max-size",
        "64",
        "--iterations",
        "1500",
        "--checkpoint-every",
        "0",
    ];
    let with = |run: &Path| {
        let mut command = program();
        command
            .args(["train", &room, "-o", text(run)])
            .args(common)
            .stderr(Stdio::null());
        command
    };
    let mut child = with(&cut).spawn().unwrap();
    // Once the first evaluation has been written, it is training.
    let metrics = cut.join("metrics.csv");
    let started = Instant::now();
    while fs::read_to_string(&metrics).map_or(0, |t| t.lines().count()) < 2 {
        assert!(started.elapsed() < Duration::from_secs(120));
        assert!(child.try_wait().unwrap().is_none(), "ended too early");
        std::thread::sleep(Duration::from_millis(20));
    }
    // The end of an ssh session, unless these tests run under nohup, which the child inherits. What it catches says nothing:
    // compilers of drivers catch signals, too.
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|l| l.strip_prefix("SigIgn:"));
    let ignored = ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    let signal = match ignored {
        Some(mask) if mask & 1 == 0 => "-HUP",
        _ => "-INT",
    };
    // A shell sends one and the kernel another; `timeout` signals a process and then its group.
    let id = child.id();
    let all = format!("kill {signal} {id}; kill {signal} {id}; kill -TERM {id}");
    let killed = std::process::Command::new("sh").args(["-c", &all]).status();
    assert!(killed.unwrap().success());
    assert_eq!(child.wait().unwrap().code(), Some(130));
    for file in ["scene.html", "report.html"] {
        assert!(cut.join(file).is_file(), "{file}");
    }
    let record = json(&fs::read_to_string(cut.join("run.json")).unwrap());
    assert!(record["iterations"].as_u64() < Some(1500));
    done(&["train", &room, "--resume", text(&cut)]);
    let status = with(&whole).stdout(Stdio::null()).status().unwrap();
    assert!(status.success());
    let scene = |run: &Path| fs::read(run.join("scene.ply")).unwrap();
    assert!(scene(&whole) == scene(&cut));
    let resumed = fs::read_to_string(cut.join("metrics.csv")).unwrap();
    let straight = fs::read_to_string(whole.join("metrics.csv")).unwrap();
    // Iteration, and everything behind the clocks: loss, PSNR, SSIM, Gaussians, density control.
    let without_clocks = |t: &str| -> Vec<Vec<String>> {
        t.lines()
            .map(|l| {
                let fields = l.split(',').enumerate();
                fields
                    .filter(|(i, _)| !(1..4).contains(i))
                    .map(|(_, f)| f.to_owned())
                    .collect()
            })
            .collect()
    };
    assert_eq!(without_clocks(&resumed), without_clocks(&straight));
}

#[test]
fn a_missed_bar_is_1_and_a_time_budget_ends_the_run() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    let room = room();
    let args = [
        "train",
        &room,
        "-o",
        text(&run),
        "--max-size",
        "64",
        "--time-budget",
        "2s",
        "--require-psnr",
        "99",
        "--json",
    ];
    let output = mhsplat(&args);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    let record = json(&super::stdout(&output));
    assert!(record["iterations"].as_u64() < Some(30_000));
    assert!(run.join("scene.ply").exists());
}

/// A device that has passed no self-test passes one beside a budget too short for it, which is told.
#[test]
fn a_short_budget_has_the_test_of_the_device_beside_it() {
    let dir = tempfile::tempdir().unwrap();
    let room = room();
    let kernels = std::env::var_os("POCL_CACHE_DIR")
        .unwrap_or_else(|| concat!(env!("CARGO_TARGET_TMPDIR"), "/pocl/kcache").into());
    let beside = |budget: &str| {
        let at = |name: &str| dir.path().join(format!("{name}-{budget}"));
        let run = at("run");
        let mut command = super::program();
        command.env("XDG_CACHE_HOME", at("cache"));
        command.env("POCL_CACHE_DIR", &kernels);
        command.args(["train", &room, "-o", text(&run), "--max-size", "48"]);
        command.args(["--iterations", "20", "--budget-cpu", budget]);
        let output = command.output().unwrap();
        let said = stderr(&output);
        assert!(output.status.success(), "{said}");
        said.contains("CPU s beyond the budget")
    };
    assert!(beside("1s"));
    assert!(!beside("1h"));
}

/// UTM coordinates: the scores of a run are of a scene that its file cannot hold.
#[test]
fn what_lies_far_from_the_origin_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let utm = glam::DVec3::new(458_000.0, 5_428_000.0, 110.0);
    for (middle, told) in [(glam::DVec3::ZERO, false), (utm, true)] {
        let data = crate::dataset::colmap_scene(9, middle, true);
        let run = dir.path().join(told.to_string());
        let args = [
            "train",
            text(data.path()),
            "-o",
            text(&run),
            "--iterations",
            "20",
        ];
        let output = mhsplat(&args);
        let said = stderr(&output);
        assert!(output.status.success(), "{said}");
        assert_eq!(
            said.matches("positions are rounded").count(),
            usize::from(told),
            "{said}"
        );
    }
}
