//! Several devices that train one scene: the same bits as one.

mod counted;

use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use mhsplat::base::cores::Cores;
use mhsplat::capture::{Alpha, Dataset};
use mhsplat::config::{AntiAliasing, Background, ExposureChoice, Sampler, Surrogate, TrainingSize};
use mhsplat::density::{
    DensityControl, Outcome, SceneState, Statistics, StatisticsKind, StepContext, make,
};
use mhsplat::device::tuning::Tuning;
use mhsplat::device::{Defines, Device, DeviceInfo, DeviceKind, Helpers, PhotoScale};
use mhsplat::evaluate::Evaluator;
use mhsplat::lab::bench::scene::cloud;
use mhsplat::pipeline::buffers::ViewSet;
use mhsplat::pipeline::photos::Photos;
use mhsplat::pipeline::stage::shrink::shrink;
use mhsplat::ranks::Part;
use mhsplat::run::{RunRecord, initial_gaussians};
use mhsplat::scene::{Gaussians, Plane};
use mhsplat::train::{Event, GaussianRows, Trainer, TrainerState};
use mhsplat::{Plan, TrainConfig};

use crate::background::holed;
use crate::cli::{program, room as room_path, stderr, text};
use crate::determinism::{room, room_within, sampled, trained};

/// Number of devices that help one.
fn helpers(device: &Device) -> usize {
    match device.helpers() {
        Helpers::Devices(devices) => devices.len(),
        _ => 0,
    }
}

/// No other process is to begin.
fn nobody(_: &Trainer) -> mhsplat::Result<Vec<u32>> {
    unreachable!("no processes")
}

/// A trainer with so many ranks, contexts of one device.
pub fn shared(
    data: &Dataset,
    config: &TrainConfig,
    tuning: Option<Tuning>,
    ranks: usize,
) -> Trainer {
    let list = vec!["cpu"; ranks].join(",");
    let device = Device::open_all(Some(&list), Cores::allowed()).unwrap();
    let device = match tuning {
        Some(tuning) => device.with_tuning(tuning),
        None => device,
    };
    assert_eq!(helpers(&device), ranks - 1);
    let plan = Plan::new(data, config).unwrap();
    let splats = initial_gaussians(data, &plan).unwrap();
    let mut trainer = Trainer::new(&device, data, &plan, &splats).unwrap();
    trainer
        .recruit(device.helpers(), &data.train, data.image_budget, nobody)
        .unwrap();
    trainer
}

/// Asserts that two states continue alike.
pub fn same(a: &TrainerState, b: &TrainerState) {
    assert_eq!(a.iteration, b.iteration);
    assert_eq!(a.splats.len(), b.splats.len());
    assert!(a.splats == b.splats, "the Gaussians differ");
    assert!(a.rows == b.rows, "moments, statistics or filter differ");
    assert!(a.losses == b.losses, "the losses differ");
    assert!(a.exposures == b.exposures, "the transforms differ");
    assert_eq!((a.stats, a.non_finite), (b.stats, b.non_finite));
}

#[test]
fn ranks_change_no_bit_of_any_sampler() {
    // Three rows of tiles.
    let data = room(128);
    for sampler in [Sampler::Mh, Sampler::Mcmc, Sampler::Adc] {
        let config = sampled(sampler);
        let (mut alone, _) = trained(&data, &config, 120);
        let want = alone.state().unwrap();
        let mut together = shared(&data, &config, None, 3);
        together.advance_to(120).unwrap();
        assert_eq!(together.gaussians(), want.splats.len());
        same(&together.state().unwrap(), &want);
        assert!(want.stats.accepted + want.stats.cloned > 0);
    }
}

#[test]
fn ranks_change_no_bit_with_exposure_filters_or_a_lag() {
    let data = room(64);
    let mut exposed = sampled(Sampler::Mh);
    exposed.exposure = ExposureChoice::On;
    exposed.work.density_lag = Some(5);
    let mut filtered = sampled(Sampler::Mh);
    filtered.anti_aliasing = AntiAliasing::On;
    for config in [exposed, filtered] {
        let (mut alone, _) = trained(&data, &config, 120);
        let want = alone.state().unwrap();
        assert!(want.exposures.is_empty() != want.rows.filter.is_empty());
        let mut together = shared(&data, &config, None, 2);
        together.advance_to(120).unwrap();
        same(&together.state().unwrap(), &want);
    }
}

/// First-order estimates of births are those of one device, which has all rows then.
#[test]
fn ranks_change_no_bit_of_estimates() {
    let data = room(48);
    let mut config = sampled(Sampler::Mh);
    config.max_size = 48;
    config.mh.surrogate = Surrogate::Probe;
    let (mut alone, _) = trained(&data, &config, 60);
    let want = alone.state().unwrap();
    assert!(want.stats.proposed > 0);
    let mut together = shared(&data, &config, None, 2);
    together.advance_to(60).unwrap();
    same(&together.state().unwrap(), &want);
}

/// Tiles of which a small photo has several rows.
const SMALL: Tuning = Tuning {
    tile: 16,
    ..Tuning::CPU
};

/// Photos that do not fit are decoded on demand, and each rank keeps the rows that its bands need, of smaller photos, too.
#[test]
fn ranks_keep_parts_of_photos_and_change_no_bit() {
    // Of twelve rows of tiles a quarter is a band; on either side it sees one more, and another is kept.
    let (photo, few) = (256 * 192 * 3, 30);
    let data = room_within(256, Some(few * photo));
    assert!(data.photos_on_demand());
    let mut config = sampled(Sampler::Mh);
    config.max_size = 256;
    for (levels, iterations) in [(0, 50), (1, 130)] {
        config.work.resolution_levels = levels;
        let [mut alone, mut together] = [1, 4].map(|n| shared(&data, &config, Some(SMALL), n));
        alone.advance_to(iterations).unwrap();
        together.advance_to(iterations).unwrap();
        same(&together.state().unwrap(), &alone.state().unwrap());
        let [one, leader] = [&alone, &together].map(Trainer::photo_stats);
        assert_eq!(one.total_bytes, leader.total_bytes);
        if levels == 0 {
            assert!(one.peak_bytes > (few - 1) * photo, "{one:?}");
            assert!(3 * leader.peak_bytes < 2 * one.peak_bytes, "{leader:?}");
        }
    }
}

/// Tiles beside a band that are blank are known there, so that the losses, too, are those of one rank.
#[test]
fn ranks_change_no_bit_of_transparent_or_masked_photos() {
    for meaning in [Alpha::Transparency, Alpha::Mask] {
        let mut data = holed(0, meaning);
        // Photos of two sizes, so that a density step looks at views of more tiles than the iteration before it had.
        for view in data.train.iter_mut().step_by(2) {
            let small = shrink(&view.photo.load().unwrap(), PhotoScale::one_over(2));
            view.camera = view.camera.scaled_to(small.width, small.height);
            view.photo = small.into();
        }
        let config = sampled(Sampler::Mh);
        let [mut alone, mut together] = [1, 3].map(|n| shared(&data, &config, Some(SMALL), n));
        alone.advance_to(80).unwrap();
        together.advance_to(80).unwrap();
        same(&together.state().unwrap(), &alone.state().unwrap());
    }
}

/// The strategy of the caller's own is that of all ranks.
#[test]
fn ranks_change_no_bit_of_a_strategy_of_ones_own() {
    let data = room(64);
    let config = sampled(Sampler::Mh);
    let plan = Plan::new(&data, &config).unwrap();
    let splats = initial_gaussians(&data, &plan).unwrap();
    let mut mcmc = config.clone();
    mcmc.sampler = Sampler::Mcmc;
    let run = |ranks: usize| {
        let list = vec!["cpu"; ranks].join(",");
        let device = Device::open_all(Some(&list), Cores::allowed()).unwrap();
        let strategy = make(&mcmc);
        let mut trainer = Trainer::with_strategy(&device, &data, &plan, &splats, strategy).unwrap();
        trainer
            .recruit(device.helpers(), &data.train, data.image_budget, nobody)
            .unwrap();
        trainer.advance_to(60).unwrap();
        trainer.state().unwrap()
    };
    same(&run(2), &run(1));
}

/// Removes another row each time that it is asked.
#[derive(Default)]
struct Fickle(AtomicU32);

impl DensityControl for Fickle {
    fn wanted(&self, _: usize, _: f64) -> StatisticsKind {
        StatisticsKind::Nothing
    }

    fn step(
        &self,
        _: &StepContext<'_>,
        scene: &SceneState<'_>,
        _: &Statistics<'_>,
    ) -> mhsplat::Result<Outcome> {
        Ok(Outcome {
            removed: vec![self.0.fetch_add(1, Ordering::Relaxed)],
            ..Outcome::unchanged(scene.len())
        })
    }
}

#[test]
fn ranks_that_decide_differently_end_the_run() {
    let data = room(32);
    let mut config = sampled(Sampler::Mh);
    config.max_size = 32;
    for lag in [0, 4] {
        config.work.density_lag = Some(lag);
        let plan = Plan::new(&data, &config).unwrap();
        let splats = initial_gaussians(&data, &plan).unwrap();
        let run = |ranks: usize| {
            let list = vec!["cpu"; ranks].join(",");
            let device = Device::open_all(Some(&list), Cores::allowed()).unwrap();
            let fickle = Arc::new(Fickle::default());
            let mut trainer =
                Trainer::with_strategy(&device, &data, &plan, &splats, fickle).unwrap();
            trainer
                .recruit(device.helpers(), &data.train, data.image_budget, nobody)
                .unwrap();
            trainer.advance_to(60)
        };
        run(1).unwrap();
        let said = run(2).unwrap_err().to_string();
        assert!(said.contains("decided a density step otherwise"), "{said}");
    }
}

#[test]
fn a_run_goes_on_with_another_number_of_ranks() {
    let data = room(64);
    for (lag, after, numbers) in [(0, 48, [1, 3].as_slice()), (8, 55, &[3])] {
        let mut config = sampled(Sampler::Mh);
        config.work.density_lag = Some(lag);
        goes_on(&data, &config, after, numbers);
    }
}

/// Asserts that a run of two ranks that is stopped after some iterations ends with so many ranks as without the stop.
fn goes_on(data: &Dataset, config: &TrainConfig, after: u32, numbers: &[usize]) {
    let (mut alone, _) = trained(data, config, 120);
    let want = alone.state().unwrap();
    let mut half = shared(data, config, None, 2);
    half.advance_to(after).unwrap();
    let state = half.state().unwrap();
    // The others do not know a step that the checkpoint has.
    assert_eq!(state.deciding.is_some(), after == 55);
    drop(half);
    let device = Device::open(None).unwrap();
    let plan = Plan::new(data, config).unwrap();
    for &ranks in numbers {
        let list = vec!["cpu"; ranks].join(",");
        let all = Device::open_all(Some(&list), Cores::allowed()).unwrap();
        let mut trainer = Trainer::new(&device, data, &plan, &state.splats).unwrap();
        trainer
            .recruit(all.helpers(), &data.train, data.image_budget, nobody)
            .unwrap();
        trainer.restore(&state).unwrap();
        trainer.advance_to(120).unwrap();
        same(&trainer.state().unwrap(), &want);
    }
}

/// Between iterations everything is as it was: renders, losses, scores and a length that changes on the way.
#[test]
fn a_look_and_a_new_length_change_nothing() {
    let data = room(64);
    let mut config = sampled(Sampler::Mh);
    // Losses are those of renders over another one.
    config.background = Background::Random;
    let run = |mut trainer: Trainer| {
        let device = Device::open(None).unwrap();
        let views = ViewSet::new(&Photos::new(&device, data.image_budget), data.test.clone());
        let defines = Defines::new(trainer.tuning());
        let evaluator = Evaluator::new(&device, defines, views.unwrap()).unwrap();
        trainer.advance_to(30).unwrap();
        let image = trainer.render(&data.train[0].camera).unwrap();
        trainer.advance_to(33).unwrap();
        let losses = [trainer.noted_loss(), trainer.recent_loss()].map(Result::unwrap);
        let mut scores = evaluator.score_all(&mut trainer, [0.5; 3], true).unwrap();
        evaluator
            .add_color_corrected(&mut scores, &mut trainer, [0.5; 3])
            .unwrap();
        let splats = trainer.splats().unwrap();
        trainer.set_length(90, TrainingSize::ThreeQuarters).unwrap();
        trainer.advance_to(90).unwrap();
        ((image, losses, scores, splats), trainer.state().unwrap())
    };
    let alone = run(trained(&data, &config, 0).0);
    let together = run(shared(&data, &config, None, 2));
    assert!(alone.0 == together.0);
    assert_ne!(
        alone.0.1[0], alone.0.1[1],
        "the loss must be able to differ"
    );
    same(&alone.1, &together.1);
}

/// Gaussians that no view shows are removed at the end, wherever they are; what belongs to the others goes with them.
#[test]
fn ranks_change_no_bit_of_the_end() {
    let data = room(64);
    let mut config = sampled(Sampler::Mh);
    config.iterations = 30;
    config.anti_aliasing = AntiAliasing::On;
    let plan = Plan::new(&data, &config).unwrap();
    let mut splats = initial_gaussians(&data, &plan).unwrap();
    for row in (0..splats.len()).step_by(7) {
        splats.scatter(Plane::POSITION, row, [1e4, 0.0, row as f32]);
    }
    let run = |ranks: usize, tuning: Option<Tuning>| {
        let list = vec!["cpu"; ranks].join(",");
        let device = Device::open_all(Some(&list), Cores::allowed()).unwrap();
        let device = match tuning {
            Some(tuning) => device.with_tuning(tuning),
            None => device,
        };
        let mut trainer = Trainer::new(&device, &data, &plan, &splats).unwrap();
        trainer
            .recruit(device.helpers(), &data.train, data.image_budget, nobody)
            .unwrap();
        while trainer.advance().unwrap() != Event::Finished {}
        let removed = trainer.learned().removed;
        assert!(removed as usize >= splats.len() / 7, "{removed}");
        trainer.state().unwrap()
    };
    same(&run(3, None), &run(1, None));
    same(&run(2, Some(Tuning::GPU)), &run(1, Some(Tuning::GPU)));
}

/// Bytes of rows that the leader has sent.
fn rows_sent(trainer: &Trainer) -> u64 {
    trainer.traffic().unwrap()[Part::Rows as usize]
}

/// Rows stay where they are while they are looked at, saved or changed between iterations.
#[test]
fn rows_stay_with_their_ranks() {
    let data = room(64);
    let mut config = sampled(Sampler::Mh);
    config.sh_degree = 0;
    let mut together = shared(&data, &config, None, 2);
    together.advance_to(1).unwrap();
    let (spread, first) = (rows_sent(&together), together.gaussians() as u64);
    assert!(spread > 0);
    together.render(&data.train[0].camera).unwrap();
    together.state().unwrap();
    together.advance_to(24).unwrap();
    assert_eq!(rows_sent(&together), spread);
    // Bytes that spread the rows of every density step.
    let mut all = 0;
    while together.iteration() < 120 {
        if let Event::Density(step) = together.advance().unwrap() {
            all += spread * step.gaussians as u64 / first;
        }
    }
    let moved = rows_sent(&together) - spread;
    assert!(moved > 0 && moved < all, "{moved} of {all}");
    // What needs all of them on one device has them there, and spreads them again.
    together.brightness().unwrap();
    together.advance_to(121).unwrap();
    assert!(rows_sent(&together) - spread - moved > spread / 4);
}

/// Rows come to the ranks from the host's memory, so that a scene may be larger than what any of their devices has room for.
#[test]
fn no_device_has_all_rows_when_a_run_begins() {
    let data = room(48);
    let config = TrainConfig {
        max_size: 48,
        sh_degree: 2,
        // A filter that is there before the first iteration.
        anti_aliasing: AntiAliasing::On,
        ..sampled(Sampler::None)
    };
    let plan = Plan::new(&data, &config).unwrap();
    let splats = cloud(60_000).with_sh_degree(2).unwrap();
    let alone = Device::open(None).unwrap();
    let mut one = Trainer::new(&alone, &data, &plan, &splats).unwrap();
    let want = one.state().unwrap();
    let device = Device::open_all(Some("cpu,cpu,cpu"), Cores::allowed()).unwrap();
    let none = Gaussians::zeros(2, 1);
    let mut leader = Trainer::new(&device, &data, &plan, &none).unwrap();
    leader
        .recruit(device.helpers(), &data.train, data.image_budget, nobody)
        .unwrap();
    assert!(
        leader
            .spread_from_host(&Gaussians::zeros(2, 0), &GaussianRows::default())
            .is_err()
    );
    leader
        .spread_from_host(&splats, &GaussianRows::default())
        .unwrap();
    let [most, each] = [&alone, &device].map(Device::allocated_bytes);
    assert!(2 * each < most, "{each} of {most} bytes");
    assert!(want.rows.filter.iter().any(|v| *v > 0.0));
    same(&leader.state().unwrap(), &want);
    one.advance_to(4).unwrap();
    leader.advance_to(4).unwrap();
    same(&leader.state().unwrap(), &one.state().unwrap());
    // Whole rows of another shape are refused, as those of a damaged checkpoint.
    let short = GaussianRows {
        moment1: vec![vec![0.0; 60_000]; 3],
        ..GaussianRows::default()
    };
    let said = leader.spread_from_host(&splats, &short).unwrap_err();
    assert!(said.to_string().contains("3 planes of moment1"), "{said}");
    // Nothing goes on from rows of which some ranks alone have a part.
    assert!(leader.advance_to(5).is_err());
}

#[test]
fn ranks_change_no_bit_in_the_group_style() {
    // Of two rows of tiles, so that two of four ranks have none.
    let data = room(32);
    let mut config = sampled(Sampler::Mh);
    config.max_size = 32;
    // Tiles of several segments of pairs: even an eighth of the Gaussians in view are more than a tile's segment each.
    let tuning = Tuning {
        grad_segment: 64,
        ..Tuning::GPU
    };
    let run = |ranks| {
        let mut trainer = shared(&data, &config, Some(tuning), ranks);
        trainer.advance_to(30).unwrap();
        trainer.state().unwrap()
    };
    let want = run(1);
    assert!(want.splats.len() > 8 * 4 * tuning.grad_segment as usize);
    same(&run(2), &want);
    same(&run(4), &want);
}

/// Blank tiles are skipped, but for iterations in which density control gathers errors.
#[test]
fn ranks_change_no_bit_of_transparent_photos_in_the_group_style() {
    let data = holed(0, Alpha::Transparency);
    let config = sampled(Sampler::Mh);
    let run = |ranks| {
        let mut trainer = shared(&data, &config, Some(Tuning::GPU), ranks);
        trainer.advance_to(30).unwrap();
        trainer.state().unwrap()
    };
    same(&run(2), &run(1));
}

/// The scene of a short run.
fn scene(dir: &Path, device: &str) -> Vec<u8> {
    let run = dir.join(device.replace('/', "-"));
    let mut command = program();
    command.args(["train", &room_path(), "-o", text(&run), "-q"]);
    command.args([
        "--iterations",
        "200",
        "--max-size",
        "64",
        "--device",
        device,
    ]);
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let ranks = RunRecord::read(&run).unwrap().device.ranks;
    assert_eq!(ranks, (device != "cpu").then_some(2));
    let report = fs::read_to_string(run.join("report.html")).unwrap();
    assert_eq!(report.contains("ranks, the first"), ranks.is_some());
    fs::read(run.join("scene.ply")).unwrap()
}

#[test]
fn the_program_takes_lists_of_devices_and_parts_of_one() {
    let dir = tempfile::tempdir().unwrap();
    let want = scene(dir.path(), "cpu");
    assert!(scene(dir.path(), "cpu,cpu") == want);
    if Cores::allowed().count() < 2 {
        println!("skipped: one core");
        return;
    }
    assert!(scene(dir.path(), "cpu/2") == want);
}

/// Processes of one node share its devices out, those that are like the default one: no other platform's, no slower ones beside them.
#[test]
fn processes_of_a_node_take_its_devices_in_turn() {
    let cpu = Device::open(None).unwrap().info().clone();
    let device = |index, kind, [platform, name]: [&str; 2]| DeviceInfo {
        index,
        kind,
        platform: platform.to_owned(),
        name: name.to_owned(),
        ..cpu.clone()
    };
    let (gpu, cpu) = (DeviceKind::Gpu, DeviceKind::Cpu);
    let taken = |list: &[DeviceInfo], ranks: usize| -> Vec<usize> {
        let of = |rank| Device::of_local_rank(list, rank).unwrap().index;
        (0..ranks).map(of).collect()
    };
    let node = [
        device(0, cpu, ["PoCL", "Zen"]),
        device(1, gpu, ["AMD", "MI300"]),
        device(2, gpu, ["rusticl", "MI300"]),
        device(3, gpu, ["AMD", "graphics of the processor"]),
        device(4, gpu, ["AMD", "MI300"]),
    ];
    assert_eq!(taken(&node, 5), [1, 4, 1, 4, 1]);
    let cpus = [
        device(0, cpu, ["PoCL", "Zen"]),
        device(1, cpu, ["Intel", "Zen"]),
    ];
    assert_eq!(taken(&cpus, 3), [0, 0, 0]);
    assert!(Device::of_local_rank(&[], 0).is_none());
}

/// A program without MPI does not train as many scenes as there are processes.
#[test]
fn processes_without_mpi_are_refused() {
    if cfg!(feature = "mpi") {
        println!("skipped: with MPI");
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    let mut command = program();
    command.args(["train", &room_path(), "-o", text(&run), "--iterations", "1"]);
    command.env("OMPI_COMM_WORLD_SIZE", "2");
    let output = command.output().unwrap();
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(2));
    assert!(
        said.contains("2 processes") && said.contains("--features mpi"),
        "{said}"
    );
    assert!(!run.exists());
}

#[test]
fn what_cannot_be_had_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    let refused = |device: &str| {
        let mut command = program();
        command.args(["train", &room_path(), "-o", text(&run), "--device", device]);
        let output = command.output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{device}");
        assert!(!run.exists());
        stderr(&output)
    };
    for (device, said) in [
        ("cpu/0", "0 parts of"),
        ("cpu/4096", "4096 parts of"),
        ("cpu,nonsense", "no device matches \"nonsense\""),
        ("cpu/x", "no device matches \"cpu/x\""),
        (",", "no device matches \"\""),
    ] {
        let text = refused(device);
        assert!(text.contains(said), "{device}: {text}");
    }
    let mut command = program();
    command.args(["eval", text(dir.path()), "--device", "cpu,cpu"]);
    let output = command.output().unwrap();
    assert_eq!(output.status.code(), Some(2));
}
