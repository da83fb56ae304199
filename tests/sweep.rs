//! Points that are found in the photos, where a dataset has none.

use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::cli::{program, stderr, text};
use crate::determinism::room;
use crate::learning::psnr;
use mhsplat::capture::{Dataset, LoadOptions, Photo, Points, load};
use mhsplat::config::{Init, TrainConfig};
use mhsplat::device::Device;
use mhsplat::lab::synth::{SynthOptions, generate};
use mhsplat::run::{Clock, Item, Progress, Run, RunRecord, checkpoint, with_points};
use mhsplat::scene::sweep;

/// The bundled room, whose sparse points lie on its surfaces, and the same without them.
fn rooms() -> (Points, Dataset) {
    let mut data = room(160);
    let points = std::mem::take(&mut data.points);
    (points, data)
}

/// Number of the sparse point that is nearest to a place, and its distance, local units.
fn nearest(points: &Points, place: &[f32; 3]) -> (usize, f32) {
    let squared = |p: &[f32; 3]| -> f32 { (0..3).map(|k| (p[k] - place[k]).powi(2)).sum() };
    let all = points.positions.iter().map(squared).enumerate();
    let (at, squared) = all.min_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
    (at, squared.sqrt())
}

/// Share of some places that lie no further than so from a sparse point.
fn near(points: &Points, places: &[[f32; 3]], distance: f32) -> f64 {
    let close = |place: &&[f32; 3]| nearest(points, place).1 < distance;
    places.iter().filter(close).count() as f64 / places.len() as f64
}

/// Points on all surfaces of a rendered scene, and the scene without them.
fn rendered(name: &str, [width, height]: [u32; 2]) -> (Points, Dataset) {
    let dir = tempfile::tempdir().unwrap();
    let options = SynthOptions {
        views: 32,
        width,
        height,
        samples: 4,
        points: 20_000,
        ..SynthOptions::for_scene(name)
    };
    generate(name, dir.path(), &options).unwrap();
    let mut data = load(dir.path(), &LoadOptions::default()).unwrap();
    let photos = data.train.iter_mut();
    photos.for_each(|view| view.photo = Photo::clone(&view.photo.load().unwrap()).into());
    (std::mem::take(&mut data.points), data)
}

/// Median distances of neighbouring points are 0.013 (room) and 0.002 (object).
#[test]
fn points_lie_on_the_surfaces() {
    for (name, size, distance) in [("room", [160, 120], 0.06), ("object", [128, 128], 0.02)] {
        let (surfaces, data) = rendered(name, size);
        let found = sweep::points(&data, 2000, 0).unwrap().positions;
        assert_eq!(found.len(), 2000);
        let aside = |p: &[f32; 3]| p.map(|v| 1.15 * v + 0.05);
        let moved: Vec<[f32; 3]> = found.iter().map(aside).collect();
        let [on, off] = [&found, &moved].map(|places| near(&surfaces, places, distance));
        println!("{name}: {on:.3} on surfaces, {off:.3} if they are moved");
        assert!(on > 0.8, "{name}");
        assert!(off < 0.5 * on, "{name}");
    }
}

#[test]
fn points_have_the_colours_of_their_places() {
    let (surfaces, data) = rendered("room", [160, 120]);
    let found = sweep::points(&data, 1000, 0).unwrap();
    let difference = |shift: usize| {
        let differences = found.positions.iter().enumerate().map(|(i, p)| {
            let own = found.colors[(i + shift) % found.colors.len()];
            let other = surfaces.colors[nearest(&surfaces, p).0];
            (0..3)
                .map(|k| f64::from(own[k].abs_diff(other[k])))
                .sum::<f64>()
        });
        differences.sum::<f64>()
    };
    let [own, other] = [difference(0), difference(1)];
    println!(
        "colours are off by {:.2} of those of other points",
        own / other
    );
    assert!(own < 0.6 * other);
}

#[test]
fn points_are_the_same_for_any_number_of_threads_and_follow_the_seed() {
    let (_, data) = rooms();
    let of = |threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| sweep::points(&data, 700, seed).unwrap())
    };
    let [one, three, other] = [of(1, 0), of(3, 0), of(3, 1)];
    assert_eq!(one.positions, three.positions);
    assert_eq!(one.colors, three.colors);
    assert_eq!(other.positions.len(), 700);
    assert_ne!(one.positions, other.positions);
}

/// The photos of another camera each, or one grey.
#[test]
fn photos_that_do_not_agree_have_no_points_and_the_start_is_random() {
    let (_, mut mixed) = rooms();
    let n = mixed.train.len();
    let photos: Vec<_> = mixed.train.iter().map(|v| v.photo.clone()).collect();
    for (k, view) in mixed.train.iter_mut().enumerate() {
        view.photo = photos[(7 * k + n / 2) % n].clone();
    }
    let (_, mut grey) = rooms();
    for view in &mut grey.train {
        let photo = view.photo.load().unwrap();
        let data = vec![120; photo.data.len()];
        view.photo = Photo {
            data,
            ..(*photo).clone()
        }
        .into();
    }
    for data in [mixed, grey] {
        let filled = with_points(data, &TrainConfig::default()).unwrap();
        assert!(filled.points.positions.is_empty());
        assert_eq!(filled.swept, Some(0));
        let plan = mhsplat::Plan::new(&filled, &TrainConfig::default()).unwrap();
        let parts: Vec<String> = plan
            .parts()
            .iter()
            .map(|(_, _, why)| why.to_string())
            .collect();
        assert!(
            parts
                .iter()
                .any(|why| why.contains("agree in too few places")),
            "{parts:?}"
        );
    }
}

#[test]
fn points_that_there_are_and_starts_that_are_asked_for_stay() {
    let data = room(64);
    let before = data.points.positions.clone();
    let filled = with_points(data, &TrainConfig::default()).unwrap();
    assert_eq!(filled.points.positions, before);
    assert_eq!(filled.swept, None);
    let random = TrainConfig {
        init: Init::Random,
        ..TrainConfig::default()
    };
    let (_, data) = rooms();
    assert!(
        with_points(data, &random)
            .unwrap()
            .points
            .positions
            .is_empty()
    );
}

#[test]
fn a_short_run_is_better_than_from_random_places() {
    let (_, data) = rooms();
    let config = TrainConfig {
        iterations: 250,
        max_size: 160,
        ..TrainConfig::default()
    };
    let [_, random] = psnr(&data, &config);
    let [_, swept] = psnr(&with_points(data, &config).unwrap(), &config);
    println!("{swept:.2} dB, at random {random:.2}");
    assert!(swept > random + 1.0);
}

/// A copy of the bundled room without points.
fn pointless(dir: &Path) -> String {
    let room = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/room-tiny");
    let copy = dir.join("room");
    fs::create_dir_all(copy.join("sparse/0")).unwrap();
    fs::create_dir(copy.join("images")).unwrap();
    for folder in ["images", "sparse/0"] {
        for file in fs::read_dir(room.join(folder)).unwrap() {
            let file = file.unwrap();
            let name = file.file_name();
            match name.to_string_lossy().starts_with("points3D") {
                true if name.to_string_lossy().ends_with(".bin") => {
                    fs::write(copy.join(folder).join(name), [0; 8]).unwrap();
                }
                true => fs::write(copy.join(folder).join(name), "# none\n").unwrap(),
                false => {
                    fs::copy(file.path(), copy.join(folder).join(name)).unwrap();
                }
            }
        }
    }
    text(&copy).to_owned()
}

/// Points are not looked for again: what the plan says of them is known.
#[test]
fn a_run_that_was_stopped_goes_on_with_the_same_bits() {
    let device = Device::open(None).unwrap();
    let config = TrainConfig {
        iterations: 200,
        max_size: 64,
        ..TrainConfig::default()
    };
    let small = || {
        let mut data = room(64);
        data.points = Points::default();
        data
    };
    let dir = tempfile::tempdir().unwrap();
    let run = |name: &str, stop_at: u32| {
        let out = dir.path().join(name);
        let stop = AtomicBool::new(false);
        let stopping = |p: &Progress| stop.store(p.iteration >= stop_at, Ordering::Relaxed);
        let mut run = match out.exists() {
            false => Run::start(&out, small(), config.clone(), &device, Clock::start()),
            true => Run::resume(&out, small(), config.clone(), &device, Clock::start(), None),
        }
        .unwrap();
        let mut plan = run.record().plan.clone();
        for item in plan.kept.iter_mut().chain(&mut plan.left_out) {
            // Found again by nobody: anti-aliasing has been decided by them.
            if item.what == "anti-aliasing" {
                let again = item.why == "as in the checkpoint";
                assert!(
                    again || item.why.contains("sampling rates differ"),
                    "{}",
                    item.why
                );
                item.why.clear();
            }
        }
        let ended = run.drive(&stop, stopping).is_ok();
        assert_eq!(ended, stop_at > 200);
        (fs::read(out.join("scene.ply")).ok(), plan)
    };
    let (whole, plan) = run("whole", u32::MAX);
    let found = |item: &Item| item.why.contains("found where its photos agree");
    assert!(plan.kept.iter().any(found), "{plan:?}");
    assert_eq!(run("parts", 120).1, plan);
    let (parts, again) = run("parts", u32::MAX);
    assert_eq!(again, plan);
    assert!(whole.is_some() && parts == whole);
}

/// Runs that began before points were looked for, and were stopped, go on as they began.
#[test]
fn a_run_that_began_at_random_goes_on_so() {
    let device = Device::open(None).unwrap();
    let (_, data) = rooms();
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("run");
    let config = TrainConfig {
        iterations: 40,
        max_size: 160,
        ..TrainConfig::default()
    };
    let start = |data| Run::start(&out, data, config.clone(), &device, Clock::start());
    let mut run = start(data.clone()).unwrap();
    run.drive(&AtomicBool::new(false), |_| {}).unwrap();
    drop(run);
    let mut saved = checkpoint::read(&out).unwrap();
    assert_eq!(saved.state.swept, Some(5000));
    (saved.state.swept, saved.config.iterations) = (None, 400);
    checkpoint::write(&out, &saved).unwrap();
    // Who has looked for points again does not have them either.
    let data = with_points(data, &saved.config).unwrap();
    assert_eq!(data.point_count(), 5000);
    let run = Run::resume(&out, data, saved.config, &device, Clock::start(), None).unwrap();
    let plan = &run.record().plan;
    let random = |item: &&Item| item.why.contains("the first Gaussians are random");
    assert!(plan.kept.iter().any(|item| random(&item)), "{plan:?}");
}

#[test]
fn the_program_finds_points_and_devices_share_them() {
    let dir = tempfile::tempdir().unwrap();
    let data = pointless(dir.path());
    let run = |device: &str| {
        let out = dir.path().join(device);
        let mut command = program();
        command.args([
            "train",
            &data,
            "-o",
            text(&out),
            "-q",
            "--iterations",
            "200",
        ]);
        let output = command
            .args(["--max-size", "64", "--device", device])
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
        (
            fs::read(out.join("scene.ply")).unwrap(),
            RunRecord::read(&out).unwrap(),
        )
    };
    let (alone, record) = run("cpu");
    let mut kept = record.plan.kept.iter();
    let why = kept
        .find(|item| item.what.contains("Gaussians from points"))
        .map(|item| &item.why);
    let told = |why: &String| why.contains("5000 were found where its photos agree");
    assert!(why.is_some_and(told), "{why:?}");
    assert!(run("cpu,cpu").0 == alone);
}
