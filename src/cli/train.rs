//! `mhsplat train`.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use clap::ValueEnum;

use super::progress::{finish, progress_bar, show};
use super::{Common, Outcome, output, scene};
use mhsplat::base::error::{Error, Result};
use mhsplat::capture;
use mhsplat::capture::LoadOptions;
use mhsplat::config::{
    AntiAliasing, ExposureChoice, Sampler, Surrogate, TrainConfig, parse_bytes, parse_duration,
};
use mhsplat::device::Device;
use mhsplat::run::{Clock, Run, abandon_folder, claim_folder, saved_config};

#[derive(Clone, Copy, ValueEnum)]
enum SamplerFlag {
    /// Metropolis-Hastings births and relocation.
    Mh,
    /// Noise on the positions, relocation, 5 % growth per step up to a cap (3DGS-MCMC).
    Mcmc,
    /// Clone, split, prune, opacity reset (3DGS).
    Adc,
    /// A fixed set of Gaussians.
    None,
}

#[derive(Clone, Copy, ValueEnum)]
enum SurrogateFlag {
    /// The importance of its source.
    Importance,
    /// Its first-order change of the loss, computed over a few views.
    Probe,
}

#[derive(Clone, Copy, ValueEnum)]
enum AntiAliasingFlag {
    /// On where the training views' sampling rates differ much.
    Auto,
    /// Mip-Splatting's 2D and 3D filters.
    On,
    /// Neither filter.
    Off,
}

#[derive(Clone, Copy, ValueEnum)]
enum ExposureFlag {
    /// On if photos differ in brightness by more than what they show.
    Auto,
    /// A colour transform for every training photo.
    On,
    /// None.
    Off,
}

/// Arguments; every one also has its place in a --config file, and wins over it.
#[derive(clap::Args)]
pub struct TrainArgs {
    /// Folder with images/ and sparse/0/, or with transforms_train.json or transforms.json.
    dataset: PathBuf,
    /// Run folder; must not exist [default: run]
    #[arg(short, long, value_name = "RUN")]
    output: Option<PathBuf>,
    /// Density control [default: mh]
    #[arg(long, value_enum)]
    sampler: Option<SamplerFlag>,
    /// What a birth of the mh sampler is judged by [default: importance]
    #[arg(long, value_enum)]
    surrogate: Option<SurrogateFlag>,
    /// Iterations; every schedule scales with it [default: 30000]
    #[arg(long, value_name = "N")]
    iterations: Option<u32>,
    /// Stop after this much training (90s, 10m, 1h30m).
    #[arg(long, value_name = "TIME")]
    time_budget: Option<String>,
    /// Stop when N evaluations in a row found the training loss no lower [default: never]
    #[arg(long, value_name = "N")]
    patience: Option<u32>,
    /// Longest image side, pixels [default: 1600]
    #[arg(long, value_name = "PX")]
    max_size: Option<u32>,
    /// Memory for decoded photos (512M, 4G, bytes); the rest is decoded on demand [default: half of what is available]
    #[arg(long, value_name = "BYTES")]
    image_budget: Option<String>,
    /// Upper bound of the number of Gaussians, for any sampler [default: none; mcmc: 1000000]
    #[arg(long, value_name = "N")]
    max_gaussians: Option<usize>,
    /// SH degree, 0 to 3 [default: 3]
    #[arg(long, value_name = "D")]
    sh_degree: Option<u32>,
    /// Seed of every random number [default: 0]
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Iterations between evaluations; 0 for the end only [default: a twentieth of the run]
    #[arg(long, value_name = "N")]
    eval_every: Option<u32>,
    /// Every n-th image by name is held out; 0 for none [default: 8]
    #[arg(long, value_name = "N")]
    test_every: Option<u32>,
    /// Iterations between exports of scene.ply; 0 for the end only [default: 0]
    #[arg(long, value_name = "N")]
    export_every: Option<u32>,
    /// Iterations between checkpoints [default: 1000]
    #[arg(long, value_name = "N")]
    checkpoint_every: Option<u32>,
    /// Continue the run in this folder from its checkpoint, as it was configured.
    #[arg(long, value_name = "RUN", conflicts_with_all = [
        "output", "config", "sampler", "surrogate", "iterations", "max_size", "max_gaussians", "sh_degree", "seed",
        "test_every", "init", "background", "alpha_is_mask", "anti_aliasing", "exposure",
    ])]
    resume: Option<PathBuf>,
    /// points, random or FILE.ply: Gaussians or a point cloud, in the dataset's frame [default: points]
    #[arg(long)]
    init: Option<String>,
    /// Take the photos' alpha for a mask of what counts, not for transparency.
    #[arg(long)]
    alpha_is_mask: bool,
    /// black, white, R,G,B, random (another colour in each iteration, scored over black), or auto: random where photos are
    /// transparent, black where not [default: auto]
    #[arg(long)]
    background: Option<String>,
    /// Filters for things seen from near and far, and for views of other sizes than those trained on [default: auto]
    #[arg(long, value_enum)]
    anti_aliasing: Option<AntiAliasingFlag>,
    /// A colour transform for every training photo, for sets whose brightness varies [default: auto]
    #[arg(long, value_enum)]
    exposure: Option<ExposureFlag>,
    /// TOML file (or a run's run.json) with the same names; flags win.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Stop as on Ctrl-C when stdin ends: how a program that started this one stops it on any system.
    #[arg(long, hide = true)]
    until_stdin_ends: bool,
    /// Exit with 1 unless the mean held-out PSNR reaches this, dB.
    #[arg(long, value_name = "DB", value_parser = output::finite)]
    require_psnr: Option<f64>,
}

/// Trains, showing progress on stderr.
pub fn run(args: &TrainArgs, common: &Common) -> Result<Outcome> {
    let config = config(args)?;
    config.validate()?;
    let dir = match (&args.resume, &args.output) {
        (Some(dir), _) | (None, Some(dir)) => dir.clone(),
        (None, None) => PathBuf::from("run"),
    };
    // Before the device: some drivers' compilers set handlers that end the process, and whoever comes first is asked last.
    let stop = stop_flag()?;
    if args.until_stdin_ends {
        let stop = stop.clone();
        std::thread::spawn(move || {
            let _ = std::io::copy(&mut std::io::stdin(), &mut std::io::sink());
            stop.store(true, Ordering::Relaxed);
        });
    }
    let device = super::open_tested(common.device.as_deref())?;
    if args.resume.is_none() {
        claim_folder(&dir)?;
    }
    let mut run = match prepare(args, &dir, config, &device) {
        Ok(run) => run,
        Err(error) => {
            if args.resume.is_none() {
                abandon_folder(&dir);
            }
            return Err(error);
        }
    };
    output::note(&format!(
        "device: {} ({})",
        device.info().name,
        device.info().platform
    ));
    output::note(&run.record().plan.summary());
    let planned = run.record().plan.clone();
    let bar = progress_bar();
    let driven = run.drive(&stop, |p| show(&bar, p)).map(|_| ());
    bar.finish();
    let stopped = matches!(driven, Err(Error::Interrupted));
    if driven.is_err() {
        note_resume(run.saved(), &args.dataset, &dir, stopped);
    }
    if stopped && common.json {
        output::json(run.record())?;
    }
    driven?;
    let record = run.record();
    if let Some(found) = record.plan.since(&planned) {
        output::note(&found);
    }
    finish(record, &dir, common)?;
    let psnr = record.final_scores.as_ref().map(|f| f.psnr);
    Ok(Outcome::of(args.require_psnr, psnr))
}

/// How a run that ended early goes on.
fn note_resume(saved: Option<u32>, dataset: &Path, dir: &Path, stopped: bool) {
    let what = match saved {
        Some(done) if stopped => format!("stopped after {done} iterations; continue with"),
        Some(done) => format!(
            "the state after {done} iterations is saved; when the cause is mended, continue with"
        ),
        None if dir.join("scene.ply").exists() => {
            output::note("no state is saved to go on from; begin anew with -o NEW_FOLDER");
            return;
        }
        None => "nothing is saved yet; when the cause is mended, begin again with".into(),
    };
    let (dataset, dir) = (dataset.display(), dir.display());
    output::note(&format!("{what}: mhsplat train {dataset} --resume {dir}"));
}

fn prepare(args: &TrainArgs, dir: &Path, config: TrainConfig, device: &Device) -> Result<Run> {
    let clock = Clock::start();
    let options = LoadOptions {
        max_size: config.max_size,
        test_every: config.test_every,
        image_budget: config.image_budget,
        alpha_is_mask: config.alpha_is_mask,
    };
    let data = capture::load(&args.dataset, &options)?;
    output::note(&format!(
        "{}: {} training views, {} held out, {} points",
        args.dataset.display(),
        data.train.len(),
        data.test.len(),
        data.points.positions.len()
    ));
    scene::note_left_out(&data);
    if args.resume.is_some() {
        Run::resume(dir, data, config, device, clock)
    } else {
        Run::start(dir, data, config, device, clock)
    }
}

/// Sets a flag on Ctrl-C or SIGTERM; a second signal ends the program at once.
pub fn stop_flag() -> Result<Arc<AtomicBool>> {
    use signal_hook::consts::{SIGINT, SIGTERM};
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        let fail = |e| Error::io("signal handler", e);
        signal_hook::flag::register_conditional_shutdown(signal, 130, stop.clone())
            .map_err(fail)?;
        signal_hook::flag::register(signal, stop.clone()).map_err(fail)?;
    }
    Ok(stop)
}

fn config(args: &TrainArgs) -> Result<TrainConfig> {
    let mut c = match (&args.resume, &args.config) {
        (Some(run), _) => saved_config(run)?,
        (None, Some(file)) => read_config(file)?,
        (None, None) => TrainConfig::default(),
    };
    macro_rules! take {
        ($($name:ident),*) => { $(if let Some(v) = args.$name { c.$name = v; })* };
    }
    take!(
        iterations,
        max_size,
        sh_degree,
        seed,
        test_every,
        export_every,
        checkpoint_every
    );
    choices(args, &mut c);
    if let Some(t) = &args.time_budget {
        c.time_budget = Some(parse_duration(t)?);
    }
    if let Some(b) = &args.image_budget {
        c.image_budget = Some(parse_bytes(b)?);
    }
    c.alpha_is_mask |= args.alpha_is_mask;
    c.patience = args.patience.or(c.patience);
    c.max_gaussians = args.max_gaussians.or(c.max_gaussians);
    c.eval_every = args.eval_every.or(c.eval_every);
    if let Some(init) = &args.init {
        c.init = init.parse()?;
    }
    if let Some(background) = &args.background {
        c.background = background.parse()?;
    }
    Ok(c)
}

/// The options that are one of a few names.
fn choices(args: &TrainArgs, c: &mut TrainConfig) {
    if let Some(s) = args.sampler {
        c.sampler = match s {
            SamplerFlag::Mh => Sampler::Mh,
            SamplerFlag::Mcmc => Sampler::Mcmc,
            SamplerFlag::Adc => Sampler::Adc,
            SamplerFlag::None => Sampler::None,
        };
    }
    if let Some(s) = args.surrogate {
        c.mh.surrogate = match s {
            SurrogateFlag::Importance => Surrogate::Importance,
            SurrogateFlag::Probe => Surrogate::Probe,
        };
    }
    if let Some(a) = args.anti_aliasing {
        c.anti_aliasing = match a {
            AntiAliasingFlag::Auto => AntiAliasing::Auto,
            AntiAliasingFlag::On => AntiAliasing::On,
            AntiAliasingFlag::Off => AntiAliasing::Off,
        };
    }
    if let Some(e) = args.exposure {
        c.exposure = match e {
            ExposureFlag::Auto => ExposureChoice::Auto,
            ExposureFlag::On => ExposureChoice::On,
            ExposureFlag::Off => ExposureChoice::Off,
        };
    }
}

fn read_config(file: &Path) -> Result<TrainConfig> {
    let text = std::fs::read_to_string(file).map_err(|e| Error::io(file, e))?;
    let wrong = |what: String| {
        Error::input(
            file,
            what.trim().replace('\n', " "),
            "see `mhsplat train --help` for the names",
        )
    };
    if file.extension().is_some_and(|e| e == "json") {
        let value: serde_json::Value =
            serde_json::from_str(&text).map_err(|e| wrong(e.to_string()))?;
        let inner = value.get("config").cloned().unwrap_or(value);
        return serde_json::from_value(inner).map_err(|e| wrong(e.to_string()));
    }
    toml::from_str(&text).map_err(|e| wrong(e.to_string()))
}
