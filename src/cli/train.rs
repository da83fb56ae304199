//! `mhsplat train`.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::cli::common::{Common, DeviceOption, Outcome, self_tested, tested};
use crate::cli::overrides::Overrides;
use crate::cli::progress::{Display, Form, finish, tell_objects};
use crate::cli::signals::stop_flag;
use crate::cli::{output, ranks, scene, view};
use mhsplat::base::error::{Error, Result};
use mhsplat::capture::{self, Dataset, LoadOptions};
use mhsplat::config::{Preset, RUN_CONTROL, TrainConfig};
use mhsplat::config::{deserialize, from_json, parse_duration};
use mhsplat::device::{Device, Helpers};
use mhsplat::lab::tune::SizeClass;
use mhsplat::ranks::launched;
use mhsplat::run::live::{Door, Server};
use mhsplat::run::record::without_later_options;
use mhsplat::run::{
    Clock, Extension, RECORD_FILE, Run, RunRecord, claim_folder, saved_config, saved_tuning,
};

/// Keys of a configuration that say how long the run is.
const LENGTHS: [&str; 4] = ["iterations", "time-budget", "budget-cpu", "lengths"];

/// Largest share of a budget that is spent on what is done once for a device.
const LARGEST_ONCE: f64 = 0.1;

/// Arguments of `mhsplat train`.
#[derive(clap::Args)]
pub struct TrainArgs {
    /// Folder with images/ and sparse/0/, with transforms_train.json or transforms.json, or with photos and the cameras of RealityScan
    /// (CSV), Metashape (XML), Bundler, OpenSfM or OpenMVG; or a zip archive of one.
    #[arg(required_unless_present = "resume")]
    dataset: Option<PathBuf>,
    /// Run folder; must not exist.
    #[arg(short, long, value_name = "RUN", default_value = "run")]
    output: PathBuf,
    /// Continue the run in this folder from its checkpoint, with its configuration; with --iterations to another end, if it has come to
    /// its own, too.
    #[arg(long, value_name = "RUN", conflicts_with_all = ["output", "config"])]
    resume: Option<PathBuf>,
    /// Continue the run in the folder of -o if there is one, else start it: for jobs that are queued again, with the same options.
    #[arg(long, conflicts_with = "resume")]
    resume_or_start: bool,
    /// Give a finished or stopped run so much more time (90s, 10m, 1h30m; CPU seconds if its budget was) than it has had.
    #[arg(long, value_name = "TIME", value_parser = parse_duration, requires = "resume", conflicts_with_all = ["time_budget", "budget_cpu", "iterations"])]
    extend: Option<f64>,
    /// TOML file (or a run's run.json) with the same names; flags win.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Length of the run in a word, unless --iterations or a budget says it [default: standard].
    #[arg(long, value_enum, conflicts_with_all = ["resume", "iterations", "time_budget", "budget_cpu"])]
    preset: Option<Preset>,
    #[command(flatten)]
    options: Overrides,
    /// Show the scene as it is trained in a browser, on this machine or through ssh: on this port, 0 for any that is free [default: 7878, or any that is free].
    #[arg(long, value_name = "PORT", num_args = 0..=1, value_parser = view::port, help_heading = RUN_CONTROL)]
    view: Option<Option<u16>>,
    /// Form of the progress on stderr.
    #[arg(long, value_enum, default_value_t, help_heading = RUN_CONTROL)]
    progress: Form,
    /// Nothing on stderr but warnings and errors.
    #[arg(short, long, help_heading = RUN_CONTROL, conflicts_with = "verbose")]
    quiet: bool,
    /// The reasons for what is kept and left out.
    #[arg(short, long, help_heading = RUN_CONTROL)]
    verbose: bool,
    /// Time the stages of every iteration for the report, and not of a sample; it takes some time itself.
    #[arg(long, help_heading = RUN_CONTROL)]
    profile: bool,
    /// Stop as on Ctrl-C when stdin ends, which a parent process can cause on any system.
    #[arg(long, hide = true)]
    until_stdin_ends: bool,
    /// Exit with 1 unless the mean held-out PSNR reaches this, dB.
    #[arg(long, value_name = "DB", value_parser = output::finite, help_heading = RUN_CONTROL)]
    require_psnr: Option<f64>,
    #[command(flatten)]
    device: DeviceOption,
}

/// Trains a scene; progress goes to stderr.
pub fn run(args: &TrainArgs, common: &Common) -> Result<Outcome> {
    let resume = match &args.resume {
        None if args.resume_or_start && args.output.join(RECORD_FILE).exists() => {
            Some(&args.output)
        }
        resume => resume.as_ref(),
    };
    let config = || {
        let config = config(args, resume.map(PathBuf::as_path))?;
        config.validate().map(|()| config)
    };
    // A process that does not lead gets its configuration from the one that does, and may have no run folder.
    let known = match launched::processes() {
        1 => Some(config()?),
        _ => None,
    };
    if args.quiet {
        output::be_quiet();
    }
    if args.progress == Form::Json {
        tell_objects();
    }
    let stop = stop_flag();
    let Some(device) = ranks::open(&args.device)? else {
        return Ok(Outcome::Done);
    };
    let known = known.map_or_else(config, Ok);
    let trained = known.and_then(|config| train(args, common, (config, resume), &device, &stop));
    if let (Err(error), Helpers::Processes(exchange)) = (&trained, device.helpers()) {
        // Does nothing where training has come to its end before.
        exchange.fail(&error.to_string());
    }
    trained
}

/// Trains on the devices that are open.
fn train(
    args: &TrainArgs,
    common: &Common,
    (config, resume): (TrainConfig, Option<&PathBuf>),
    device: &Device,
    stop: &Arc<AtomicBool>,
) -> Result<Outcome> {
    let dir = resume.unwrap_or(&args.output);
    if args.until_stdin_ends {
        let stop = stop.clone();
        std::thread::spawn(move || {
            let _ = std::io::copy(&mut std::io::stdin(), &mut std::io::sink());
            stop.store(true, Ordering::Relaxed);
        });
    }
    let door = args
        .view
        .map(|port| Door::open("--view", port))
        .transpose()?;
    if resume.is_none() {
        claim_folder(dir)?;
    }
    let dataset = match resume {
        Some(run) if args.dataset.is_none() => {
            let record = RunRecord::read(run)?;
            scene::dataset_path(None, Some(&record), "give it")?
        }
        _ => args.dataset.clone().unwrap_or_default(),
    };
    let mut clock = Clock::start();
    let data = read_photos(&dataset, &config, device.helpers())?;
    let tuned = || tuned(device.clone(), resume, SizeClass::of_run(&data, &config));
    // Of a run that goes on there is less left; one that is repeated has its length.
    let budgets = match resume {
        None if config.lengths.is_empty() => [config.time_budget, config.budget_cpu],
        _ => [None; 2],
    };
    let device = apart(&mut clock, budgets, tuned)?;
    let mut run = match resume {
        Some(run) => {
            let iterations = args.resume.as_ref().and_then(|_| args.options.iterations());
            let extension = iterations.map(Extension::Iterations);
            let extension = args.extend.map(Extension::Seconds).or(extension);
            Run::resume(run, data, config, &device, clock, extension)
        }
        None => Run::start(dir, data, config, &device, clock),
    }?;
    if args.profile {
        run.time_every_iteration();
    }
    let ranks = match device.helpers().ranks() {
        1 => String::new(),
        ranks => format!(", the first of {ranks} ranks"),
    };
    let info = device.info();
    output::info(&format!("device: {} ({}){ranks}", info.name, info.platform));
    for line in run.record().plan.summary(args.verbose) {
        output::info(&line);
    }
    run.take_remarks().iter().for_each(|r| output::note(r));
    let record = run.record();
    if record.config.trace_density && resume.is_some() && record.funnel.is_empty() {
        output::note("density control is not traced: a trace begins with the run");
    }
    if let Some(door) = door {
        view::lines(&door)
            .iter()
            .for_each(|line| output::note(line));
        let server = Server::start(door, &run.page())?;
        run.watch(server)?;
    }
    let form = match args.quiet {
        true => Form::Log,
        false => args.progress,
    };
    let mut display = Display::new(form);
    let driven = run.drive(stop, |p| display.show(p)).map(|_| ());
    display.end();
    run.take_remarks().iter().for_each(|r| output::note(r));
    let stopped = matches!(driven, Err(Error::Interrupted));
    if driven.is_err() {
        note_resume(run.saved(), &dataset, dir, stopped);
    }
    if stopped && common.json {
        output::json(run.record())?;
    }
    driven?;
    let record = run.record();
    finish(record, dir, common)?;
    let psnr = record.final_scores.as_ref().map(|f| f.mean.psnr);
    Ok(Outcome::of(args.require_psnr, psnr))
}

/// Result of work that is done once for a device, which is no time of training. It counts for a budget, of seconds or of CPU seconds, where it
/// takes at most [`LARGEST_ONCE`] of it.
fn apart<T>(
    clock: &mut Clock,
    budgets: [Option<f64>; 2],
    work: impl FnOnce() -> Result<T>,
) -> Result<T> {
    let mut counting = clock.clone();
    counting.pause();
    clock.stop();
    let done = work()?;
    let once = [
        (counting.wall_seconds() - clock.wall_seconds(), "s"),
        (
            counting.all_cpu_seconds() - clock.all_cpu_seconds(),
            "CPU s",
        ),
    ];
    for (budget, (once, unit)) in budgets.into_iter().zip(once) {
        match budget {
            Some(all) if once <= LARGEST_ONCE * all => *clock = counting.clone(),
            Some(_) => output::note(&format!(
                "compiling and testing the kernels for this device took {once:.0} {unit} beyond the budget"
            )),
            None => {}
        }
    }
    clock.resume();
    Ok(done)
}

/// The device with the tuning of the run to resume, or the one for runs of a size, in which it passes the self-test.
fn tuned(device: Device, resume: Option<&PathBuf>, size: SizeClass) -> Result<Device> {
    let known = resume.map(|run| saved_tuning(run)).transpose()?.flatten();
    match known.filter(|tuning| tuning.fault(device.info()).is_none()) {
        Some(tuning) => self_tested(device.with_tuning(tuning)),
        None => tested(device, size),
    }
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

/// Reads the dataset of a run, and tells what it holds.
fn read_photos(dataset: &Path, config: &TrainConfig, helpers: &Helpers) -> Result<Dataset> {
    let options = LoadOptions {
        keepers: match helpers {
            Helpers::Processes(_) => launched::on_this_node(),
            _ => helpers.ranks(),
        },
        digests: matches!(helpers, Helpers::Processes(_)),
        ..scene::load_options(config)
    };
    let data = capture::load(dataset, &options)?;
    output::info(&format!(
        "{}: {} ({}), {} training views, {} held out, {} points",
        dataset.display(),
        data.layout,
        data.place,
        data.train.len(),
        data.test.len(),
        data.points.positions.len()
    ));
    scene::note_left_out(&data);
    Ok(data)
}

/// Returns the configuration of a new run, or that of the run to resume with the typed flags in the place of what may change.
///
/// # Errors
/// A file that cannot be read; for a run that is begun or resumed, whatever there is, another configuration than that it has.
fn config(args: &TrainArgs, resume: Option<&Path>) -> Result<TrainConfig> {
    let Some(run) = resume else {
        return new_config(args);
    };
    let saved = saved_config(run)?;
    if args.resume_or_start {
        let asked = new_config(args)?;
        if let Some(key) = Overrides::fixed_difference(&asked, &saved) {
            return Err(Error::input(
                run,
                format!("the run there was begun with another `{key}` than is asked for now"),
                "give the options that it was begun with, or another folder with -o",
            ));
        }
    }
    let iterations = saved.iterations;
    let config = with_options(args, saved)?;
    // Those of its beginning: more of them are an extension.
    Ok(TrainConfig {
        iterations,
        ..config
    })
}

/// Returns the defaults or those of a file, with the typed flags in their place.
///
/// # Errors
/// A file that cannot be read or parsed; a value out of its domain, with the name of the file that has it.
fn new_config(args: &TrainArgs) -> Result<TrainConfig> {
    let Some(file) = &args.config else {
        return over_file(args, (TrainConfig::default(), false));
    };
    let read = read_config(file)?;
    let is_wrong = read.0.validate().is_err();
    let merged = over_file(args, read)?;
    let Err(wrong) = merged.validate() else {
        return Ok(merged);
    };
    let flags = over_file(args, (TrainConfig::default(), false))?.validate();
    let by_flag = flags.is_err_and(|flag| flag.to_string() == wrong.to_string());
    match is_wrong && !by_flag {
        true => Err(Error::input(file, wrong.to_string(), "correct it there")),
        false => Err(wrong),
    }
}

/// Returns a configuration with the typed flags in place of its values. `long` is true if it says how long the run is: it has no other preset then.
fn over_file(args: &TrainArgs, (mut config, mut long): (TrainConfig, bool)) -> Result<TrainConfig> {
    if args.options.set_length() {
        config.lengths.clear();
        long = true;
    }
    if let Some(preset) = args.preset.or((!long).then_some(Preset::Standard)) {
        config.iterations = preset.iterations();
        config.lengths.clear();
        (config.time_budget, config.budget_cpu) = (None, None);
    }
    with_options(args, config)
}

/// Returns `config` with the typed flags in place of its own values. A folder of photos outside of the dataset has its whole path.
fn with_options(args: &TrainArgs, config: TrainConfig) -> Result<TrainConfig> {
    let mut config = args.options.over(config)?;
    if let (Some(dataset), Some(images)) = (&args.dataset, &config.images) {
        // An archive may have a folder of the name.
        let outside = dataset.is_dir() && !dataset.join(images).is_dir() && images.is_dir();
        if outside {
            config.images = std::path::absolute(images).ok().or(config.images);
        }
    }
    Ok(config)
}

/// Refuses a configuration with a list in the place of a table: its values would be taken by their order.
fn check_tables(given: &serde_json::Value) -> std::result::Result<(), String> {
    let default = serde_json::to_value(TrainConfig::default()).map_err(|e| e.to_string())?;
    let (Some(given), Some(default)) = (given.as_object(), default.as_object()) else {
        return Err("a table of options expected".to_owned());
    };
    let is_wrong = |key: &str, value: &serde_json::Value| match value.as_array() {
        Some(list) if key == "lengths" => list.iter().any(serde_json::Value::is_array),
        Some(_) => default.get(key).is_some_and(serde_json::Value::is_object),
        None => false,
    };
    match given.iter().find(|(key, value)| is_wrong(key, value)) {
        Some((key, _)) if key == "lengths" => Err("lengths: tables expected".to_owned()),
        Some((key, _)) => Err(format!("{key}: a table expected")),
        None => Ok(()),
    }
}

/// Returns the configuration of a file, and true if that says how long the run is.
///
/// # Errors
/// A file that cannot be read or parsed.
fn read_config(file: &Path) -> Result<(TrainConfig, bool)> {
    let text = std::fs::read_to_string(file).map_err(|e| Error::io(file, e))?;
    let text = text.trim_start_matches('\u{feff}').to_owned();
    let wrong = |what: String| {
        Error::input(
            file,
            what.trim().replace('\n', " "),
            "see `mhsplat train --help` for the names",
        )
    };
    if file.extension().is_some_and(|e| e == "json") {
        let value: serde_json::Value = from_json(&text).map_err(wrong)?;
        let inner = value.get("config").unwrap_or(&value).clone();
        check_tables(&inner).map_err(wrong)?;
        let long = LENGTHS.iter().any(|key| inner.get(key).is_some());
        let mut config: TrainConfig = deserialize(inner).map_err(wrong)?;
        without_later_options(&value, &mut config);
        return Ok((config, long));
    }
    let parse = |text| toml::Deserializer::parse(text).map_err(|e| wrong(e.to_string()));
    let table: toml::Table = deserialize(parse(&text)?).map_err(wrong)?;
    let as_json = serde_json::to_value(&table).map_err(|e| wrong(e.to_string()))?;
    check_tables(&as_json).map_err(wrong)?;
    let long = LENGTHS.iter().any(|key| table.contains_key(*key));
    Ok((deserialize(parse(&text)?).map_err(wrong)?, long))
}

#[cfg(test)]
mod tests {
    use super::apart;
    use mhsplat::run::Clock;

    #[test]
    fn what_is_done_once_counts_where_it_is_a_small_part_of_the_budget() {
        let nap = std::time::Duration::from_millis(100);
        let clocks = |budgets| {
            let mut clock = Clock::start();
            let sleep = || {
                std::thread::sleep(nap);
                Ok(())
            };
            apart(&mut clock, budgets, sleep).unwrap();
            let wall = clock.wall_seconds();
            assert!(clock.train_seconds() < 0.1);
            wall >= 0.1
        };
        assert!(clocks([Some(10.0), None]));
        assert!(!clocks([Some(0.5), None]));
        // Who sleeps takes no CPU seconds.
        assert!(clocks([None, Some(10.0)]));
        assert!(!clocks([None, None]));
    }
}
