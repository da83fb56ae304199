//! Does a long-lived process stay as it is? `cargo bench --bench soak`, three minutes; MHSPLAT_SOAK=7200 for two hours.
//!
//! Cycles of train, evaluate, stop, resume and finish, in one process on one device, with scenes that grow and shrink. Prints
//! resident memory, bytes on the device and milliseconds of CPU time per iteration of each cycle, and what the last cycles are over
//! early ones.
#![allow(clippy::unwrap_used, clippy::print_stdout, missing_docs)]

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use mhsplat::base::process::process_cpu_seconds;
use mhsplat::config::Sampler;
use mhsplat::run::{Clock, Run, saved_config};
use mhsplat::{Device, LoadOptions, TrainConfig, load_dataset};

const ITERATIONS: u32 = 300;
/// Cycles after which samplers and caps come round.
const ROUND: usize = 12;

/// One cycle's figures.
struct Cycle {
    resident: f64,
    device: f64,
    milliseconds: f64,
}

/// Resident memory, MiB.
fn resident() -> f64 {
    let text = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    let pages: f64 = text
        .split_ascii_whitespace()
        .nth(1)
        .and_then(|p| p.parse().ok())
        .unwrap_or(0.0);
    pages * 4096.0 / f64::from(1 << 20)
}

fn cycle(device: &Device, dir: &Path, number: u64) -> Cycle {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("data/room-tiny");
    let samplers = [Sampler::Mh, Sampler::Mcmc, Sampler::Adc, Sampler::None];
    let config = TrainConfig {
        sampler: samplers[(number % 4) as usize],
        iterations: ITERATIONS,
        max_size: 96,
        seed: 1,
        max_gaussians: Some([6000, 20_000, 3000][(number % 3) as usize]),
        checkpoint_every: 100,
        ..TrainConfig::default()
    };
    let load = || {
        let options = LoadOptions {
            max_size: config.max_size,
            ..LoadOptions::default()
        };
        load_dataset(&root, &options).unwrap()
    };
    let run_dir = dir.join(format!("{number}"));
    std::fs::create_dir(&run_dir).unwrap();
    let mut first = Run::start(&run_dir, load(), config.clone(), device, Clock::start()).unwrap();
    let stop = AtomicBool::new(false);
    let stopped = first.drive(&stop, |p| {
        if p.iteration >= ITERATIONS / 2 {
            stop.store(true, std::sync::atomic::Ordering::Relaxed);
        }
    });
    assert!(stopped.is_err());
    drop(first);
    let config = saved_config(&run_dir).unwrap();
    let mut second = Run::resume(&run_dir, load(), config, device, Clock::start(), None).unwrap();
    let began = process_cpu_seconds();
    second.drive(&AtomicBool::new(false), |_| {}).unwrap();
    let milliseconds = 1e3 * (process_cpu_seconds() - began) / f64::from(ITERATIONS / 2);
    let bytes = device.allocated_bytes() as f64 / f64::from(1 << 20);
    drop(second);
    std::fs::remove_dir_all(&run_dir).unwrap();
    Cycle {
        resident: resident(),
        device: bytes,
        milliseconds,
    }
}

fn main() {
    let seconds: f64 = std::env::var("MHSPLAT_SOAK").map_or(180.0, |s| s.parse().unwrap());
    let device = Device::open(None).unwrap();
    let dir = std::env::temp_dir().join(format!("mhsplat-soak-{}", std::process::id()));
    std::fs::create_dir_all(&dir).unwrap();
    let began = Instant::now();
    let mut cycles = Vec::new();
    while began.elapsed().as_secs_f64() < seconds
        || cycles.len() < 3 * ROUND
        || !cycles.len().is_multiple_of(ROUND)
    {
        let c = cycle(&device, &dir, cycles.len() as u64);
        println!(
            "cycle {:4}: {:7.1} MiB resident, {:6.1} MiB on the device, {:6.2} CPU ms per iteration",
            cycles.len(),
            c.resident,
            c.device,
            c.milliseconds
        );
        cycles.push(c);
    }
    std::fs::remove_dir_all(&dir).unwrap();
    let left = device.allocated_bytes();
    // Whole rounds, so that like is set beside like; the first is the process warming up.
    let part = (cycles.len() / 3 / ROUND).max(1) * ROUND;
    let early = &cycles[ROUND..ROUND + part];
    let late = &cycles[cycles.len() - part..];
    let ratio = |of: &dyn Fn(&Cycle) -> f64| {
        let mut parts = [early, late].map(|part| part.iter().map(of).collect::<Vec<f64>>());
        for part in &mut parts {
            part.sort_by(f64::total_cmp);
        }
        let [a, b] = parts.map(|part| part[part.len() / 2]);
        b / a
    };
    println!(
        "{} cycles in {:.0} s; last third over what followed the first round, medians: resident {:.3}, device {:.3}, time per iteration {:.3}; {left} bytes left on the device",
        cycles.len(),
        began.elapsed().as_secs_f64(),
        ratio(&|c| c.resident),
        ratio(&|c| c.device),
        ratio(&|c| c.milliseconds)
    );
}
