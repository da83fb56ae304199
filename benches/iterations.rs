//! How even the iterations are: `cargo bench --bench iterations [-- DATASET MAX_SIZE ITERATIONS]`.
//!
//! Prints quantiles of the time between two returns of `Trainer::advance`, after the first 100 iterations and without those
//! next to a density step, and the slowest ones with what happened there. The bundled scene is the default.
#![allow(clippy::unwrap_used, clippy::print_stdout, missing_docs)]

use std::path::PathBuf;
use std::time::Instant;

use mhsplat::Plan;
use mhsplat::run::initial_gaussians;
use mhsplat::train::Event;
use mhsplat::{Device, LoadOptions, TrainConfig, Trainer, load_dataset};

fn main() {
    let args: Vec<String> = std::env::args()
        .skip(1)
        .filter(|a| !a.starts_with("--"))
        .collect();
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    let path = args
        .first()
        .map_or(root.join("data/room-tiny"), PathBuf::from);
    let number = |k: usize, or: u32| args.get(k).map_or(or, |v| v.parse().unwrap());
    let (max_size, iterations) = (number(1, 256), number(2, 1500));
    let data = load_dataset(
        &path,
        &LoadOptions {
            max_size,
            ..LoadOptions::default()
        },
    )
    .unwrap();
    let config = TrainConfig {
        iterations,
        max_size,
        ..TrainConfig::default()
    };
    let device = Device::open(None).unwrap();
    let splats = initial_gaussians(&data, &Plan::new(&data, &config).unwrap()).unwrap();
    let mut trainer =
        Trainer::new(&device, &data, &Plan::new(&data, &config).unwrap(), &splats).unwrap();
    let times = measure(&mut trainer, iterations);
    print(times, &trainer);
}

/// Seconds, iteration and what happened, of every iteration that counts.
fn measure(trainer: &mut Trainer, iterations: u32) -> Vec<(f64, u32, &'static str)> {
    let mut times: Vec<(f64, u32, &str)> = Vec::new();
    let mut quiet = 0;
    while trainer.iteration() < iterations {
        let (at, overflows) = (trainer.iteration(), trainer.overflows());
        let start = Instant::now();
        let event = trainer.advance().unwrap();
        let seconds = start.elapsed().as_secs_f64();
        // The queue holds two iterations: the first returns after a density step say nothing of their own.
        quiet = match event {
            Event::Iteration { .. } => quiet + 1,
            _ => 0,
        };
        let every = trainer.schedule().sh_interval(0);
        let sh = at > 0 && at.is_multiple_of(every);
        let what = match (trainer.overflows() > overflows, sh) {
            (true, _) => "tile intersections overflowed",
            (_, true) => "a band of spherical harmonics came",
            _ => "",
        };
        if at >= 100 && quiet > 3 {
            times.push((seconds, at, what));
        }
    }
    times
}

fn print(mut times: Vec<(f64, u32, &str)>, trainer: &Trainer) {
    times.sort_by(|a, b| a.0.total_cmp(&b.0));
    let at = |q: f64| times[((times.len() - 1) as f64 * q) as usize].0 * 1e3;
    println!(
        "{} iterations, {} Gaussians at the end: median {:.2} ms, 95 % {:.2}, 99 % {:.2}, slowest {:.2} ({:.2} x median), {} overflows",
        times.len(),
        trainer.gaussians(),
        at(0.5),
        at(0.95),
        at(0.99),
        at(1.0),
        at(1.0) / at(0.5),
        trainer.overflows()
    );
    for (seconds, iteration, what) in times.iter().rev().take(5) {
        println!("  {:.2} ms at iteration {iteration} {what}", seconds * 1e3);
    }
}
