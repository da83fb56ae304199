//! Every stage and a whole iteration, N Gaussians × resolution: `cargo bench --bench stages`.
//!
//! Stage times are the device's own profiling counters, summed over the iterations of a sample; the whole iteration is the
//! wall clock around enqueueing and settling them.
#![allow(missing_docs, clippy::unwrap_used)]

use std::path::PathBuf;
use std::time::{Duration, Instant};

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use glam::{DMat3, DVec3};
use mhsplat::config::Sampler;
use mhsplat::dataset::{Frame, Layout, Photo, Points};
use mhsplat::model::{Plane, Splats};
use mhsplat::rng::{Philox, Purpose};
use mhsplat::{Camera, Dataset, Device, TrainConfig, Trainer, View};

const STAGES: [&str; 9] = [
    "project",
    "bin",
    "scan",
    "sort",
    "splat",
    "loss",
    "splat_grad",
    "project_grad",
    "adam",
];

fn uniform(i: usize, what: u64) -> [f64; 4] {
    Philox::uniform(7, Purpose::Synthetic.stream(1), (i as u64) << 4 | what)
}

/// Gaussians in a unit cube, their size falling with their number so that each touches about three tiles.
fn cloud(n: usize) -> Splats {
    let mut s = Splats::zeros(3, n);
    let scale = (0.35 / (n as f64).sqrt()).ln();
    for i in 0..n {
        let [x, y, z, opacity] = uniform(i, 0);
        let size = uniform(i, 1);
        s.scatter(Plane::POSITION, i, [x, y, z].map(|v| (v - 0.5) as f32));
        s.scatter(
            Plane::LOG_SCALE,
            i,
            [0, 1, 2].map(|k| (scale + 1.5 * (size[k] - 0.5)) as f32),
        );
        s.scatter(Plane::ROTATION, i, uniform(i, 2).map(|v| (v - 0.5) as f32));
        s.scatter(Plane::OPACITY, i, [(6.0 * opacity - 3.0) as f32]);
        for p in Plane::SH..Plane::count(3) {
            s.scatter(p, i, [(uniform(i, 3)[p % 4] - 0.5) as f32]);
        }
    }
    s
}

/// Eight views from a circle around the cube.
fn dataset(size: u32) -> Dataset {
    let view = |k: u32| {
        let angle = f64::from(k) * std::f64::consts::TAU / 8.0;
        let eye = 1.4 * DVec3::new(angle.cos(), 0.2, angle.sin());
        let z = -eye.normalize();
        let x = DVec3::Y.cross(z).normalize();
        let rotation = DMat3::from_cols(x, z.cross(x), z).transpose();
        let pixels = 3 * (size * size) as usize;
        View {
            name: format!("{k}"),
            camera: Camera {
                rotation,
                translation: -(rotation * eye),
                fx: f64::from(size),
                fy: f64::from(size),
                cx: f64::from(size) / 2.0,
                cy: f64::from(size) / 2.0,
                width: size,
                height: size,
            },
            photo: Photo {
                width: size,
                height: size,
                channels: 3,
                data: (0..pixels).map(|i| (i * 31 % 251) as u8).collect(),
            }
            .into(),
        }
    };
    Dataset {
        path: PathBuf::new(),
        layout: Layout::Transforms,
        train: (0..8).map(view).collect(),
        test: Vec::new(),
        points: Points::default(),
        frame: Frame::IDENTITY,
        image_budget: u64::MAX,
    }
}

fn seconds_of(trainer: &Trainer, stage: &str) -> f64 {
    let times = trainer.stage_times();
    let found = times.iter().find(|(name, _)| *name == stage);
    found.map_or(0.0, |(_, t)| t.seconds)
}

fn run(trainer: &mut Trainer, iterations: u64) -> Duration {
    let start = Instant::now();
    for _ in 0..iterations {
        trainer.step().unwrap();
    }
    trainer.settle().unwrap();
    start.elapsed()
}

fn stages(c: &mut Criterion) {
    let device = Device::open(None).unwrap();
    for (n, size) in [(10_000, 400), (100_000, 400), (100_000, 800)] {
        let data = dataset(size);
        let config = TrainConfig {
            // Rates of zero: the scene that is timed stays the same.
            optimizer: still(),
            sampler: Sampler::None,
            ..TrainConfig::default()
        };
        let mut trainer = Trainer::new(&device, &data, &config, &cloud(n)).unwrap();
        let mut group = c.benchmark_group(format!("{n} Gaussians, {size}x{size}"));
        group.sample_size(10).warm_up_time(Duration::from_secs(1));
        group.bench_function(BenchmarkId::from_parameter("iteration"), |b| {
            b.iter_custom(|iterations| run(&mut trainer, iterations));
        });
        for stage in STAGES {
            group.bench_function(BenchmarkId::from_parameter(stage), |b| {
                b.iter_custom(|iterations| {
                    let before = seconds_of(&trainer, stage);
                    run(&mut trainer, iterations);
                    Duration::from_secs_f64(seconds_of(&trainer, stage) - before)
                });
            });
        }
        group.finish();
    }
}

/// An optimiser that does its work and changes nothing, with every SH band from the start.
fn still() -> mhsplat::config::OptimizerConfig {
    mhsplat::config::OptimizerConfig {
        lr_position: 0.0,
        lr_position_final: 0.0,
        lr_sh0: 0.0,
        lr_sh: 0.0,
        lr_opacity: 0.0,
        lr_scale: 0.0,
        lr_rotation: 0.0,
        sh_interval: 0,
        ..Default::default()
    }
}

criterion_group!(benches, stages);
criterion_main!(benches);
