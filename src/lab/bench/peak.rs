//! The device's peak, measured in the same run as everything else.

use std::time::Instant;

use crate::base::error::Result;
use crate::base::process::process_cpu_seconds;
use crate::device::tuning::Tuning;
use crate::device::{Array, Defines, Device, DeviceKind, Kernels, Program};
use crate::lab::bench::options::Options;
use crate::lab::bench::record::{Peak as Record, spread};
use crate::lab::stats::Spread;
use crate::pipeline::stage::peak;

/// Bytes of each of the two arrays of the copy: far beyond the last level of any cache.
const COPY_BYTES: u64 = 256 << 20;
/// Lanes of a copy's vectors (and a block width that divides them), tried besides the device's own: compilers that run
/// several work-items in one vector do better with narrow ones.
const COPY_WIDTHS: [(u32, u32); 2] = [(1, 1), (4, 2)];
/// Factor and term of the multiply-adds; every value stays near 1.
const FACTORS: [f64; 2] = [0.999, 0.001];

/// Device seconds of the launches of `enqueue`, and CPU seconds of the process meanwhile.
fn time(device: &Device, enqueue: impl FnOnce() -> Result<()>) -> Result<[f64; 2]> {
    device.finish()?;
    let (cpu, start) = (process_cpu_seconds(), Instant::now());
    let times = device.timed(|| {
        enqueue()?;
        device.take_times(usize::MAX)
    })?;
    let wall = start.elapsed().as_secs_f64();
    let spent: f64 = times.values().map(|t| t.seconds).sum();
    // A driver without profiling counters: the wall clock is all there is.
    let spent = if spent > 0.0 { spent } else { wall };
    Ok([spent, process_cpu_seconds() - cpu])
}

/// Runs both micro-benchmarks.
pub(super) fn measure(device: &Device, options: &Options) -> Result<Record> {
    let own = device.tuning();
    let build = |tuning| Kernels::new(device, Defines::new(tuning)).build::<f32>("peak");
    let kernels = build(own)?;
    let (fma, fma_core) = fma(device, &kernels, options)?;
    let narrow = COPY_WIDTHS.map(|(vector_width, block_width)| {
        build(Tuning {
            vector_width,
            block_width,
            ..own
        })
    });
    let [one, four] = narrow;
    let copy = copy(device, [kernels, one?, four?], options.samples)?;
    Ok(Record {
        fma_gflops: fma.median,
        copy_gbs: copy.median,
        fma,
        copy,
        fma_core,
    })
}

/// 10⁹ FLOP per second of device time, and per second of CPU time if the device is the CPU.
fn fma(device: &Device, stage: &Program, options: &Options) -> Result<(Spread, Option<Spread>)> {
    let cpu = device.info().kind == DeviceKind::Cpu;
    let items = device.info().cores.max(1) as usize * if cpu { 16 } else { 2048 };
    let out = Array::<f32>::zeros(device, "peak", items * stage.lanes())?;
    let launch = |steps: u32| {
        time(device, || {
            peak::multiply_add(stage, items, steps, FACTORS, &out)
        })
    };
    launch(1)?;
    let mut steps = 1024u32;
    loop {
        let [seconds, _] = launch(steps)?;
        let missing = options.sample_seconds / seconds.max(1e-6);
        if missing < 1.5 || steps >= 1 << 28 {
            break;
        }
        steps = (f64::from(steps) * missing.min(16.0)) as u32;
    }
    let giga = peak::flop(stage, items, steps) * 1e-9;
    let times: Vec<[f64; 2]> = (0..options.samples)
        .map(|_| launch(steps))
        .collect::<Result<_>>()?;
    let rates = |k: usize| spread("peak", times.iter().map(move |t| giga / t[k]));
    Ok((rates(0)?, rates(1).ok().filter(|_| cpu)))
}

/// 10⁹ bytes read and written per second of device time, by the fastest of the kernels.
fn copy(device: &Device, kernels: [Program; 3], samples: usize) -> Result<Spread> {
    let info = device.info();
    let bytes = COPY_BYTES.min(info.max_alloc).min(info.global_memory / 8) as usize;
    let lanes = kernels.iter().map(Program::lanes).max().unwrap_or(1);
    let len = (bytes / size_of::<f32>()).next_multiple_of(lanes);
    let [from, to] = [
        Array::<f32>::zeros(device, "peak copy", len)?,
        Array::<f32>::zeros(device, "peak copy", len)?,
    ];
    let giga = 2.0 * (len * size_of::<f32>()) as f64 * 1e-9;
    let rate = |stage: &Program| {
        let launch = || time(device, || peak::copy(stage, &from, &to));
        launch()?;
        let times: Vec<[f64; 2]> = (0..samples).map(|_| launch()).collect::<Result<_>>()?;
        spread("peak", times.iter().map(|[seconds, _]| giga / seconds))
    };
    let [own, narrow @ ..] = &kernels;
    let mut best = rate(own)?;
    for kernel in narrow {
        let found = rate(kernel)?;
        if found.median > best.median {
            best = found;
        }
    }
    Ok(best)
}
