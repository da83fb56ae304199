//! `split` and `merge`: parts that are datasets of their own, and one scene of what is trained on them.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use glam::DVec3;
use serde_json::{Value, json};

use crate::cli::{done, mhsplat, room, scratch_dataset, stderr, text};
use crate::dataset::masks::{painted, small};
use crate::dataset::{assert_refused, load_every};
use mhsplat::base::error::Error;
use mhsplat::capture::split::{Cells, SplitOptions, split};
use mhsplat::capture::{Alpha, Dataset, Frame, Lens, View};
use mhsplat::lab::synth::SynthLayout;
use mhsplat::scene::formats::{self, SceneFile, Sphere};
use mhsplat::scene::{Gaussians, Plane};

fn options(cells: usize) -> SplitOptions {
    SplitOptions {
        cells,
        overlap: 0.2,
        visibility: 0.25,
        test_every: 8,
        images: None,
    }
}

/// The dataset in cells, and the parts as they are read, with a split of their own asked for.
fn parts(dataset: &Path, out: &Path, options: &SplitOptions) -> (Cells, Vec<Dataset>) {
    let cells = split(dataset, out, options).unwrap();
    let part = |i| load_every(&Cells::part(out, i), 2).unwrap();
    let read = (0..cells.cells.len()).map(part).collect();
    (cells, read)
}

/// Names of views, without the folder of a part's links.
fn names(views: &[View]) -> BTreeSet<String> {
    let own = |v: &View| v.name.trim_start_matches("images/").to_owned();
    views.iter().map(own).collect()
}

/// Points in the dataset's coordinates, rounded to what single precision holds of the whole.
fn rounded(data: &Dataset) -> BTreeSet<[i64; 3]> {
    let place = |p: &[f32; 3]| {
        let p = data.frame.to_dataset(DVec3::from_array(p.map(f64::from)));
        p.to_array().map(|v| (v * 1e4).round() as i64)
    };
    data.points.positions.iter().map(place).collect()
}

#[test]
fn parts_keep_coordinates_photos_and_held_out_views() {
    let dir = tempfile::tempdir().unwrap();
    let transforms = scratch_dataset(dir.path(), SynthLayout::Transforms);
    for (name, dataset, n) in [
        ("two", PathBuf::from(room()), 2),
        ("five", PathBuf::from(room()), 5),
        ("transforms", transforms, 3),
    ] {
        let whole = load_every(&dataset, 8).unwrap();
        let (cells, read) = parts(&dataset, &dir.path().join(name), &options(n));
        assert_eq!(cells, Cells::read(&dir.path().join(name)).unwrap());
        let (mut trained, mut tested) = (BTreeSet::new(), BTreeSet::new());
        for (i, part) in read.iter().enumerate() {
            let cell = &cells.cells[i];
            assert!(part.missing.is_empty() && part.outliers.is_empty());
            assert_eq!(
                (part.train.len(), part.test.len()),
                (cell.train, cell.held_out)
            );
            trained.extend(names(&part.train));
            tested.extend(names(&part.test));
            for view in part.views() {
                let same = |v: &&View| view.name.ends_with(&v.name);
                let of = whole.views().find(same).unwrap();
                let center = |data: &Dataset, v: &View| data.frame.to_dataset(v.camera.center());
                let moved = center(part, view).distance(center(&whole, of));
                assert!(moved < 1e-9, "{}: {moved}", view.name);
                let [ours, theirs] = [view, of].map(|v| v.photo.load().unwrap());
                assert_eq!(ours.data, theirs.data, "{}", view.name);
            }
            let (all, some) = (rounded(&whole).len(), rounded(part));
            let near = |p: &[i64; 3]| {
                let beside = |q: &[i64; 3]| (0..3).all(|k| p[k].abs_diff(q[k]) <= 1);
                rounded(&whole).iter().any(beside)
            };
            assert!(cell.points <= whole.points.positions.len() && some.len() <= all);
            assert!(some.iter().take(20).all(near), "{name}: cell {i}");
        }
        assert_eq!(trained, names(&whole.train), "{name}");
        assert_eq!(tested, names(&whole.test), "{name}");
        let count = |of: fn(&mhsplat::capture::split::Cell) -> usize| -> usize {
            cells.cells.iter().map(of).sum()
        };
        assert_eq!(count(|c| c.own), whole.views().count());
        assert_eq!(count(|c| c.own_points), whole.points.positions.len());
        // Cells share the photos of their margins, and those that see across.
        assert!(count(|c| c.train) > whole.train.len(), "{name}");
    }
}

#[test]
fn without_margins_and_views_across_every_photo_is_in_one_part() {
    let dir = tempfile::tempdir().unwrap();
    let apart = SplitOptions {
        overlap: 0.0,
        visibility: 1.0,
        test_every: 0,
        ..options(3)
    };
    let whole = load_every(Path::new(&room()), 0).unwrap();
    let (_, read) = parts(Path::new(&room()), &dir.path().join("parts"), &apart);
    let train: Vec<String> = read.iter().flat_map(|p| names(&p.train)).collect();
    assert_eq!(train.len(), whole.train.len());
    let sizes: Vec<usize> = read.iter().map(|p| p.train.len()).collect();
    assert!(
        sizes.iter().max().unwrap() - sizes.iter().min().unwrap() <= 1,
        "{sizes:?}"
    );
    // No view is held out in the whole, so none is in a part, whatever it is asked for.
    assert!(read.iter().all(|p| p.test.is_empty()));
}

/// Outliers are judged in the whole: a few distant cameras that show a compact cell are no wrong poses of its part.
#[test]
fn a_part_keeps_the_cameras_chosen_for_it() {
    let dir = tempfile::tempdir().unwrap();
    let (cells, _) = parts(Path::new(&room()), dir.path(), &options(1));
    let part = Cells::part(dir.path(), 0);
    let file = part.join("transforms_train.json");
    let mut json: Value = serde_json::from_slice(&fs::read(&file).unwrap()).unwrap();
    json["frames"][0]["transform_matrix"][0][3] = json!(1e4);
    fs::write(&file, json.to_string()).unwrap();
    let read = load_every(&part, 8).unwrap();
    assert_eq!(read.train.len(), cells.cells[0].train);
    assert!(read.outliers.is_empty());
    json.as_object_mut().unwrap().remove("part");
    fs::write(&file, json.to_string()).unwrap();
    assert_eq!(load_every(&part, 8).unwrap().outliers.len(), 1);
}

#[test]
fn lenses_and_masks_go_with_their_photos() {
    let dir = tempfile::tempdir().unwrap();
    let masked = painted(&dir.path().join("masked"), [255; 3], true);
    split(&masked, &dir.path().join("parts"), &options(2)).unwrap();
    let (whole, part) = (
        small(&masked),
        small(&Cells::part(&dir.path().join("parts"), 0)),
    );
    assert_eq!(part.alpha(), Alpha::Mask);
    for view in part.views() {
        let of = whole
            .views()
            .find(|v| view.name.ends_with(&v.name))
            .unwrap();
        assert_eq!(
            view.photo.load().unwrap().data,
            of.photo.load().unwrap().data
        );
    }
    for (line, told) in [
        (
            "OPENCV 16 12 21.5 20.25 8.5 5.75 0.05 0.01 0.002 0.003",
            None,
        ),
        (
            "FULL_OPENCV 16 12 21.5 20.25 8.5 5.75 0.05 0.01 0.002 0.003 0.01 0.02 0.01 0.03",
            None,
        ),
        (
            "OPENCV_FISHEYE 16 12 21.5 20.25 8.5 5.75 0.05 0.01 0.02 0.03",
            None,
        ),
        (
            "FOV 16 12 21.5 20.25 8.5 5.75 0.4",
            Some("undistort the photos"),
        ),
    ] {
        let colmap = crate::dataset::colmap_scene(9, DVec3::ZERO, false);
        let cameras = colmap.path().join("sparse/0/cameras.txt");
        fs::write(cameras, format!("1 {line}\n")).unwrap();
        let out = colmap.path().join("parts");
        let done = split(colmap.path(), &out, &options(2));
        if let Some(told) = told {
            assert_refused(done, &["(Fov", told]);
            assert!(!out.exists(), "nothing is written");
            continue;
        }
        let (whole, part) = (colmap.path(), Cells::part(&out, 1));
        let [whole, part] = [whole, &part].map(|p| load_every(p, 8).unwrap());
        for view in part.views() {
            let of = whole
                .views()
                .find(|v| view.name.ends_with(&v.name))
                .unwrap();
            assert!(view.lens == of.lens && view.lens != Lens::Pinhole, "{line}");
            assert!((view.camera.fx - of.camera.fx).abs() < 1e-9, "{line}");
        }
    }
}

#[test]
fn what_cannot_be_split_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let data = scratch_dataset(dir.path(), SynthLayout::Colmap);
    let out = dir.path().join("parts");
    // Of nine photos two are held out.
    let error = split(&data, &out, &options(8)).unwrap_err();
    assert!(
        matches!(&error, Error::Config { .. }) && !out.exists(),
        "{error}"
    );
    let said = error.to_string();
    assert!(
        said.contains("--cells: 8 cells") && said.contains("for 7 at most"),
        "{said}"
    );
    let archive = dir.path().join("dataset.zip");
    fs::write(&archive, "").unwrap();
    assert_refused(split(&archive, &out, &options(2)), &["unpack it"]);
    fs::create_dir(&out).unwrap();
    fs::write(out.join("mine"), "").unwrap();
    for (args, word) in [
        (&["--cells", "2"][..], "is not empty"),
        (&["--cells", "0"], "--cells"),
        (&["--cells", "2", "--overlap", "2"], "0 to 1"),
    ] {
        let output = mhsplat(&[&["split", text(&data), "-o", text(&out)], args].concat());
        assert_eq!(output.status.code(), Some(2));
        assert!(stderr(&output).contains(word), "{}", stderr(&output));
    }
}

/// Gaussians all over the room and around it, each with a colour of its own.
fn everywhere(degree: u32, n: usize) -> SceneFile {
    let mut splats = Gaussians::zeros(degree, n);
    for i in 0..n {
        let part = |step: f64| ((i as f64 + 0.5) * step).fract() * 14.0 - 4.0;
        let place = [0.618_034, 0.754_878, 0.569_84].map(|step| part(step) as f32);
        splats.scatter(Plane::POSITION, i, place);
        splats.scatter(Plane::LOG_SCALE, i, [-3.0; 3]);
        splats.scatter(Plane::SH, i, [i as f32, 0.0, 0.0]);
    }
    SceneFile::new(splats)
}

fn written(file: PathBuf, scene: &SceneFile) -> PathBuf {
    let format = formats::of_name(&file).unwrap();
    formats::write(&file, format, scene, &Frame::IDENTITY).unwrap();
    file
}

fn read(file: &Path) -> SceneFile {
    formats::read(file, &Frame::IDENTITY).unwrap()
}

#[test]
fn cells_of_one_scene_give_it_back_once() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("parts");
    let cells = split(Path::new(&room()), &out, &options(5)).unwrap();
    let mut scene = everywhere(1, 3000);
    // On the border of the first cell, as near as single precision comes.
    let mut edge = cells.cells[0].bounds.0.iter().enumerate();
    let (axis, edge) = edge.find_map(|(k, e)| Some((k, e[1]?))).unwrap();
    let on = cells.ground.center + edge * cells.ground.axes[axis];
    scene
        .splats
        .scatter(Plane::POSITION, 0, on.as_vec3().to_array());
    scene.anti_aliased = true;
    scene.up = Some([0.0, 0.0, 1.0]);
    // Each with cameras around another place.
    let files = [0, 1, 2, 3, 4].map(|i| {
        scene.cameras = Some(Sphere {
            center: DVec3::X * f64::from(10 * i),
            radius: 1.0 + f64::from(i),
        });
        written(dir.path().join(format!("{i}.ply")), &scene)
    });
    let file = &files[0];
    let merged = dir.path().join("merged.ply");
    let mut args = vec!["merge", text(&out), "-o", text(&merged), "--json", "--runs"];
    args.extend(files.iter().map(|file| text(file)));
    let json: Value = serde_json::from_str(&done(&args)).unwrap();
    let kept = json["cells"].as_array().unwrap().iter();
    let kept: Vec<u64> = kept.map(|c| c["kept"].as_u64().unwrap()).collect();
    assert!(
        kept.iter().all(|n| *n > 0) && kept.iter().sum::<u64>() == 3000,
        "{kept:?}"
    );
    let merged = read(&merged);
    assert!(merged.anti_aliased && merged.up == scene.up);
    let around = Sphere {
        center: DVec3::X * 20.0,
        radius: 25.0,
    };
    assert_eq!(merged.cameras, Some(around));
    let set = |scene: &SceneFile| -> BTreeSet<Vec<u32>> {
        let planes = scene.splats.planes();
        let row =
            |i: usize| -> Vec<u32> { planes.iter().map(|plane| plane[i].to_bits()).collect() };
        (0..scene.splats.len()).map(row).collect()
    };
    assert_eq!(merged.splats.len(), 3000);
    assert_eq!(set(&merged), set(&read(file)));
    // One does not tell: nothing is said of the others' part.
    scene.cameras = None;
    written(files[3].clone(), &scene);
    let silent = dir.path().join("silent.ply");
    args[3] = text(&silent);
    done(&args);
    assert_eq!(read(&silent).cameras, None);
}

/// The refusal of a merge; nothing is written.
fn not_merged(parts: &Path, runs: &[&Path], words: &[&str]) {
    let out = parts.join("scene.ply");
    let mut args = vec!["merge", text(parts), "-o", text(&out)];
    if !runs.is_empty() {
        args.push("--runs");
        args.extend(runs.iter().map(|run| text(run)));
    }
    let output = mhsplat(&args);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{said}");
    for word in words {
        assert!(said.contains(word), "{word:?} is not in: {said}");
    }
    assert!(!out.exists());
}

#[test]
fn scenes_of_other_cells_are_not_merged() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("parts");
    let cells = split(Path::new(&room()), &out, &options(2)).unwrap();
    let other = |i: usize| {
        let scene = everywhere(0, 300);
        let splats = scene.splats.centered(|p| cells.owns(i, p));
        written(dir.path().join(format!("{i}.ply")), &SceneFile::new(splats))
    };
    let runs = [1, 0].map(other);
    let words = [
        "none of the runs has a Gaussian in its cell",
        "in the order",
    ];
    not_merged(&out, &runs.each_ref().map(PathBuf::as_path), &words);
}

/// A copy of a run's scene and record, the record changed.
fn changed(run: &Path, to: &Path, change: impl FnOnce(&mut Value)) -> PathBuf {
    fs::create_dir(to).unwrap();
    fs::copy(run.join("scene.ply"), to.join("scene.ply")).unwrap();
    let record = fs::read(run.join("run.json")).unwrap();
    let mut record = serde_json::from_slice(&record).unwrap();
    change(&mut record);
    fs::write(to.join("run.json"), record.to_string()).unwrap();
    to.to_path_buf()
}

#[test]
fn a_dataset_is_split_trained_and_merged() {
    let dir = tempfile::tempdir().unwrap();
    let data = scratch_dataset(dir.path(), SynthLayout::Colmap);
    let out = dir.path().join("parts");
    let apart = ["--overlap", "0", "--visibility", "1"];
    let args = ["split", text(&data), "--cells", "2", "-o", text(&out)];
    let said = done(&[&args[..], &apart].concat());
    assert!(
        said.contains("cell-1") && said.contains("mhsplat merge"),
        "{said}"
    );
    not_merged(
        &out,
        &[],
        &["run-0: no such run; cell 0", "mhsplat train", "cell-0"],
    );
    for i in 0..2 {
        let (part, run) = (Cells::part(&out, i), out.join(format!("run-{i}")));
        let args = ["train", text(&part), "-o", text(&run), "--iterations", "30"];
        done(&[&args[..], &["--sh-degree", "1", "-q"]].concat());
    }
    let merged = dir.path().join("merged.spz");
    let said = done(&["merge", text(&out), "-o", text(&merged)]);
    assert!(
        said.contains("cell 0: ") && said.contains("Gaussians of 2 cells"),
        "{said}"
    );
    // One scene, in the coordinates of the whole, scored on the views that were held out of all.
    let scores = done(&["eval", text(&merged), text(&data), "--json"]);
    let scores: Value = serde_json::from_str(&scores).unwrap();
    assert_eq!(scores["per_view"].as_array().unwrap().len(), 2);
    assert!(scores["psnr"].as_f64().unwrap() > 8.0, "{scores}");
    let again = mhsplat(&["merge", text(&out), "-o", text(&merged)]);
    assert_eq!(again.status.code(), Some(2));
    assert!(stderr(&again).contains("nothing is overwritten"));

    let [first, second] = [0, 1].map(|i| out.join(format!("run-{i}")));
    not_merged(
        &out,
        &[&second, &first],
        &["run-1: trained on", "in the order of the cells"],
    );
    not_merged(&out, &[&first], &["--runs: 1 given", "2 cells"]);
    not_merged(&data, &[], &["holds no cells.json", "mhsplat split"]);
    let exposed = changed(&second, &dir.path().join("exposed"), |record| {
        let kept = record["plan"]["kept"].as_array_mut().unwrap();
        let name = mhsplat::train::reasons::Part::Exposure.to_string();
        kept.push(json!({ "what": name, "why": "asked for" }));
    });
    not_merged(
        &out,
        &[&first, &exposed],
        &["exposed: trained with exposure", "--exposure on"],
    );
    let mut scene = read(&second.join("scene.ply"));
    scene.anti_aliased = true;
    let filtered = written(dir.path().join("filtered.ply"), &scene);
    not_merged(
        &out,
        &[&first, &filtered],
        &["trained with anti-aliasing", "--anti-aliasing on"],
    );
    let flat = written(dir.path().join("flat.ply"), &everywhere(0, 9));
    not_merged(
        &out,
        &[&first, &flat],
        &["SH degree 0", "run-0 has 1", "--sh-degree"],
    );
    let early = changed(&second, &dir.path().join("early"), |record| {
        record["iterations"] = json!(7);
    });
    let merged = dir.path().join("early.ply");
    let args = ["merge", text(&out), "-o", text(&merged), "--runs"];
    let output = mhsplat(&[&args[..], &[text(&first), text(&early)]].concat());
    assert!(
        stderr(&output).contains("not at its end, after 7 of 30"),
        "{}",
        stderr(&output)
    );
    assert_eq!(output.status.code(), Some(0));
}
