//! The commands and their order in `--help`: flat names, grouped by purpose.

use std::fmt::Write;

use clap::{Arg, Command, CommandFactory, Parser, Subcommand};

use mhsplat::base::error::Result;

use crate::cli::common::{Common, Outcome};
use crate::cli::{
    convert, devices, doctor, eval, info, lab, merge, render, shell, split, train, view,
};

/// Posed photos to a 3D Gaussian scene, on any OpenCL device.
///
/// Exit codes: 0 done; 1 ran but missed a requested bar; 2 bad input, device or usage; 130 stopped by Ctrl-C.
#[derive(Parser)]
#[command(name = "mhsplat", version, max_term_width = 100)]
pub struct Cli {
    #[command(subcommand)]
    command: Group,
    /// Print one JSON document on stdout and nothing else there.
    #[arg(long, global = true, display_order = 900)]
    json: bool,
}

#[derive(Subcommand)]
enum Group {
    #[command(flatten)]
    Make(Make),
    #[command(flatten)]
    Measure(Measure),
    #[command(flatten)]
    Tools(Tools),
}

#[derive(Subcommand)]
enum Make {
    /// Train a scene from posed photos.
    #[command(after_help = "Example: mhsplat train dataset -o run --max-size 800")]
    Train(Box<train::TrainArgs>),
    /// Render a scene to PNG files.
    #[command(after_help = "Example: mhsplat render run -o film --video film.mp4")]
    Render(Box<render::RenderArgs>),
    /// Show a scene in a browser, on this machine or through ssh.
    #[command(after_help = "Example: mhsplat view run")]
    View(Box<view::ViewArgs>),
    /// PSNR, SSIM and FLIP per held-out view and mean.
    #[command(after_help = "Example: mhsplat eval run")]
    Eval(eval::EvalArgs),
    /// Write a scene in another format, or a part of it.
    #[command(after_help = "Example: mhsplat convert run scene.spz")]
    Convert(convert::ConvertArgs),
    /// Divide a dataset into cells that are trained one by one.
    #[command(after_help = "Example: mhsplat split dataset --cells 4 -o parts")]
    Split(split::SplitArgs),
    /// Join the scenes of the cells of a dataset.
    #[command(after_help = "Example: mhsplat merge parts -o scene.ply")]
    Merge(merge::MergeArgs),
}

#[derive(Subcommand)]
enum Measure {
    /// Time, throughput, share of the measured peak and error of every stage.
    #[command(after_help = "Example: mhsplat bench -o bench")]
    Bench(lab::bench::BenchArgs),
    /// Check every stage on a device against the f64 reference.
    #[command(after_help = "Example: mhsplat verify --suite stress -o verification")]
    Verify(lab::verify::VerifyArgs),
    /// Error against run time of several runs, and time to equal error.
    #[command(after_help = "Example: mhsplat compare mh=run-1 mcmc=run-2 -o compare.html")]
    Compare(lab::compare::CompareArgs),
    /// Train what is missing of a matrix of scenes, settings and seeds, and compare the runs.
    #[command(after_help = "Example: mhsplat experiment data/experiments/room.toml --dry-run")]
    Experiment(lab::experiment::ExperimentArgs),
    /// Rank correlation of the importance of births with their true change of the loss, in a run.
    #[command(after_help = "Example: mhsplat surrogate run")]
    Surrogate(lab::surrogate::SurrogateArgs),
}

#[derive(Subcommand)]
enum Tools {
    /// Describe a dataset and the plan of its training, a run, or a scene file.
    #[command(after_help = "Example: mhsplat info dataset")]
    Info(info::InfoArgs),
    /// Find OpenCL's loader, drivers, devices, permissions and limits, and say what to install.
    #[command(
        after_help = "Example: mhsplat doctor\n\nExits with 0 if a device can be used, else with 2."
    )]
    Doctor,
    /// List every OpenCL platform and device.
    #[command(after_help = "Example: mhsplat devices")]
    Devices(devices::DevicesArgs),
    /// Make a seeded scene with known truth.
    #[command(after_help = "Example: mhsplat synth room dataset")]
    Synth(lab::synth::SynthArgs),
    /// Print a script that completes commands and options in a shell.
    #[command(
        after_help = "Example: mhsplat completions bash > ~/.local/share/bash-completion/completions/mhsplat"
    )]
    Completions(shell::CompletionsArgs),
    /// Write manual pages.
    #[command(after_help = "Example: mhsplat man pages && man pages/mhsplat-train.1")]
    Man(shell::ManArgs),
}

impl Cli {
    /// The command line with its help.
    pub fn grouped() -> Command {
        // `--iterations -5` is a wrong number, not an unknown option.
        let number = |arg: Arg| match arg.get_action().takes_values() {
            true => arg.allow_negative_numbers(true),
            false => arg,
        };
        let command = Self::command().mut_subcommands(|command| command.mut_args(number));
        command.help_template(format!(
            "{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{}Options:\n{{options}}",
            groups()
        ))
    }

    /// Runs the command.
    pub fn run(self) -> Result<Outcome> {
        let common = Common { json: self.json };
        match self.command {
            Group::Make(Make::Train(args)) => train::run(&args, &common),
            Group::Make(Make::Render(args)) => render::run(&args, &common),
            Group::Make(Make::View(args)) => view::run(&args, &common),
            Group::Make(Make::Eval(args)) => eval::run(&args, &common),
            Group::Make(Make::Convert(args)) => convert::run(&args, &common),
            Group::Make(Make::Split(args)) => split::run(&args, &common),
            Group::Make(Make::Merge(args)) => merge::run(&args, &common),
            Group::Measure(Measure::Bench(args)) => lab::bench::run(&args, &common),
            Group::Measure(Measure::Verify(args)) => lab::verify::run(&args, &common),
            Group::Measure(Measure::Compare(args)) => lab::compare::run(&args, &common),
            Group::Measure(Measure::Experiment(args)) => lab::experiment::run(&args, &common),
            Group::Measure(Measure::Surrogate(args)) => lab::surrogate::run(&args, &common),
            Group::Tools(Tools::Info(args)) => info::run(&args, &common),
            Group::Tools(Tools::Doctor) => doctor::run(&common),
            Group::Tools(Tools::Devices(args)) => devices::run(&common, &args),
            Group::Tools(Tools::Completions(args)) => {
                shell::completions(&args, Self::grouped(), &common)
            }
            Group::Tools(Tools::Man(args)) => shell::man(&args, Self::grouped(), &common),
            Group::Tools(Tools::Synth(args)) => lab::synth::run(&args, &common),
        }
    }
}

/// The commands with their own descriptions, group by group.
fn groups() -> String {
    let command = || Command::new("group");
    let groups = [
        ("Make a scene", Make::augment_subcommands(command())),
        ("Measure", Measure::augment_subcommands(command())),
        ("Tools", Tools::augment_subcommands(command())),
    ];
    let mut text = String::new();
    for (title, group) in groups {
        let _ = writeln!(text, "{title}:");
        for c in group.get_subcommands() {
            let about = c.get_about().map(ToString::to_string).unwrap_or_default();
            let _ = writeln!(text, "  {:<11}  {about}", c.get_name());
        }
        text.push('\n');
    }
    text
}
