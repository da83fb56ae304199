//! `mhsplat surrogate`.

use std::path::{Path, PathBuf};

use crate::cli::common::{Common, Outcome};
use crate::cli::{output, scene};
use mhsplat::base::error::{Error, Result};
use mhsplat::lab::page::{check_page, write_page};
use mhsplat::lab::surrogate;
use mhsplat::lab::surrogate::{Options, Report};
use mhsplat::run::{RECORD_FILE, RunRecord};

/// Arguments.
#[derive(clap::Args)]
pub struct SurrogateArgs {
    /// Run folder with a checkpoint, best one that was stopped within the span of density control.
    run: PathBuf,
    /// Its dataset [default: where the run found it]
    dataset: Option<PathBuf>,
    /// Births to be tried, half of them drawn as the sampler proposes, half evenly over the importance.
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    candidates: u32,
    /// Training views over which the loss is taken.
    #[arg(long, value_name = "K", default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..))]
    views: u32,
    /// Seed of views, candidates and bootstrap.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Folder for surrogate.json and surrogate.html; an earlier check there is replaced [default: RUN/surrogate]
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
}

/// Checks the surrogates; progress goes to stderr, tables to stdout.
pub fn run(args: &SurrogateArgs, common: &Common) -> Result<Outcome> {
    if !args.run.join(RECORD_FILE).exists() {
        return Err(Error::input(
            &args.run,
            format!("holds no {RECORD_FILE}"),
            "give the folder of a run",
        ));
    }
    let record = RunRecord::read(&args.run)?;
    // Before anything is loaded: a folder without a checkpoint is told at once.
    if !mhsplat::run::checkpoint::path(&args.run).exists() {
        mhsplat::run::checkpoint::read(&args.run)?;
    }
    let folder = match &args.output {
        Some(folder) => folder.clone(),
        None => args.run.join("surrogate"),
    };
    let page = folder.join("surrogate.html");
    check_page(&page)?;
    if folder.join("surrogate.json").exists() && !page.exists() {
        return Err(Error::input(
            &folder,
            "holds a surrogate.json without its page; nothing else than an earlier check is replaced",
            "choose another folder with -o",
        ));
    }
    let path = match &args.dataset {
        Some(path) => path.clone(),
        None => PathBuf::from(&record.dataset.path),
    };
    let dataset = scene::dataset(&path, Some(&record), None, None, false)?;
    let device = crate::cli::common::open_tested(common.device.as_deref())?;
    let options = Options {
        candidates: args.candidates as usize,
        views: args.views as usize,
        seed: args.seed,
    };
    let mut told = 0;
    let report = surrogate::check(
        &args.run,
        dataset,
        &device,
        &options,
        &mut |done, births| {
            if 10 * done / births > told {
                told = 10 * done / births;
                output::note(&format!("{done} of {births} births"));
            }
        },
    )?;
    write(&folder, &page, &report)?;
    if common.json {
        output::json(&report)?;
    } else {
        output::line(&surrogate::markdown(&report));
    }
    Ok(Outcome::Done)
}

fn write(folder: &Path, page: &Path, report: &Report) -> Result<()> {
    std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, e))?;
    write_page(page, &surrogate::page(report))?;
    surrogate::write_json(&folder.join("surrogate.json"), report)?;
    output::note(&format!("page: {}", page.display()));
    Ok(())
}
