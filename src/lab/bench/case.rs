//! One scene at one resolution: samples of whole iterations, split into stages.

use std::time::Instant;

use crate::base::error::Result;
use crate::base::process::process_cpu_seconds;
use crate::capture::Dataset;
use crate::config::AntiAliasing;
use crate::device::{CameraArg, Device, DeviceKind};
use crate::lab::bench::options::Options;
use crate::lab::bench::record::{Case, Iteration, Peak, Stage, spread};
use crate::lab::bench::scene;
use crate::lab::bench::scene::VIEWS;
use crate::lab::bench::work::{Load, STAGES, TileWork};
use crate::lab::stats::ratio;
use crate::pipeline::forward::{Quantity, RenderOptions};
use crate::scene::without_filter;
use crate::scene::{Gaussians, Plane};
use crate::train::{Plan, Trainer};

/// Most iterations of a sample: the clock of CPU time has ticks of 10 ms, which is little enough of a sample by then.
const MAX_ITERATIONS: u32 = 800;

/// Several iterations, timed. Seconds per iteration.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Sample {
    wall: f64,
    cpu: f64,
    stages: [f64; STAGES.len()],
}

fn stage_seconds(trainer: &Trainer) -> [f64; STAGES.len()] {
    let times = trainer.stage_times();
    STAGES.map(|stage| {
        let found = times.iter().find(|(name, _)| *name == stage);
        found.map_or(0.0, |(_, t)| t.seconds)
    })
}

fn sample(trainer: &mut Trainer, iterations: u32) -> Result<Sample> {
    let (before, cpu) = (stage_seconds(trainer), process_cpu_seconds());
    let start = Instant::now();
    trainer.advance_to(trainer.iteration() + iterations)?;
    let each = 1.0 / f64::from(iterations);
    let (wall, cpu) = (start.elapsed().as_secs_f64(), process_cpu_seconds() - cpu);
    let after = stage_seconds(trainer);
    Ok(Sample {
        wall: wall * each,
        cpu: cpu * each,
        stages: std::array::from_fn(|k| (after[k] - before[k]) * each),
    })
}

/// A scene to measure.
pub(super) struct Subject<'a> {
    pub name: &'a str,
    pub splats: &'a Gaussians,
    pub dataset: Dataset,
    /// True if the scene was trained with anti-aliasing and has to be rendered with its filters.
    pub anti_alias: bool,
}

impl Subject<'_> {
    /// `NAME, N Gaussians, W × H`.
    pub fn title(&self) -> String {
        let camera = &self.dataset.train[0].camera;
        let (n, w, h) = (self.splats.len(), camera.width, camera.height);
        format!("{}, {n} Gaussians, {w} × {h}", self.name)
    }
}

/// A trainer that changes nothing. Of a scene with anti-aliasing it takes the 3D filter out first, which training puts in again
/// by the views at hand: those of the bench, so that the filter is theirs and not the training views'.
fn trainer(device: &Device, subject: &Subject<'_>) -> Result<Trainer> {
    let mut config = scene::still(subject.splats.sh_degree());
    let unfiltered;
    let mut splats = subject.splats;
    if subject.anti_alias {
        config.anti_aliasing = AntiAliasing::On;
        unfiltered = without_filter(splats, &subject.dataset)?;
        splats = &unfiltered;
    }
    let plan = Plan::new(&subject.dataset, &config)?;
    let mut trainer = Trainer::new(device, &subject.dataset, &plan, splats)?;
    trainer.time_every_iteration();
    Ok(trainer)
}

/// Times every stage and the whole iteration.
pub(super) fn measure(
    device: &Device,
    peak: &Peak,
    subject: &Subject<'_>,
    options: &Options,
) -> Result<Case> {
    let idle = device.allocated_bytes();
    let mut trainer = trainer(device, subject)?;
    sample(&mut trainer, VIEWS)?;
    let warm = sample(&mut trainer, VIEWS)?;
    // Whole passes over the views: then every sample holds the same work.
    let passes = options.sample_seconds / (warm.wall * f64::from(VIEWS)).max(1e-9);
    let iterations = (VIEWS * passes.ceil().clamp(1.0, 1e4) as u32).min(MAX_ITERATIONS);
    let samples: Vec<Sample> = (0..options.samples)
        .map(|_| sample(&mut trainer, iterations))
        .collect::<Result<_>>()?;
    let bytes = device.allocated_bytes().saturating_sub(idle);
    let (load, work) = load(device, &mut trainer, subject)?;
    let camera = &subject.dataset.train[0].camera;
    let of = |figure: fn(&Sample) -> f64| spread("bench", samples.iter().map(figure));
    let on_cpu = device.info().kind == DeviceKind::Cpu;
    let rows = (0..STAGES.len()).map(|k| stage(k, &samples, &load, peak, on_cpu));
    Ok(Case {
        scene: subject.name.to_owned(),
        gaussians: subject.splats.len(),
        width: camera.width,
        height: camera.height,
        tuning: device.tuning(),
        pairs: load.pairs.round() as u64,
        stages: rows.collect::<Result<_>>()?,
        iteration: Iteration {
            ms: of(|s| 1e3 * s.wall)?,
            cpu_ms: of(|s| 1e3 * s.cpu)?,
            cores_busy: of(|s| s.cpu / s.wall)?,
            iterations,
            visible: load.visible.round() as u64,
            used_pairs: work,
            lanes: load.lanes.round() as u64,
            device_bytes: bytes,
            bytes_per_gaussian: bytes as f64 / subject.splats.len() as f64,
        },
    })
}

/// Means over the views, counted after the timing, and pairs looked at.
fn load(device: &Device, trainer: &mut Trainer, subject: &Subject<'_>) -> Result<(Load, u64)> {
    let tuning = device.tuning();
    let (scene, renderer) = trainer.scene_and_renderer()?;
    let options = RenderOptions {
        sh_degree: subject.splats.sh_degree(),
        background: [0.0; 3],
        quantity: Quantity::Color,
        active_only: false,
    };
    let views = &subject.dataset.train;
    let each = 1.0 / views.len() as f64;
    let (mut load, mut used) = (Load::default(), 0.0);
    for view in views {
        let camera = CameraArg::<f32>::new(&view.camera, tuning.tile);
        renderer.render(scene, &camera, &options)?;
        let work = TileWork::read(renderer)?;
        load.visible += each * work.visible as f64;
        load.pairs += each * work.pairs as f64;
        load.lanes += each * work.lanes(&tuning) as f64;
        used += each * work.used() as f64;
        load.tiles = camera.image().tile_count() as f64;
        [load.passes, load.pair_passes] = Load::passes(&tuning, load.tiles.round() as usize);
    }
    load.gaussians = scene.count as f64;
    load.planes = Plane::count(subject.splats.sh_degree()) as f64;
    load.pixels = load.tiles * tuning.tile_pixels() as f64;
    Ok((load, used.round() as u64))
}

/// Times of a stage and its rate beside the peak, by the clock of CPU time where the device is the CPU.
fn stage(k: usize, samples: &[Sample], load: &Load, peak: &Peak, on_cpu: bool) -> Result<Stage> {
    let name = STAGES[k];
    let of = |figure: &dyn Fn(&Sample) -> f64| spread(name, samples.iter().map(figure));
    let ms = of(&|s| 1e3 * s.stages[k])?;
    let cpu = of(&|s| 1e3 * s.stages[k] * s.cpu / s.wall)?;
    let core = peak.fma_core.filter(|_| on_cpu && cpu.min > 0.0);
    let (rate, best, unit) = match Load::flop_per_lane(name) {
        Some(flop) => {
            let cores = |s: &Sample| if core.is_some() { s.cpu / s.wall } else { 1.0 };
            let rate = of(&|s| load.lanes / (s.stages[k] * cores(s)))?;
            let best = core.unwrap_or(peak.fma).scaled(1e9 / flop);
            (rate, best, "lanes/core-s")
        }
        None => {
            let rate = of(&|s| load.bytes(name) / s.stages[k])?;
            (rate, peak.copy.scaled(1e9), "bytes/s")
        }
    };
    Ok(Stage {
        name,
        ms,
        cpu_ms: on_cpu.then_some(cpu),
        share: ratio(&rate, &best),
        rate,
        unit,
    })
}
