//! The command line: flags → library types, call, print; one file per command.

mod commands;
mod common;
mod convert;
mod devices;
mod doctor;
mod eval;
mod info;
mod lab;
mod merge;
mod output;
mod overrides;
mod progress;
mod ranks;
mod render;
mod scene;
mod shell;
mod shots;
mod signals;
mod split;
mod train;
mod view;

use std::process::ExitCode;

use clap::{ArgMatches, FromArgMatches};

use mhsplat::base::cores::Cores;
use mhsplat::base::error::{Error, Result};

use commands::Cli;
use common::Outcome;

/// Parses the command line, runs it and returns the exit code.
pub fn main() -> ExitCode {
    let matches = Cli::grouped().get_matches();
    let cli = match Cli::from_arg_matches(&matches) {
        Ok(cli) => cli,
        Err(error) => error.exit(),
    };
    let begun = signals::begin().and_then(|()| make_threads(&matches));
    let ran = begun.and_then(|()| cli.run());
    match ran.and_then(|done| output::check().map(|()| done)) {
        Ok(Outcome::Done) => ExitCode::SUCCESS,
        Ok(Outcome::Missed) => ExitCode::from(1),
        Err(Error::Interrupted) => ExitCode::from(130),
        Err(error) => {
            output::note(&format!("error: {error}"));
            ExitCode::from(2)
        }
    }
}

/// Makes the pool of threads, one for each core that the command takes.
fn make_threads(matches: &ArgMatches) -> Result<()> {
    let command = matches.subcommand().map(|(_, of)| of);
    // Commands that use no device do not know the option.
    let asked = command.and_then(|of| of.try_get_one::<usize>("threads").ok().flatten());
    let cores = Cores::new(asked.copied())?;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(cores.count());
    // Made lazily, a pool without threads (a limit of processes or memory) would be a panic.
    pool.build_global().map_err(|error| {
        Error::device(
            "threads",
            format!("none can be made ({error})"),
            "raise the limit on processes or memory (ulimit -u, ulimit -v, or the container's), or lower --threads",
        )
    })
}
