//! A run that is looked at.

use std::collections::HashSet;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use mhsplat::capture::{Camera, Dataset};
use mhsplat::config::OptimizerConfig;
use mhsplat::density::Outcome;
use mhsplat::device::Device;
use mhsplat::pipeline::forward::Rendered;
use mhsplat::run::initial_gaussians;
use mhsplat::run::live::{self, Door, Property, Server};
use mhsplat::run::{Clock, Run, checkpoint};
use mhsplat::scene::Gaussians;
use mhsplat::train::{Event, Noted, Trainer};
use mhsplat::{Plan, TrainConfig};

use super::client::Client;
use crate::determinism::room;
use mhsplat::Error;

fn begin(dir: &Path, iterations: u32) -> Run {
    let config = TrainConfig {
        iterations,
        max_size: 64,
        seed: 5,
        checkpoint_every: 0,
        ..TrainConfig::default()
    };
    let device = Device::open(None).unwrap();
    Run::start(dir, room(64), config, &device, Clock::start()).unwrap()
}

/// Opens a run to visitors.
pub fn watched(dir: &Path, iterations: u32) -> (Run, Client) {
    let mut run = begin(dir, iterations);
    let door = Door::open("--view", Some(0)).unwrap();
    let client = Client::of(&door.url());
    let server = Server::start(door, &run.page()).unwrap();
    run.watch(server).unwrap();
    (run, client)
}

#[test]
fn a_watched_run_ends_with_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let [alone, seen] = ["alone", "seen"].map(|name| dir.path().join(name));
    begin(&alone, 300)
        .drive(&AtomicBool::new(false), |_| ())
        .unwrap();
    let (mut run, client) = watched(&seen, 300);
    let over = AtomicBool::new(false);
    let frames = std::thread::scope(|scope| {
        let visitor = scope.spawn(|| {
            let (mut frames, mut since) = (0, 0);
            // Larger than any photo, and from within the scene.
            let queries = [
                "view=0&width=64&height=48",
                "view=9&width=700&height=500&mode=depth",
                "width=300&height=200&lens=200,200,150,100&rotation=1,0,0,0,1,0,0,0,1&center=0,0,0",
                "view=3&width=64&height=48&mode=error",
            ];
            client.post("/pause");
            while !over.load(Ordering::Relaxed) {
                let answer = client.get("/frame", queries[frames % queries.len()]);
                if answer.status != 200 {
                    // The run has ended meanwhile.
                    assert_eq!(answer.status, 503, "{}", answer.text());
                    break;
                }
                frames += 1;
                let status = client.get("/status", "").json();
                let at = status["iteration"].as_u64().unwrap();
                if frames % 8 == 0 || at >= 250 {
                    client.post("/continue");
                    client.post("/checkpoint");
                    std::thread::sleep(Duration::from_millis(30));
                    if at < 250 && at != since {
                        since = at;
                        client.post("/pause");
                    }
                }
            }
            frames
        });
        let driven = run.drive(&AtomicBool::new(false), |_| ()).map(|_| ());
        // Its server ends with it.
        drop(run);
        over.store(true, Ordering::Relaxed);
        driven.unwrap();
        visitor.join().unwrap()
    });
    assert!(frames > 8, "{frames} frames");
    let scene = |dir: &Path| std::fs::read(dir.join("scene.ply")).unwrap();
    assert!(scene(&alone) == scene(&seen));
    // What is rendered for others is no stage of training.
    let calls = |dir: &Path| {
        let record = mhsplat::RunRecord::read(dir).unwrap();
        let splat = record.stages.iter().find(|s| s.name == "splat").cloned();
        splat.unwrap().calls
    };
    assert_eq!(calls(&alone), calls(&seen));
}

/// Waits until something is so.
fn until(what: &str, is: impl Fn() -> bool) {
    let begun = Instant::now();
    while !is() {
        assert!(begun.elapsed() < Duration::from_secs(60), "never {what}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[test]
fn who_looks_on_can_pause_save_and_stop() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("run");
    let begun = Instant::now();
    let (mut run, client) = watched(&folder, 1_000_000);
    let stop = AtomicBool::new(false);
    // Shortest time that the run waits, and how much of it the clocks may count: looks and the checkpoint itself.
    let (rest, counted) = (Duration::from_secs(2), 0.5);
    std::thread::scope(|scope| {
        let visitor = scope.spawn(|| {
            let status = || client.get("/status", "").json();
            let at = || status()["iteration"].as_u64().unwrap();
            until("begun", || at() > 20);
            assert_eq!(client.post("/pause").status, 200);
            until("paused", || status()["state"] == "paused");
            std::thread::sleep(Duration::from_millis(150));
            let rests = at();
            // A paused run has all the time for pictures.
            let waiting = Instant::now();
            while waiting.elapsed() < rest {
                client.get("/frame", "view=0&width=64&height=48").picture();
                std::thread::sleep(Duration::from_millis(100));
            }
            assert_eq!(at(), rests);
            assert_eq!(status()["saved"], serde_json::Value::Null);
            client.post("/checkpoint");
            until("saved", || status()["saved"] == rests);
            let saved = checkpoint::read(&folder).unwrap();
            assert_eq!(u64::from(saved.state.iteration), rests);
            let most = begun.elapsed().as_secs_f64() - rest.as_secs_f64() + counted;
            assert!(saved.clock.wall_seconds < most, "{:?}", saved.clock);
            client.post("/continue");
            until("going on", || at() > rests + 20);
            until("a loss", || status()["points"]["loss"][0][1].is_number());
            let told = status();
            assert!(told["loss"].as_f64().unwrap() > 0.0 && told["gaussians"].as_u64() > Some(0));
            let since = client.get("/status", "since=99999999").json();
            assert_eq!(since["points"]["loss"], serde_json::json!([]));
            client.post("/stop");
            rests
        });
        let driven = run.drive(&stop, |_| ()).map(|_| ());
        assert!(matches!(driven, Err(Error::Interrupted)), "{driven:?}");
        let rests = visitor.join().unwrap();
        assert!(u64::from(run.saved().unwrap()) > rests);
        assert!(folder.join("scene.ply").exists());
        // The time in which it waited is not that of the run.
        let most = begun.elapsed().as_secs_f64() - rest.as_secs_f64() + counted;
        assert!(run.record().wall_seconds < most);
    });
}

/// A short training, and the Gaussians that it begins with.
fn trainer(data: &Dataset, optimizer: OptimizerConfig) -> (Trainer, Gaussians) {
    let config = TrainConfig {
        iterations: 120,
        max_size: 64,
        seed: 5,
        optimizer,
        ..TrainConfig::default()
    };
    let plan = Plan::new(data, &config).unwrap();
    let splats = initial_gaussians(data, &plan).unwrap();
    let device = Device::open(None).unwrap();
    let trainer = Trainer::new(&device, data, &plan, &splats).unwrap();
    (trainer, splats)
}

/// The run's Gaussians in colours that show a property, through a camera.
fn painted(trainer: &mut Trainer, camera: &Camera, property: Property) -> Option<Rendered> {
    let colors = live::colors(trainer, property).unwrap()?;
    Some(
        trainer
            .glimpse_colored(camera, &colors, usize::MAX / 4)
            .unwrap(),
    )
}

/// Pixels that are coloured, not grey.
fn colored(image: &Rendered) -> usize {
    let pixels = image.rgb8();
    let gap = |p: &&[u8]| p[0].saturating_sub(p[2]) > 20;
    pixels.chunks_exact(3).filter(gap).count()
}

#[test]
fn births_of_the_last_density_step_are_noted_and_marked() {
    let data = room(64);
    let still = OptimizerConfig {
        lr_position: 0.0,
        lr_position_final: 0.0,
        ..OptimizerConfig::default()
    };
    let (mut trainer, splats) = trainer(&data, still);
    let places = |splats: &Gaussians| -> Vec<[u32; 3]> {
        let planes = splats.planes();
        let place = |i: usize| [0, 1, 2].map(|k| planes[k][i].to_bits());
        (0..splats.len()).map(place).collect()
    };
    let camera = data.train[0].camera;
    let (mut before, mut steps) = (places(&splats), 0);
    loop {
        match trainer.advance().unwrap() {
            Event::Finished => break,
            Event::Density(event) if steps == 0 => {
                // Nobody has asked, and nothing is marked.
                assert!(event.stats.accepted > 0 && trainer.noted().is_none());
                let image = painted(&mut trainer, &camera, Property::Births).unwrap();
                assert_eq!(colored(&image), 0);
                assert!(painted(&mut trainer, &camera, Property::Importance).is_none());
                trainer.note_density();
            }
            Event::Density(event) => {
                let after = places(&trainer.splats().unwrap().0);
                let old: HashSet<_> = before.iter().collect();
                let new = after.iter().map(|place| !old.contains(place));
                let new: Vec<u32> = (0..)
                    .zip(new)
                    .filter(|(_, new)| *new)
                    .map(|(i, _)| i)
                    .collect();
                // Births, and the sources that split for them.
                let births = &trainer.noted().unwrap().births;
                assert!(births.iter().all(|row| new.binary_search(row).is_ok()));
                assert_eq!(births.len() as u64, event.stats.accepted);
                let split = event.stats.coarse[1] + event.stats.fine[1];
                assert_eq!(new.len() as u64, event.stats.accepted + split);
                let image = painted(&mut trainer, &camera, Property::Births).unwrap();
                assert!(colored(&image) > 0 || new.is_empty());
            }
            _ => continue,
        }
        steps += 1;
        before = places(&trainer.splats().unwrap().0);
    }
    assert!(steps > 2, "{steps} steps");
}

/// Rows of births, of importance and of what stays, by hand: rows 1 and 2 die, 4 and 5 are born, and the order is turned about.
#[test]
fn findings_follow_the_rows() {
    let outcome = Outcome {
        rows: 6,
        removed: vec![1, 2],
        importance: vec![0.1, 0.2, 0.3, 0.4, 0.5, 0.6],
        ..Outcome::default()
    };
    let noted = Noted::new(&outcome, 4, Some(&[5, 0, 3, 4]));
    assert_eq!(noted.births, [0, 3]);
    assert_eq!(noted.importance, [0.6, 0.1, 0.4, 0.5]);
    let noted = Noted::new(&outcome, 4, None);
    assert_eq!(
        (noted.births, noted.importance),
        (vec![4, 5], outcome.importance)
    );
}

/// Order of the Gaussians by how bright they are painted, which the colour map says of the value behind.
fn light(color: &[f32; 3]) -> f32 {
    0.3 * color[0] + 0.6 * color[1] + 0.1 * color[2]
}

#[test]
fn importance_and_voxels_are_painted_as_density_control_has_them() {
    let data = room(64);
    let (mut trainer, _) = trainer(&data, OptimizerConfig::default());
    trainer.note_density();
    let camera = data.train[0].camera;
    let mut steps = 0;
    loop {
        match trainer.advance().unwrap() {
            Event::Finished => break,
            Event::Density(event) => {
                let noted = trainer.noted().unwrap().clone();
                if noted.importance.iter().all(|i| *i == noted.importance[0]) {
                    // Births have not begun, and no errors were gathered.
                    continue;
                }
                steps += 1;
                assert_eq!(noted.importance.len(), event.gaussians);
                assert!(noted.importance.iter().all(|i| (0.0..=1.0).contains(i)));
                let colors = live::colors(&mut trainer, Property::Importance)
                    .unwrap()
                    .unwrap();
                let of = |i: usize| (noted.importance[i], light(&colors[i]));
                for pair in [[0, 7], [11, 40], [3, 90]] {
                    let [(a, dark), (b, bright)] = pair.map(of);
                    assert_eq!(a < b, dark < bright, "{a} {dark}, {b} {bright}");
                }
                let counts = trainer.voxel_counts().unwrap().unwrap();
                assert_eq!(counts.len(), event.gaussians);
                assert!(counts.iter().all(|n| *n > 0));
                let occupied: f64 = counts.iter().map(|n| 1.0 / f64::from(*n)).sum();
                // Voxels of the step itself.
                let told = event.stats.occupied_voxels as f64;
                assert!((occupied - told).abs() < 1e-6 * told, "{occupied} {told}");
                let colors = live::colors(&mut trainer, Property::Voxels)
                    .unwrap()
                    .unwrap();
                for i in 1..counts.len() {
                    let [before, here] = [i - 1, i].map(|i| light(&colors[i]));
                    let order = counts[i - 1].min(100).cmp(&counts[i].min(100));
                    assert_eq!(before.total_cmp(&here), order);
                }
                let image = painted(&mut trainer, &camera, Property::Voxels).unwrap();
                assert!(image.rgb8().iter().any(|v| *v > 30));
            }
            _ => continue,
        }
    }
    assert!(steps > 2, "{steps} steps");
}
