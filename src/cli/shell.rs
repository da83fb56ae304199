//! `mhsplat completions` and `mhsplat man`.

use std::path::PathBuf;

use clap::Command;
use clap_complete::Shell;
use serde_json::json;

use crate::cli::common::{Common, Outcome};
use crate::cli::output;
use mhsplat::base::error::{Error, Result};
use mhsplat::lab::folder::check_folder;

/// Name that the program is called by.
const PROGRAM: &str = "mhsplat";

/// Arguments of `mhsplat completions`.
#[derive(clap::Args)]
pub struct CompletionsArgs {
    /// Shell to complete in.
    #[arg(value_enum)]
    shell: Shell,
}

/// Arguments of `mhsplat man`.
#[derive(clap::Args)]
pub struct ManArgs {
    /// Folder for the pages; must be empty or not exist.
    dir: PathBuf,
}

/// Prints the script that completes commands and options in a shell.
pub fn completions(
    args: &CompletionsArgs,
    mut program: Command,
    common: &Common,
) -> Result<Outcome> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut program, PROGRAM, &mut script);
    let script = String::from_utf8_lossy(&script);
    match common.json {
        true => output::json(&json!({ "shell": args.shell.to_string(), "script": script }))?,
        false => output::line(script.trim_end()),
    }
    Ok(Outcome::Done)
}

/// Writes a manual page for the program and for every command.
pub fn man(args: &ManArgs, program: Command, common: &Common) -> Result<Outcome> {
    check_folder(&args.dir)?;
    let failed = |e| Error::io(&args.dir, e);
    std::fs::create_dir_all(&args.dir).map_err(failed)?;
    clap_mangen::generate_to(program, &args.dir).map_err(failed)?;
    let entries = std::fs::read_dir(&args.dir).map_err(failed)?;
    let mut pages: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    pages.sort();
    match common.json {
        true => output::json(&json!({ "pages": pages }))?,
        false => output::line(&format!("{} pages in {}", pages.len(), args.dir.display())),
    }
    Ok(Outcome::Done)
}
