//! Launches of an iteration on a GPU: how many there are, and with how many work-items.

use crate::determinism::room;
use mhsplat::capture::{Alpha, Photo};
use mhsplat::config::{AntiAliasing, ExposureChoice, Sampler, TrainConfig};
use mhsplat::device::tuning::Tuning;
use mhsplat::scene::Gaussians;
use mhsplat::train::Event;
use mhsplat::{Device, Plan, Trainer};

const GAUSSIANS: usize = 1_000_000;
const SIZE: [u32; 2] = [1600, 1066];

/// A GPU has tens of thousands of lanes: fewer work-items leave most of them idle.
const LEAST: usize = 10_000;

/// Kernels that may have fewer work-items, and how many they have at least: what they go over is small, or all of it is in order.
const FEWER: [(&str, usize); 3] = [
    // Sums of 1024 groups for each of twelve entries, and the transforms of all views.
    ("exposure_step", 12 * 256),
    // Runs of chunks of eight bins for each group: 128 or 256 bins of a digit.
    ("sort_totals", 4096),
    // One for each of 6700 tiles.
    ("bin_ranges", 6700),
];

/// Training with a million Gaussians, all behind the camera so that little is computed, and a photo with this meaning of alpha.
fn trainer(
    alpha: Alpha,
    room_for_small: bool,
    change: impl Fn(&mut TrainConfig),
) -> (Device, Trainer) {
    let mut config = TrainConfig {
        sampler: Sampler::None,
        sh_degree: 0,
        ..TrainConfig::default()
    };
    config.work.resolution_levels = 0;
    change(&mut config);
    // The size that is used at first is always the same.
    let size = SIZE.map(|side| side << config.work.resolution_levels);
    let device = Device::open(None).unwrap().with_tuning(Tuning::GPU);
    let mut data = room(64);
    let mut view = data.train[0].clone();
    let [width, height] = size;
    view.camera = view.camera.scaled_to(width, height);
    view.photo = Photo {
        width,
        height,
        alpha,
        data: vec![128; alpha.planes() * (width * height) as usize],
    }
    .into();
    let behind = view.camera.center() - view.camera.rotation.row(2);
    if !room_for_small {
        data.image_budget = view.photo.bytes();
    }
    data.train = vec![view; config.batch.max(1) as usize];
    let mut planes = vec![vec![0.0; GAUSSIANS]; 11 + 3];
    for (plane, x) in planes.iter_mut().zip(behind.to_array()) {
        plane.fill(x as f32);
    }
    planes[3..6].iter_mut().for_each(|plane| plane.fill(-8.0));
    planes[6].fill(1.0);
    let plan = Plan::new(&data, &config).unwrap();
    let splats = Gaussians::new(0, planes).unwrap();
    let mut trainer = Trainer::new(&device, &data, &plan, &splats).unwrap();
    trainer.time_every_iteration();
    (device, trainer)
}

type Launches = Vec<(&'static str, usize)>;

/// Launches of each of the first iterations of a run.
fn launches(change: impl Fn(&mut TrainConfig), count: usize) -> Vec<Launches> {
    launches_over(Alpha::None, true, change, count)
}

/// The same for photos with this meaning of alpha, with room in the budget for smaller ones or not.
fn launches_over(
    alpha: Alpha,
    room_for_small: bool,
    change: impl Fn(&mut TrainConfig),
    count: usize,
) -> Vec<Launches> {
    let (device, mut trainer) = trainer(alpha, room_for_small, change);
    let mut iterations = Vec::new();
    while iterations.len() < count {
        if !matches!(trainer.advance().unwrap(), Event::Iteration { .. }) {
            continue;
        }
        // Those of iterations before may be there still.
        let mut enqueued = device.enqueued();
        let is = |at: usize, names: &[&str]| names.contains(&enqueued[at].0);
        let project = (0..enqueued.len()).rfind(|at| is(*at, &["project"]));
        let before = |at: &usize| {
            is(*at, &["shrink", "active_tiles"]) || enqueued[*at].0.starts_with("filter_")
        };
        let first = (0..project.unwrap()).rev().take_while(before).last();
        let first = first.or(project).unwrap();
        iterations.push(enqueued.split_off(first));
    }
    trainer.settle().unwrap();
    iterations
}

fn check_work(launches: Vec<(&'static str, usize)>) {
    for (kernel, items) in launches {
        let fewer = FEWER.iter().find(|(name, _)| *name == kernel);
        let least = fewer.map_or(LEAST, |(_, least)| *least);
        assert!(
            items >= least,
            "{kernel} has {items} work-items, {least} expected"
        );
    }
}

#[test]
fn kernels_have_work_for_a_gpu() {
    let launches = launches(|_| (), 1).remove(0);
    assert!(launches.len() > 20 && launches.len() <= 30, "{launches:?}");
    check_work(launches);
}

/// A step after every third iteration, for which the last of them gathers the errors of its view.
fn with_steps(config: &mut TrainConfig) {
    config.sampler = Sampler::Mh;
    (config.mh.from_iteration, config.mh.interval) = (3, 3);
    config.mh.births_from_iteration = Some(0);
    config.max_gaussians = Some(2 * GAUSSIANS);
}

#[test]
fn density_control_adds_few_launches() {
    let iterations = launches(with_steps, 3);
    let counts: Vec<usize> = iterations.iter().map(Vec::len).collect();
    assert_eq!(counts[2], counts[1] + 1, "errors at the Gaussians");
    assert!(counts.iter().all(|count| *count <= 32), "{counts:?}");
    iterations.into_iter().for_each(check_work);
}

#[test]
fn exposure_compensation_adds_few_launches() {
    // It begins after a fifth of the run.
    let change = |config: &mut TrainConfig| {
        config.exposure = ExposureChoice::On;
        config.iterations = 50;
    };
    let iterations = launches(change, 12);
    let [first, last] = [&iterations[0], &iterations[11]].map(Vec::len);
    assert_eq!(last, first + 3, "{:?}", iterations[11]);
    iterations.into_iter().for_each(check_work);
}

/// Everything that adds launches to an iteration, all of it in the twelfth, with photos at half their size.
fn with_everything(config: &mut TrainConfig) {
    with_steps(config);
    config.iterations = 50;
    config.work.resolution_levels = 1;
}

#[test]
fn everything_at_once_has_no_more_launches_than_a_gpu_is_to_wait_for() {
    // Transparent photos have no exposure compensation.
    for (alpha, exposure, most) in [
        (Alpha::None, ExposureChoice::On, 35),
        (Alpha::Mask, ExposureChoice::On, 35),
        (Alpha::Transparency, ExposureChoice::Off, 32),
    ] {
        let change = |config: &mut TrainConfig| {
            with_everything(config);
            config.exposure = exposure;
        };
        let iterations = launches_over(alpha, true, change, 12);
        let counts: Vec<usize> = iterations.iter().map(Vec::len).collect();
        assert_eq!(counts[11], most, "errors, exposure and noise: {counts:?}");
        assert_eq!(counts.iter().max(), Some(&most), "{counts:?}");
        // They are made once for each photo, before the first iteration that is counted here.
        assert_eq!(made(&iterations), 0, "{alpha:?}");
        iterations.into_iter().for_each(check_work);
    }
}

/// The last view of a batch has one more, which takes the step, and every hundredth iteration with the 3D filter has three more.
#[test]
fn batches_and_filters_add_launches_to_few_iterations() {
    let batches = launches(|config| config.batch = 3, 3);
    let counts: Vec<usize> = batches.iter().map(Vec::len).collect();
    assert_eq!(counts, [30, 30, 31]);
    let filters = launches(|config| config.anti_aliasing = AntiAliasing::On, 2);
    let counts: Vec<usize> = filters.iter().map(Vec::len).collect();
    assert_eq!(counts, [33, 30]);
    batches.into_iter().chain(filters).for_each(check_work);
}

/// Samplers other than mh have one launch a view of their own.
#[test]
fn other_samplers_have_no_more_launches() {
    for sampler in [Sampler::Mcmc, Sampler::Adc] {
        let iterations = launches(|config| config.sampler = sampler, 2);
        let counts: Vec<usize> = iterations.iter().map(Vec::len).collect();
        assert_eq!(counts, [31, 31], "{sampler:?}");
        iterations.into_iter().for_each(check_work);
    }
}

/// Launches that make smaller photos or mark active tiles.
fn made(iterations: &[Launches]) -> usize {
    let once = |(name, _): &&(&str, usize)| ["shrink", "active_tiles"].contains(name);
    iterations.iter().flatten().filter(once).count()
}

#[test]
fn smaller_photos_without_room_in_the_budget_are_made_for_each_iteration() {
    let change = |config: &mut TrainConfig| config.work.resolution_levels = 1;
    let iterations = launches_over(Alpha::Mask, false, change, 3);
    assert_eq!(made(&iterations), 6, "{iterations:?}");
}
