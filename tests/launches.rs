//! Launches of an iteration on a GPU: how many there are, and with how many work-items.

use crate::determinism::room;
use mhsplat::capture::{Alpha, Photo};
use mhsplat::config::{Sampler, TrainConfig};
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
    // Two numbers of each tile and channel, 20,000 in all.
    ("loss_sum", 256),
    // Runs of chunks of eight bins for each group: 128 or 256 bins of a digit.
    ("sort_totals", 4096),
    // One for each of 6700 tiles.
    ("bin_ranges", 6700),
];

/// Launches of each of some iterations with a million Gaussians, all behind the camera so that little is computed.
fn iterations(change: impl Fn(&mut TrainConfig), count: usize) -> Vec<Vec<(&'static str, usize)>> {
    let device = Device::open(None).unwrap().with_tuning(Tuning::GPU);
    let mut data = room(64);
    let mut view = data.train[0].clone();
    let [width, height] = SIZE;
    view.camera = view.camera.scaled_to(width, height);
    view.photo = Photo {
        width,
        height,
        alpha: Alpha::None,
        data: vec![128; 3 * (width * height) as usize],
    }
    .into();
    let behind = view.camera.center() - view.camera.rotation.row(2);
    data.train = vec![view];
    let mut planes = vec![vec![0.0; GAUSSIANS]; 11 + 3];
    for (plane, x) in planes.iter_mut().zip(behind.to_array()) {
        plane.fill(x as f32);
    }
    planes[3..6].iter_mut().for_each(|plane| plane.fill(-8.0));
    planes[6].fill(1.0);
    let mut config = TrainConfig {
        sampler: Sampler::None,
        sh_degree: 0,
        ..TrainConfig::default()
    };
    config.work.resolution_levels = 0;
    change(&mut config);
    let plan = Plan::new(&data, &config).unwrap();
    let splats = Gaussians::new(0, planes).unwrap();
    let mut trainer = Trainer::new(&device, &data, &plan, &splats).unwrap();
    trainer.time_every_iteration();
    let each = (0..count).map(|_| {
        assert!(matches!(
            trainer.advance().unwrap(),
            Event::Iteration { .. }
        ));
        // Those of iterations before may be there still.
        let mut enqueued = device.enqueued();
        let first = enqueued
            .iter()
            .rposition(|(kernel, _)| *kernel == "project");
        enqueued.split_off(first.unwrap())
    });
    let each = each.collect();
    trainer.settle().unwrap();
    each
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
    let launches = iterations(|_| (), 1).remove(0);
    assert!(launches.len() > 20 && launches.len() <= 35, "{launches:?}");
    check_work(launches);
}

#[test]
fn density_control_adds_few_launches() {
    // A step after the third iteration, for which that one gathers the errors of its view.
    let change = |config: &mut TrainConfig| {
        config.sampler = Sampler::Mh;
        (config.mh.from_iteration, config.mh.interval) = (3, 3);
        config.mh.births_from_iteration = Some(0);
        config.max_gaussians = Some(2 * GAUSSIANS);
    };
    let each = iterations(change, 3);
    let counts: Vec<usize> = each.iter().map(Vec::len).collect();
    assert!(counts[1] <= 35, "{counts:?}");
    assert_eq!(
        counts[2],
        counts[1] + 2,
        "errors of all channels at once, and their sums"
    );
    each.into_iter().for_each(check_work);
}
