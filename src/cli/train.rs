//! `mhsplat train`.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::cli::common::{Common, Outcome, open_tested};
use crate::cli::overrides::Overrides;
use crate::cli::progress::{finish, progress_bar, show};
use crate::cli::{output, scene};
use mhsplat::base::error::{Error, Result};
use mhsplat::capture;
use mhsplat::config::{RUN_CONTROL, TrainConfig, deserialize, from_json};
use mhsplat::device::Device;
use mhsplat::run::{Clock, Run, abandon_folder, claim_folder, saved_config};

/// Arguments of `mhsplat train`.
#[derive(clap::Args)]
pub struct TrainArgs {
    /// Folder with images/ and sparse/0/, or with transforms_train.json or transforms.json.
    dataset: PathBuf,
    /// Run folder; must not exist.
    #[arg(short, long, value_name = "RUN", default_value = "run")]
    output: PathBuf,
    /// Continue the run in this folder from its checkpoint, with its configuration.
    #[arg(long, value_name = "RUN", conflicts_with_all = ["output", "config"])]
    resume: Option<PathBuf>,
    /// TOML file (or a run's run.json) with the same names; flags win.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    #[command(flatten)]
    options: Overrides,
    /// Stop as on Ctrl-C when stdin ends, which a parent process can cause on any system.
    #[arg(long, hide = true)]
    until_stdin_ends: bool,
    /// Exit with 1 unless the mean held-out PSNR reaches this, dB.
    #[arg(long, value_name = "DB", value_parser = output::finite, help_heading = RUN_CONTROL)]
    require_psnr: Option<f64>,
}

/// Trains a scene; progress goes to stderr.
pub fn run(args: &TrainArgs, common: &Common) -> Result<Outcome> {
    let config = config(args)?;
    config.validate()?;
    let dir = args.resume.as_ref().unwrap_or(&args.output);
    // Before the device: some drivers' compilers set handlers that end the process, and the first one set is the last to run.
    let stop = stop_flag()?;
    if args.until_stdin_ends {
        let stop = stop.clone();
        std::thread::spawn(move || {
            let _ = std::io::copy(&mut std::io::stdin(), &mut std::io::sink());
            stop.store(true, Ordering::Relaxed);
        });
    }
    let device = open_tested(common.device.as_deref())?;
    if args.resume.is_none() {
        claim_folder(dir)?;
    }
    let mut run = prepare(args, dir, config, &device).inspect_err(|_| {
        if args.resume.is_none() {
            abandon_folder(dir);
        }
    })?;
    output::note(&format!(
        "device: {} ({})",
        device.info().name,
        device.info().platform
    ));
    output::note(&run.record().plan.summary());
    let record = run.record();
    if record.config.trace_density && args.resume.is_some() && record.funnel.is_empty() {
        output::note("density control is not traced: a trace begins with the run");
    }
    let planned = run.record().plan.clone();
    let bar = progress_bar();
    let driven = run.drive(&stop, |p| show(&bar, p)).map(|_| ());
    bar.finish();
    let stopped = matches!(driven, Err(Error::Interrupted));
    if driven.is_err() {
        note_resume(run.saved(), &args.dataset, dir, stopped);
    }
    if stopped && common.json {
        output::json(run.record())?;
    }
    driven?;
    let record = run.record();
    if let Some(found) = record.plan.since(&planned) {
        output::note(&found);
    }
    finish(record, dir, common)?;
    let psnr = record.final_scores.as_ref().map(|f| f.mean.psnr);
    Ok(Outcome::of(args.require_psnr, psnr))
}

/// Prints the command that resumes a run that ended early.
fn note_resume(saved: Option<u32>, dataset: &Path, dir: &Path, stopped: bool) {
    let what = match saved {
        Some(done) if stopped => format!("stopped after {done} iterations; resume with"),
        Some(done) => format!(
            "the state after {done} iterations is saved; once the cause is fixed, resume with"
        ),
        None if dir.join("scene.ply").exists() => {
            output::note("no state is saved to resume from; start again with -o NEW_FOLDER");
            return;
        }
        None => "nothing is saved yet; once the cause is fixed, start again with".into(),
    };
    let (dataset, dir) = (dataset.display(), dir.display());
    output::note(&format!("{what}: mhsplat train {dataset} --resume {dir}"));
}

fn prepare(args: &TrainArgs, dir: &Path, config: TrainConfig, device: &Device) -> Result<Run> {
    let clock = Clock::start();
    let data = capture::load(&args.dataset, &scene::load_options(&config))?;
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

/// Returns a flag that Ctrl-C or SIGTERM sets; a second signal ends the program at once.
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

/// Returns the defaults, those of a file or those of the run to resume, with the typed flags in their place.
fn config(args: &TrainArgs) -> Result<TrainConfig> {
    let mut config = match (&args.resume, &args.config) {
        (Some(run), _) => saved_config(run)?,
        (None, Some(file)) => read_config(file)?,
        (None, None) => TrainConfig::default(),
    };
    if args.resume.is_none() && args.options.set_length() {
        config.lengths.clear();
    }
    args.options.over(config)
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
        let value: serde_json::Value = from_json(&text).map_err(wrong)?;
        let inner = value.get("config").cloned().unwrap_or(value);
        return deserialize(inner).map_err(wrong);
    }
    let table = toml::Deserializer::parse(&text).map_err(|e| wrong(e.to_string()))?;
    deserialize(table).map_err(wrong)
}
