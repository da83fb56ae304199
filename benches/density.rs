//! The density step on the host: a million Gaussians counted, importance, about 20,000 proposals decided.
#![allow(missing_docs, clippy::unwrap_used)]

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};

use mhsplat::base::rng::{Philox, Stream};
use mhsplat::config::MhConfig;
use mhsplat::density::mh::MetropolisHastings;
use mhsplat::density::mh::importance::importance;
use mhsplat::density::mh::sparsity::VoxelCounts;
use mhsplat::density::relocation::split;
use mhsplat::density::{DensityControl, ErrorStatistics, SceneState, Statistics, StepContext};

const N: usize = 1_000_000;

fn plane(k: u64, scale: f64, shift: f64) -> Vec<f32> {
    let stream = Stream::Synthetic.stream(0) + k;
    (0..N as u64)
        .map(|i| (shift + scale * Philox::normal(1, stream, i)[0]) as f32)
        .collect()
}

fn density(c: &mut Criterion) {
    let positions = [0, 1, 2].map(|k| plane(k, 0.2, 0.0));
    let scales = [3, 4, 5].map(|k| plane(k, 0.5, -5.0));
    let rotations = [6, 7, 8, 9].map(|k| plane(k, 1.0, 0.0));
    // About one in 300 is dead at the start.
    let logits = plane(10, 2.0, 0.0);
    let planes = [11, 12].map(|k| plane(k, 1.0, 4.0));
    let views: Vec<u32> = (0..N as u32).map(|i| i % 4).collect();
    let scene = SceneState {
        positions: positions.each_ref().map(Vec::as_slice),
        log_scales: scales.each_ref().map(Vec::as_slice),
        rotations: rotations.each_ref().map(Vec::as_slice),
        opacity_logits: &logits,
    };
    let cues = ErrorStatistics {
        ssim: &planes[0],
        l1: &planes[1],
        views: &views,
    };
    let mut group = c.benchmark_group("density");
    group.sample_size(20);
    for edge in [0.02, 0.005] {
        group.bench_function(format!("count 1M, edge {edge}"), |b| {
            b.iter(|| VoxelCounts::count(black_box(scene.positions), edge).occupied());
        });
    }
    group.bench_function("importance 1M", |b| {
        b.iter(|| importance(black_box(&logits), &cues, [0.8, 0.5, 0.5]));
    });
    let context = StepContext::at(500, 0.0, 0);
    let errors = Statistics::Errors(cues);
    let mh = MetropolisHastings::new(&MhConfig::paper());
    // The difference of the two is what proposing and deciding costs.
    let still = MetropolisHastings::new(&MhConfig {
        coarse_proposals: 0,
        fine_proposals: 0,
        ..MhConfig::paper()
    });
    group.bench_function("whole step 1M, no draws", |b| {
        b.iter(|| {
            still
                .step(black_box(&context), &scene, &errors)
                .unwrap()
                .rows
        });
    });
    group.bench_function("whole step 1M, 20,500 draws", |b| {
        b.iter(|| mh.step(black_box(&context), &scene, &errors).unwrap().rows);
    });
    group.finish();
}

fn relocation(c: &mut Criterion) {
    let mut group = c.benchmark_group("relocation");
    group.bench_function("split, 3 copies", |b| {
        b.iter(|| split(black_box(0.3), black_box(3)));
    });
    group.bench_function("split, 1000 copies", |b| {
        b.iter(|| split(black_box(0.3), black_box(1000)));
    });
    group.finish();
}

criterion_group!(benches, density, relocation);
criterion_main!(benches);
