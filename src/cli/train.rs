//! `mhsplat train`.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressStyle};
use mhsplat::config::{
    ExposureChoice, Sampler, Surrogate, TrainConfig, parse_bytes, parse_duration,
};
use mhsplat::dataset::{self, LoadOptions};
use mhsplat::error::{Error, Result};
use mhsplat::gpu::Device;
use mhsplat::report::{Clock, RunRecord};
use mhsplat::run::{Progress, Run, abandon_folder, claim_folder, saved_config};

use super::{Common, Outcome, output};

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
        "test_every", "init", "background", "exposure",
    ])]
    resume: Option<PathBuf>,
    /// points, random or FILE.ply [default: points]
    #[arg(long)]
    init: Option<String>,
    /// black, white, random or R,G,B [default: black]
    #[arg(long)]
    background: Option<String>,
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
    let bar = progress_bar();
    let mut told = false;
    let driven = run.drive(&stop, |p| show(&bar, p, &mut told)).map(|_| ());
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
    finish(record, &dir, common)?;
    let psnr = record.final_scores.as_ref().map(|f| f.psnr);
    Ok(Outcome::of(args.require_psnr, psnr))
}

/// Says which images are left out; `run.json` has all of their names.
fn note_left_out(why: &str, names: &[String]) {
    if !names.is_empty() {
        let some = names[..names.len().min(5)].join(", ");
        let more = if names.len() > 5 { ", ..." } else { "" };
        output::note(&format!(
            "{} images {why}; training goes on without them: {some}{more}",
            names.len()
        ));
    }
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
    };
    let data = dataset::load(&args.dataset, &options)?;
    output::note(&format!(
        "{}: {} training views, {} held out, {} points",
        args.dataset.display(),
        data.train.len(),
        data.test.len(),
        data.points.positions.len()
    ));
    note_left_out("are named by the dataset and not there", &data.missing);
    note_left_out(
        "have cameras far from all others (wrong poses?)",
        &data.astray,
    );
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
    if let Some(e) = args.exposure {
        c.exposure = match e {
            ExposureFlag::Auto => ExposureChoice::Auto,
            ExposureFlag::On => ExposureChoice::On,
            ExposureFlag::Off => ExposureChoice::Off,
        };
    }
    if let Some(t) = &args.time_budget {
        c.time_budget = Some(parse_duration(t)?);
    }
    if let Some(b) = &args.image_budget {
        c.image_budget = Some(parse_bytes(b)?);
    }
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

fn progress_bar() -> ProgressBar {
    let bar = ProgressBar::new(0);
    let style = "{bar:24} {pos}/{len} {per_sec} {msg} {eta} left";
    if let Ok(style) = ProgressStyle::with_template(style) {
        bar.set_style(style);
    }
    bar
}

/// Shows where training is, and once what was decided on the way.
fn show(bar: &ProgressBar, p: &Progress, told: &mut bool) {
    if let Some(decision) = p.exposure.filter(|_| !*told) {
        *told = true;
        let on = if decision.on { "on" } else { "left out" };
        let what = format!("per-image exposure is {on}: {}", decision.why());
        bar.suspend(|| output::note(&what));
    }
    bar.set_length(u64::from(p.iterations));
    bar.set_position(u64::from(p.iteration));
    if p.iteration.is_multiple_of(10) {
        let psnr = p.psnr.map_or_else(String::new, |v| format!("{v:.2} dB, "));
        bar.set_message(format!(
            "{psnr}{} Gaussians, {:.0} s,",
            p.gaussians, p.train_seconds
        ));
    }
}

fn finish(record: &RunRecord, dir: &Path, common: &Common) -> Result<()> {
    if common.json {
        return output::json(record);
    }
    if record.iterations < record.config.iterations {
        output::note(&format!(
            "the time budget ended the run after {} of {} iterations, before its schedules did",
            record.iterations, record.config.iterations
        ));
    }
    let scores = record.final_scores.as_ref().map_or_else(
        || "no held-out view".to_owned(),
        |f| {
            let flip = f
                .flip
                .map_or_else(String::new, |v| format!(", FLIP {v:.4}"));
            let fitted = f.cc_psnr.zip(f.cc_ssim);
            let fitted = fitted.map_or_else(String::new, |(psnr, ssim)| {
                format!("; colour-corrected PSNR {psnr:.2} dB, SSIM {ssim:.4}")
            });
            format!(
                "held-out PSNR {:.2} dB, SSIM {:.4}{flip}{fitted}",
                f.psnr, f.ssim
            )
        },
    );
    output::line(&format!(
        "{scores}; {} Gaussians; {} iterations in {:.1} s ({:.1} CPU s)\nscene: {}\nreport: {}",
        record.gaussians,
        record.iterations,
        record.train_seconds,
        record.cpu_seconds,
        dir.join("scene.ply").display(),
        dir.join("report.html").display(),
    ));
    Ok(())
}
