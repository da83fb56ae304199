//! Space about the training cameras in which no Gaussian stays.

use std::fs;

use crate::cli::mhsplat;
use crate::determinism::{drive, room, saved};
use mhsplat::Plan;
use mhsplat::capture::Dataset;
use mhsplat::config::{Background, Sampler, TrainConfig};
use mhsplat::density::Clearance;
use mhsplat::density::clearance::radii;
use mhsplat::device::Device;
use mhsplat::run::{RunRecord, checkpoint, initial_gaussians};
use mhsplat::scene::{Gaussians, Plane};
use mhsplat::train::{Begun, Trainer};

const ROOM: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/data/room-tiny");
const ITERATIONS: u32 = 240;
/// Cameras that have a Gaussian behind them at first.
const PLANTED: usize = 3;

fn config(sampler: Sampler, clearance: f64) -> TrainConfig {
    TrainConfig {
        sampler,
        clearance,
        iterations: ITERATIONS,
        max_size: 64,
        // The counts below were found over it.
        background: Background::Black,
        ..TrainConfig::default()
    }
}

/// Opaque Gaussians right behind some cameras, with the first ones of the room.
fn crowded(data: &Dataset, plan: &Plan, radii: &[f32]) -> Gaussians {
    let splats = initial_gaussians(data, plan).unwrap();
    let mut planes = splats.planes().to_vec();
    for (view, radius) in data.train.iter().zip(radii).take(PLANTED) {
        let ahead = view.camera.rotation.row(2);
        let behind = view.camera.center() - 0.5 * f64::from(*radius) * ahead;
        for (p, plane) in planes.iter_mut().enumerate() {
            plane.push(match p {
                0..3 => behind.to_array()[p] as f32,
                3..6 => -6.0,
                6 => 1.0,
                Plane::OPACITY => 4.0,
                _ => 0.0,
            });
        }
    }
    Gaussians::new(splats.sh_degree(), planes).unwrap()
}

/// Number of Gaussians in balls of these radii about the training cameras.
fn within(data: &Dataset, radii: &[f32], splats: &Gaussians) -> usize {
    let clearance = Clearance::new(&centers(data), radii);
    let held = |i: &usize| clearance.holds(splats.gather(Plane::POSITION, *i));
    (0..splats.len()).filter(held).count()
}

fn centers(data: &Dataset) -> Vec<[f32; 3]> {
    let centers = data.train.iter().map(|view| view.camera.center());
    centers.map(|c| c.as_vec3().to_array()).collect()
}

/// Trained until density control has had steps.
fn trained(data: &Dataset, radii: &[f32], sampler: Sampler, clearance: f64) -> Trainer {
    let config = config(sampler, clearance);
    let plan = Plan::new(data, &config).unwrap();
    let splats = crowded(data, &plan, radii);
    assert!(within(data, radii, &splats) >= PLANTED);
    let device = Device::open(None).unwrap();
    let mut trainer = Trainer::new(&device, data, &plan, &splats).unwrap();
    drive(&mut trainer, ITERATIONS / 2).unwrap();
    trainer
}

#[test]
fn whatever_stands_about_a_camera_goes_with_every_strategy() {
    let data = room(64);
    let radii = radii(&centers(&data), &data.points.positions, 0.5);
    assert!(radii.iter().all(|r| *r > 0.0));
    for sampler in [Sampler::Mh, Sampler::Mcmc, Sampler::Adc] {
        let [free, crowded] = [0.5, 0.0].map(|clearance| {
            let mut trainer = trained(&data, &radii, sampler, clearance);
            within(&data, &radii, &trainer.state().unwrap().splats)
        });
        // One may have come in since the last step.
        let good = free <= 1 && crowded >= PLANTED;
        assert!(good, "{sampler:?}: {free}, {crowded}");
    }
    // A fixed set is fixed.
    let mut fixed = trained(&data, &radii, Sampler::None, 0.5);
    assert!(within(&data, &radii, &fixed.state().unwrap().splats) >= PLANTED);
}

#[test]
fn a_checkpoint_keeps_the_radii() {
    let data = room(64);
    let radii = radii(&centers(&data), &data.points.positions, 0.25);
    let mut trainer = trained(&data, &radii, Sampler::Mh, 0.25);
    let folder = tempfile::tempdir().unwrap();
    let config = config(Sampler::Mh, 0.25);
    checkpoint::write(folder.path(), &saved(&mut trainer, &config, &data)).unwrap();
    let read = checkpoint::read(folder.path()).unwrap();
    assert_eq!(read.state.clearance, radii);
}

#[test]
fn a_run_that_began_without_goes_on_without() {
    let (data, config) = (room(64), config(Sampler::Mh, 0.5));
    let kept = |radii: &[f32]| {
        let begun = Begun {
            clearance: Some(radii.to_vec()),
            ..Begun::default()
        };
        Plan::begun(&data, &config, &begun).map(|plan| plan.clearance.value)
    };
    assert!(kept(&[]).unwrap().is_empty());
    let mut radii = vec![0.5; data.train.len()];
    assert_eq!(kept(&radii).unwrap(), radii);
    // Of other views, or no radius.
    assert!(kept(&radii[1..]).is_err());
    radii[0] = f32::NAN;
    assert!(kept(&radii).is_err());
}

/// Records and configurations of earlier versions name no clearance and keep none.
#[test]
fn records_of_earlier_versions_had_none() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let (first, again) = (path("first"), path("again"));
    let train = |out: &str, more: &[&str]| {
        let all = [
            "train",
            ROOM,
            "-o",
            out,
            "--iterations",
            "2",
            "--max-size",
            "64",
        ];
        let output = mhsplat(&[&all[..], more].concat());
        assert!(output.status.success());
        RunRecord::read(out).unwrap().config.clearance
    };
    assert_eq!(train(&first, &[]), 0.5);
    let file = format!("{first}/run.json");
    let text = fs::read_to_string(&file).unwrap();
    let mut record: serde_json::Value = serde_json::from_str(&text).unwrap();
    let config = record["config"].as_object_mut().unwrap();
    assert!(config.remove("clearance").is_some());
    fs::write(&file, record.to_string()).unwrap();
    assert_eq!(RunRecord::read(&first).unwrap().config.clearance, 0.0);
    assert_eq!(train(&again, &["--config", &file]), 0.0);
    // The background as well: those of opaque photos were over black, and so is who repeats or goes on with one.
    let background = |run: &str| {
        let record = RunRecord::read(run).unwrap();
        (record.config.background, record.background())
    };
    assert_eq!(background(&again).0, Background::Auto);
    assert!(background(&again).1[0] > 0.1);
    assert!(
        record
            .as_object_mut()
            .unwrap()
            .remove("background")
            .is_some()
    );
    fs::write(&file, record.to_string()).unwrap();
    let black = (Background::Black, [0.0; 3]);
    assert_eq!(background(&first), black);
    let third = path("third");
    train(&third, &["--config", &file]);
    assert_eq!(background(&third), black);
    // Whoever restarts it has to ask for the same, and so has whoever restarts one of today.
    let restart = |run: &str, background: &str| {
        let all = ["train", ROOM, "-o", run, "--resume-or-start"];
        let same = ["--iterations", "2", "--max-size", "64", "--clearance", "0"];
        mhsplat(&[&all[..], &same, &["--background", background]].concat())
    };
    for _ in 0..2 {
        let output = restart(&third, "black");
        assert!(output.status.success(), "{output:?}");
        assert_eq!(background(&third), black);
    }
    for (run, other) in [(&third, "auto"), (&third, "white"), (&again, "black")] {
        let said = String::from_utf8(restart(run, other).stderr).unwrap();
        assert!(said.contains("another `background`"), "{other}: {said}");
    }
}
