//! The command line: flags → library types, call, print; one file per command.

mod commands;
mod common;
mod convert;
mod devices;
mod doctor;
mod eval;
mod info;
mod lab;
mod output;
mod overrides;
mod progress;
mod render;
mod scene;
mod shell;
mod shots;
mod signals;
mod train;
mod view;

use std::process::ExitCode;

use clap::FromArgMatches;

use mhsplat::base::error::Error;

use commands::Cli;
use common::Outcome;

/// Parses the command line, runs it and returns the exit code.
pub fn main() -> ExitCode {
    let cli = match Cli::from_arg_matches(&Cli::grouped().get_matches()) {
        Ok(cli) => cli,
        Err(error) => error.exit(),
    };
    // Made lazily, a pool without threads (a limit of processes or memory) would be a panic.
    if let Err(error) = rayon::ThreadPoolBuilder::new().build_global() {
        output::note(&format!(
            "error: no threads can be made ({error}); raise the limit on processes or memory (ulimit -u, ulimit -v, or the container's)"
        ));
        return ExitCode::from(2);
    }
    match cli.run().and_then(|done| output::check().map(|()| done)) {
        Ok(Outcome::Done) => ExitCode::SUCCESS,
        Ok(Outcome::Missed) => ExitCode::from(1),
        Err(Error::Interrupted) => ExitCode::from(130),
        Err(error) => {
            output::note(&format!("error: {error}"));
            ExitCode::from(2)
        }
    }
}
