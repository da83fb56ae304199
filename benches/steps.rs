//! Cost of density steps within training: `cargo bench --bench steps [-- GAUSSIANS PIXELS STEPS]`.
//!
//! Trains the synthetic cloud with learning rates of zero, so that every step finds about as many Gaussians, and prints for each density
//! step how long `Trainer::advance` took for it, how much of that no kernel ran (transfers included), how long the decision on the host
//! took, the CPU time of the process meanwhile, and the Gaussians after it. By default 100,000 Gaussians, then a million, at 800 pixels.
#![allow(clippy::unwrap_used, clippy::print_stdout, missing_docs)]

use std::time::Instant;

use mhsplat::base::process::process_cpu_seconds;
use mhsplat::config::Sampler;
use mhsplat::lab::bench::scene;
use mhsplat::train::Event;
use mhsplat::{Device, Plan, TrainConfig, Trainer};

/// Iterations for which the schedules are made: a density step every 25.
const LENGTH: u32 = 600;

fn main() {
    let args: Vec<usize> = std::env::args()
        .skip(1)
        .filter_map(|a| a.parse().ok())
        .collect();
    let sizes = match args.first() {
        Some(n) => vec![*n],
        None => vec![100_000, 1_000_000],
    };
    let (pixels, steps) = (args.get(1).copied().unwrap_or(800), args.get(2).copied());
    for gaussians in sizes {
        measure(gaussians, pixels as u32, steps.unwrap_or(4));
    }
}

fn measure(gaussians: usize, pixels: u32, steps: usize) {
    let device = Device::open(None).unwrap();
    let data = scene::dataset(&scene::circle(pixels));
    let config = TrainConfig {
        sampler: Sampler::Mh,
        iterations: LENGTH,
        max_size: pixels,
        eval_every: Some(0),
        ..scene::still(scene::SH_DEGREE)
    };
    let plan = Plan::new(&data, &config).unwrap();
    let splats = scene::cloud(gaussians);
    let mut trainer = Trainer::new(&device, &data, &plan, &splats).unwrap();
    println!("{gaussians} Gaussians, {pixels} pixels");
    let mut done = 0;
    let mut iterations: Vec<f64> = Vec::new();
    while done < steps {
        if trainer
            .schedule()
            .density_due(trainer.iteration())
            .is_some()
        {
            // The iterations under way are none of the step's time.
            trainer.settle().unwrap();
        }
        let (decided, idle) = (trainer.decision_time().seconds, idle_seconds(&trainer));
        let (start, cpu) = (Instant::now(), process_cpu_seconds());
        let event = trainer.advance().unwrap();
        let (wall, cpu) = (start.elapsed().as_secs_f64(), process_cpu_seconds() - cpu);
        match event {
            Event::Density(event) => {
                done += 1;
                println!(
                    "  step at {}: {:.1} ms, no kernel in {:.1}, decided in {:.1}; {:.1} CPU ms, {} Gaussians",
                    event.iteration,
                    1e3 * wall,
                    1e3 * (idle_seconds(&trainer) - idle),
                    1e3 * (trainer.decision_time().seconds - decided),
                    1e3 * cpu,
                    event.gaussians
                );
            }
            _ => iterations.push(wall),
        }
    }
    iterations.sort_by(f64::total_cmp);
    println!(
        "  median iteration: {:.1} ms",
        1e3 * iterations[iterations.len() / 2]
    );
}

/// Time of density steps so far in which no kernel ran, seconds.
fn idle_seconds(trainer: &Trainer) -> f64 {
    let times = trainer.stage_times();
    let mut steps = times.iter().filter(|(stage, _)| *stage == "density");
    steps.next().map_or(0.0, |(_, time)| time.seconds)
}
