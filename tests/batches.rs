//! Several views per step of the optimiser: the same bits however a run is interrupted and divided.

use std::collections::HashSet;
use std::fs;

use mhsplat::capture::Dataset;
use mhsplat::config::{ExposureChoice, Sampler};
use mhsplat::device::Device;
use mhsplat::run::{checkpoint, initial_gaussians};
use mhsplat::scene::Gaussians;
use mhsplat::train::Trainer;
use mhsplat::train::schedule::Schedule;
use mhsplat::{Plan, TrainConfig};
use serde_json::Value;

use crate::cli::{done, mhsplat, room as room_path, stderr, text};
use crate::determinism::{drive, room, sampled, saved, trained};
use crate::ranks::{same, shared};

/// Runs of 120 views, with density steps after whole batches: of each sampler, with exposure compensation, and with a lag.
fn configs(batch: u32) -> Vec<TrainConfig> {
    let mut exposed = sampled(Sampler::Mh);
    exposed.exposure = ExposureChoice::On;
    let mut lagging = sampled(Sampler::Mcmc);
    lagging.work.density_lag = Some(5);
    let mut configs: Vec<_> = [Sampler::Mh, Sampler::Mcmc, Sampler::Adc]
        .map(sampled)
        .into_iter()
        .chain([exposed, lagging])
        .collect();
    configs.iter_mut().for_each(|c| c.batch = batch);
    configs
}

fn made(data: &Dataset, config: &TrainConfig, splats: &Gaussians) -> Trainer {
    let device = Device::open(None).unwrap();
    Trainer::new(&device, data, &Plan::new(data, config).unwrap(), splats).unwrap()
}

/// A checkpoint amidst a batch holds the gradients of its views so far.
#[test]
fn a_run_goes_on_amidst_a_batch_with_the_same_bits() {
    let data = room(64);
    for config in configs(3) {
        let (_, whole) = trained(&data, &config, 120);
        let born = whole.len() != trained(&data, &config, 0).1.len();
        assert!(born, "density control has not taken part");
        for at in [48, 49, 53] {
            let (mut half, _) = trained(&data, &config, at);
            let folder = tempfile::tempdir().unwrap();
            checkpoint::write(folder.path(), &saved(&mut half, &config, &data)).unwrap();
            let mut state = checkpoint::read(folder.path()).unwrap().state;
            assert_eq!(state.rows.gradients.is_empty(), at == 48);
            let mut trainer = made(&data, &config, &state.splats);
            trainer.restore(&state).unwrap();
            drive(&mut trainer, 120).unwrap();
            assert!(trainer.state().unwrap().splats == whole, "{at}: {config:?}");
            // Without them it is refused.
            state.rows.gradients.clear();
            let mut trainer = made(&data, &config, &state.splats);
            assert_eq!(trainer.restore(&state).is_ok(), at == 48);
        }
    }
}

#[test]
fn ranks_change_no_bit_of_batches() {
    let data = room(64);
    for batch in [2, 3] {
        for config in configs(batch) {
            let mut alone = trained(&data, &config, 0).0;
            let mut together = shared(&data, &config, None, batch as usize);
            // Rows are gathered amidst a batch, too.
            for until in [55, 56, 120] {
                drive(&mut alone, until).unwrap();
                drive(&mut together, until).unwrap();
                same(&together.state().unwrap(), &alone.state().unwrap());
            }
        }
    }
}

#[test]
fn pairs_that_do_not_fit_amidst_a_batch_are_repeated() {
    let data = room(64);
    for config in configs(3) {
        let (_, whole) = trained(&data, &config, 60);
        let plan = Plan::new(&data, &config).unwrap();
        let splats = initial_gaussians(&data, &plan).unwrap();
        let mut tight = made(&data, &config, &splats);
        for at in 0..60 {
            if [0, 7, 11, 27].contains(&at) {
                tight.shrink_intersections(256).unwrap();
            }
            drive(&mut tight, at + 1).unwrap();
        }
        assert!(tight.overflows() >= 4);
        assert!(tight.state().unwrap().splats == whole);
    }
}

#[test]
fn another_batch_is_another_run() {
    let data = room(64);
    let scenes = [1, 2, 3].map(|batch| {
        let config = TrainConfig {
            batch,
            ..sampled(Sampler::Mh)
        };
        trained(&data, &config, 40).1
    });
    assert!(scenes[0] != scenes[1] && scenes[1] != scenes[2]);
}

#[test]
fn no_batch_has_a_view_twice() {
    for (batch, views) in [(1, 5), (2, 5), (3, 5), (5, 5), (4, 44), (7, 17)] {
        let schedule = Schedule::new(&TrainConfig {
            batch,
            ..TrainConfig::default()
        });
        let order = schedule.upcoming(0, 60 * batch as usize, views);
        let distinct = |views: &[usize]| views.iter().collect::<HashSet<_>>().len();
        let mut batches = order.chunks_exact(batch as usize);
        assert!(batches.all(|batch| distinct(batch) == batch.len()));
        assert_eq!(distinct(&order), views, "every view has its turn");
    }
}

#[test]
fn density_steps_come_between_batches() {
    for batch in [1, 2, 3, 7, 64] {
        let config = TrainConfig {
            batch,
            iterations: 7000,
            ..TrainConfig::default()
        };
        let schedule = Schedule::new(&config).with_density_lag(16);
        let steps: Vec<u32> = (0..7000)
            .filter(|done| schedule.density_due(*done).is_some())
            .collect();
        assert!(steps.len() > 10, "{batch}: {} steps", steps.len());
        for done in steps {
            let lag = schedule.density_lag(done);
            assert!(done.is_multiple_of(batch) && lag.is_multiple_of(batch));
            assert!(lag <= 16 && 2 * lag <= schedule.density_interval(done));
        }
    }
}

#[test]
fn the_program_takes_batches_and_repeats_them() {
    let dir = tempfile::tempdir().unwrap();
    let room = room_path();
    let run = |name: &str, options: &[&str]| {
        let out = dir.path().join(name);
        let args = [&["train", &room, "-o", text(&out), "-q", "--json"], options].concat();
        let record: Value = serde_json::from_str(&done(&args)).unwrap();
        (record, fs::read(out.join("scene.ply")).unwrap())
    };
    // The last view fills no batch.
    let options = ["--iterations", "100", "--max-size", "48", "--batch", "3"];
    let (record, scene) = run("first", &options);
    assert_eq!(record["config"]["batch"], 3);
    assert_eq!(record["iterations"], 100);
    let config = dir.path().join("first").join("run.json");
    let (_, again) = run("again", &["--config", text(&config)]);
    assert!(again == scene);
    let short = ["--budget-cpu", "4s", "--max-size", "48", "--batch", "3"];
    let (record, scene) = run("short", &short);
    assert!(record["iterations"].as_u64() > Some(20));
    let config = dir.path().join("short").join("run.json");
    let (_, again) = run("short-again", &["--config", text(&config)]);
    assert!(again == scene);
}

#[test]
fn batches_that_cannot_be_filled_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    for (batch, said) in [
        ("0", "--batch: 0; at least 1 view expected"),
        (
            "41",
            "--batch: 41; no more than the 40 training views expected",
        ),
        ("few", "invalid value 'few' for '--batch <N>'"),
    ] {
        let args = ["train", &room_path(), "-o", text(&out), "--batch", batch];
        let output = mhsplat(&[&args[..], &["--test-every", "0"]].concat());
        assert_eq!(output.status.code(), Some(2), "{batch}");
        assert!(stderr(&output).contains(said), "{}", stderr(&output));
        assert!(!out.exists());
    }
}
