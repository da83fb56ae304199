//! Every stage and a whole iteration, N Gaussians × resolution: `cargo bench --bench stages`.
//!
//! Stage times are the device's own profiling counters, summed over the iterations of a sample; the whole iteration is the
//! wall clock around enqueueing and settling them.
#![allow(missing_docs, clippy::unwrap_used)]

use std::time::{Duration, Instant};

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};

use mhsplat::Plan;
use mhsplat::lab::bench::{STAGES, scene};
use mhsplat::{Device, Trainer};

fn seconds_of(trainer: &Trainer, stage: &str) -> f64 {
    let times = trainer.stage_times();
    let found = times.iter().find(|(name, _)| *name == stage);
    found.map_or(0.0, |(_, t)| t.seconds)
}

fn run(trainer: &mut Trainer, iterations: u64) -> Duration {
    let start = Instant::now();
    let until = trainer.iteration() + iterations as u32;
    trainer.advance_to(until).unwrap();
    start.elapsed()
}

fn stages(c: &mut Criterion) {
    let device = Device::open(None).unwrap();
    for (n, size) in [(10_000, 400), (100_000, 400), (100_000, 800)] {
        let data = scene::dataset(&scene::circle(size));
        let config = scene::still(scene::SH_DEGREE);
        let mut trainer = Trainer::new(
            &device,
            &data,
            &Plan::new(&data, &config).unwrap(),
            &scene::cloud(n),
        )
        .unwrap();
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

criterion_group!(benches, stages);
criterion_main!(benches);
