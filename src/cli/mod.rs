//! The only place that names `clap`: one file per subcommand, flags → library types, call, print.

mod devices;
mod eval;
mod lab;
mod output;
mod progress;
mod render;
mod scene;
mod train;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

use mhsplat::Device;
use mhsplat::base::error::{Error, Result};
use mhsplat::lab::selftest::self_test;
use mhsplat::lab::tune;

/// Posed photos to a 3D Gaussian scene, on any OpenCL device.
///
/// Exit codes: 0 done; 1 ran but missed a requested bar; 2 bad input, device or usage; 130 stopped by Ctrl-C.
#[derive(Parser)]
#[command(name = "mhsplat", version, max_term_width = 100)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Print one JSON document on stdout and nothing else there.
    #[arg(long, global = true)]
    json: bool,
    /// OpenCL device: index, part of its name, or cpu, gpu, accelerator (also MHSPLAT_DEVICE).
    #[arg(long, global = true, value_name = "SEL")]
    device: Option<String>,
}

#[derive(Subcommand)]
enum Command {
    /// Train a scene from posed photos.
    Train(Box<train::TrainArgs>),
    /// PSNR, SSIM and FLIP per held-out view and mean.
    Eval(eval::EvalArgs),
    /// Render a scene to PNG files.
    Render(render::RenderArgs),
    /// Error against run time of several runs, and time to equal error.
    Compare(lab::compare::CompareArgs),
    /// Scenes, settings and seeds from a file: trains what is missing and compares.
    Experiment(lab::experiment::ExperimentArgs),
    /// What births truly do to the loss of a run, and how well the sampler's importance foretells it.
    Surrogate(lab::surrogate::SurrogateArgs),
    /// List every OpenCL platform and device.
    Devices,
    /// Make a seeded scene with known truth.
    Synth(lab::synth::SynthArgs),
    /// Time, throughput, share of the measured peak and error of every stage.
    Bench(lab::bench::BenchArgs),
    /// Check every stage on a device against the f64 reference.
    Verify(lab::verify::VerifyArgs),
}

/// What every subcommand shares.
pub struct Common {
    /// Print JSON.
    pub json: bool,
    /// Device selector.
    pub device: Option<String>,
}

/// Whether a requested bar was reached.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// Everything asked for.
    Done,
    /// It ran, but missed a bar that was asked for.
    Missed,
}

impl Outcome {
    /// Whether `psnr` reaches the bar, if one was set.
    fn of(bar: Option<f64>, psnr: Option<f64>) -> Self {
        match bar {
            Some(bar) if !psnr.is_some_and(|p| p >= bar) => Self::Missed,
            _ => Self::Done,
        }
    }
}

/// Opens a device with the tuning that suits it, for measuring it.
fn open_device(selector: Option<&str>) -> Result<Device> {
    tune::tuned(Device::open(selector)?, &mut output::note)
}

/// Opens a device that computes right results.
fn open_tested(selector: Option<&str>) -> Result<Device> {
    let device = open_device(selector)?;
    self_test(&device)?;
    Ok(device)
}

fn dispatch(cli: Cli) -> Result<Outcome> {
    let common = Common {
        json: cli.json,
        device: cli.device.or_else(|| {
            std::env::var("MHSPLAT_DEVICE")
                .ok()
                .filter(|v| !v.is_empty())
        }),
    };
    match cli.command {
        Command::Train(args) => train::run(&args, &common),
        Command::Eval(args) => eval::run(&args, &common),
        Command::Render(args) => render::run(&args, &common),
        Command::Compare(args) => lab::compare::run(&args, &common),
        Command::Experiment(args) => lab::experiment::run(&args, &common),
        Command::Surrogate(args) => lab::surrogate::run(&args, &common),
        Command::Devices => devices::run(&common),
        Command::Synth(args) => lab::synth::run(&args, &common),
        Command::Bench(args) => lab::bench::run(&args, &common),
        Command::Verify(args) => lab::verify::run(&args, &common),
    }
}

/// Parses the command line, runs it and answers the exit code.
pub fn main() -> ExitCode {
    match dispatch(Cli::parse()) {
        Ok(Outcome::Done) => ExitCode::SUCCESS,
        Ok(Outcome::Missed) => ExitCode::from(1),
        Err(Error::Interrupted) => ExitCode::from(130),
        Err(error) => {
            output::note(&format!("error: {error}"));
            ExitCode::from(2)
        }
    }
}
