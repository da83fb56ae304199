//! `mhsplat surrogate`.

use std::path::PathBuf;

use crate::cli::common::{Common, DeviceOption, Outcome};
use crate::cli::lab::Form;
use crate::cli::{output, scene};
use mhsplat::base::error::{Error, Result};
use mhsplat::capture::Needed;
use mhsplat::lab::folder::json;
use mhsplat::lab::report::check_page;
use mhsplat::lab::surrogate;
use mhsplat::lab::surrogate::Options;
use mhsplat::run::{RECORD_FILE, RunRecord};

/// Arguments.
#[derive(clap::Args)]
pub struct SurrogateArgs {
    /// Run folder with a checkpoint, best one that was stopped within the span of density control.
    run: PathBuf,
    /// Its dataset [default: where the run found it]
    dataset: Option<PathBuf>,
    /// Births to try, half of them drawn as the sampler proposes, half evenly over the importance.
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
    #[command(flatten)]
    device: DeviceOption,
    #[command(flatten)]
    form: Form,
}

/// Checks importance and first-order estimate; progress goes to stderr, tables to stdout.
pub fn run(args: &SurrogateArgs, common: &Common) -> Result<Outcome> {
    if !args.run.join(RECORD_FILE).exists() {
        return Err(Error::input(
            &args.run,
            format!("holds no {RECORD_FILE}"),
            "give the folder of a run",
        ));
    }
    let record = RunRecord::read(&args.run)?;
    // Before anything is loaded: a folder without a checkpoint is refused at once.
    if !mhsplat::run::checkpoint::path(&args.run).exists() {
        mhsplat::run::checkpoint::read(&args.run)?;
    }
    let default = || args.run.join("surrogate");
    let folder = args.output.clone().unwrap_or_else(default);
    let page = folder.join("surrogate.html");
    check_page(&page)?;
    if folder.join("surrogate.json").exists() && !page.exists() {
        return Err(Error::input(
            &folder,
            "holds a surrogate.json without its page; only an earlier check is replaced",
            "choose another folder with -o",
        ));
    }
    let path = scene::dataset_path(args.dataset.as_deref(), Some(&record), "give it")?;
    let dataset = scene::dataset(
        &path,
        Some(&record),
        &scene::PhotoOptions::of_run(),
        Needed::All,
    )?;
    let device = args.device.open_tested()?;
    let options = Options {
        candidates: args.candidates,
        views: args.views,
        seed: args.seed,
    };
    let mut announced = 0;
    let checked = surrogate::check(
        &args.run,
        dataset,
        &device,
        &options,
        &mut |done, births| {
            if 10 * done / births > announced {
                announced = 10 * done / births;
                output::note(&format!("{done} of {births} births"));
            }
        },
    )?;
    let (report, json) = (surrogate::report(&checked), json("surrogate", &checked)?);
    std::fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, e))?;
    report.write_page(&page)?;
    let file = folder.join("surrogate.json");
    mhsplat::base::files::write_bytes(&file, format!("{json}\n").as_bytes())?;
    output::note(&format!("page: {}", page.display()));
    match common.json {
        true => output::line(&json),
        false => args.form.print(&report),
    }
    Ok(Outcome::Done)
}
