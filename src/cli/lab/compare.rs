//! `mhsplat compare`.

use std::path::PathBuf;

use crate::cli::common::{Common, Outcome};
use crate::cli::lab::Form;
use crate::cli::output;
use mhsplat::base::error::Result;
use mhsplat::lab::compare;
use mhsplat::lab::compare::{Clock, Options, Source};
use mhsplat::lab::report::check_page;

fn decibels(text: &str) -> std::result::Result<f64, String> {
    let value = output::finite(text)?;
    compare::thresholds::check(&[value]).map_err(|e| e.to_string())?;
    Ok(value)
}

/// Arguments.
#[derive(clap::Args)]
pub struct CompareArgs {
    /// Run folders of one scene. Those that differ in the seed only are samples of one group; NAME=RUN names the group.
    #[arg(required = true, value_name = "RUN")]
    runs: Vec<String>,
    /// Page to write; replaces an earlier comparison, but nothing else [default: compare.html, none with --json]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Clock of the tables; the page has the others, too [default: cpu where all runs have it]
    #[arg(long, value_enum)]
    clock: Option<Clock>,
    /// PSNR to time the runs to, dB, within ±200; may be repeated [default: every whole dB from the first evaluation to the best]
    #[arg(long, value_name = "DB", value_parser = decibels, value_delimiter = ',', allow_negative_numbers = true)]
    threshold: Vec<f64>,
    /// Group that the others are compared with [default: that of the first run]
    #[arg(long, value_name = "NAME")]
    reference: Option<String>,
    /// Compare runs of other datasets, resolutions or splits, too; the page says so.
    #[arg(long)]
    allow_different: bool,
    #[command(flatten)]
    form: Form,
}

/// Compares runs; warnings go to stderr, tables to stdout.
pub fn run(args: &CompareArgs, common: &Common) -> Result<Outcome> {
    let page = match (&args.output, common.json) {
        (Some(path), _) => Some(path.clone()),
        (None, false) => Some(PathBuf::from("compare.html")),
        (None, true) => None,
    };
    if let Some(path) = &page {
        check_page(path)?;
    }
    let sources: Vec<Source> = args.runs.iter().map(|r| Source::parse(r)).collect();
    let options = Options {
        clock: args.clock,
        thresholds: args.threshold.clone(),
        reference: args.reference.clone(),
        allow_different: args.allow_different,
    };
    let comparison = compare::compare(&sources, &options)?;
    for warning in &comparison.warnings {
        output::note(&format!("warning: {warning}"));
    }
    let mut report = compare::report(&comparison);
    if let Some(path) = &page {
        report.sections.push(compare::reports(&comparison, path));
        report.write_page(path)?;
        output::note(&format!("page: {}", path.display()));
    }
    if common.json {
        output::json(&comparison)?;
    } else {
        args.form.print(&report);
    }
    Ok(Outcome::Done)
}
