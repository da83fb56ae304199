//! The beginning of a [`Run`]: anew, from its checkpoint, or beyond its end.

use std::borrow::Cow;
use std::path::Path;

use crate::base::error::{Error, Result};
use crate::base::files::FolderLock;
use crate::base::process::process_cpu_seconds;
use crate::capture::Dataset;
use crate::config::{Length, TrainConfig, TrainingSize};
use crate::device::{Defines, Device, Helpers};
use crate::evaluate::Evaluator;
use crate::pipeline::buffers::ViewSet;
use crate::pipeline::photos::Photos;
use crate::run::budget::{Budget, Pace, begin, go_on};
use crate::run::checkpoint::{self, Checkpoint};
use crate::run::clock::Clock;
use crate::run::drive::Run;
use crate::run::export::Exports;
use crate::run::forecast::{Forecast, picture_cost};
use crate::run::patience;
use crate::run::rank::{DatasetCopy, beginning};
use crate::run::record::{RECORD_FILE, RunRecord};
use crate::run::start;
use crate::run::table::{DENSITY_FILE, DensityWriter};
use crate::run::table::{METRICS_FILE, MetricsRow, MetricsWriter, read_rows};
use crate::scene::Gaussians;
use crate::train::{Begun, GaussianRows, Next, Plan, Trainer};

/// State that a run begins with.
struct From {
    plan: Plan,
    /// Lengths that the run is to have later, those of the run that it repeats.
    to_come: Vec<Length>,
    /// Checkpoint to go on from.
    saved: Option<Checkpoint>,
    /// Iterations that a run which has come to its end is to have then, as far as is known.
    extended: Option<u32>,
    /// The lock of the folder, if that is there already.
    lock: Option<FolderLock>,
}

/// Extension of a run that goes on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Extension {
    /// So many seconds more than it has had, on the clock of its budget.
    Seconds(f64),
    /// So many iterations altogether, whatever its budget was.
    Iterations(u32),
}

/// Iterations that a run goes on for at least where it has come to its end.
const FEWEST: u32 = 50;

impl Run {
    /// A new run. Its folder is made when nothing of the dataset or the device can fail any more; it must not exist, or be empty (see
    /// [`crate::run::claim_folder`]).
    ///
    /// # Errors
    /// A folder that cannot be made, or as [`Trainer::new`].
    pub fn start(
        dir: &Path,
        dataset: Dataset,
        config: TrainConfig,
        device: &Device,
        clock: Clock,
    ) -> Result<Self> {
        Self::begin(dir, dataset, config, device, clock, None)
    }

    /// A new run, or one that begins again in its locked folder.
    fn begin(
        dir: &Path,
        dataset: Dataset,
        config: TrainConfig,
        device: &Device,
        clock: Clock,
        lock: Option<FolderLock>,
    ) -> Result<Self> {
        config.validate()?;
        let (config, to_come) = begin(config);
        let dataset = start::with_points(dataset, &config)?;
        let plan = Plan::new(&dataset, &config)?.on_device(device);
        let from = From {
            plan,
            to_come,
            saved: None,
            extended: None,
            lock,
        };
        Self::open(dir, dataset, from, device, clock)
    }

    /// Continues the run in `dir` from its checkpoint, or begins it again where it was killed before the first one. `config` is
    /// that of [`crate::run::saved_config`], but for what may change on the way:
    /// the budgets for time and photos, and how often to evaluate, export and save. With an extension it goes on where it has come to its
    /// end, too.
    ///
    /// # Errors
    /// A damaged checkpoint, none in a folder of a run that came to its end, another dataset, a time budget or a patience that is used up,
    /// fewer iterations than it has had, or as [`Trainer::new`].
    pub fn resume(
        dir: &Path,
        dataset: Dataset,
        config: TrainConfig,
        device: &Device,
        clock: Clock,
        extension: Option<Extension>,
    ) -> Result<Self> {
        let lock = Some(FolderLock::take(dir)?);
        crate::base::files::sweep(dir);
        crate::base::files::sweep(&dir.join("checkpoint"));
        if !start::has_checkpoint(dir)? {
            start::check_unfinished(dir, &dataset)?;
            let mut config = config;
            match extension {
                Some(Extension::Seconds(time)) => {
                    *budget_of(&mut config) = Some(time);
                }
                Some(Extension::Iterations(all)) => {
                    let_iterate(&mut config);
                    config.iterations = all;
                }
                None => {}
            }
            if config.has_budget() || extension.is_some() {
                // Not to be repeated: the clock begins anew, too.
                config.lengths.clear();
            }
            return Self::begin(dir, dataset, config, device, clock, lock);
        }
        let saved = checkpoint::read(dir)?;
        if saved.dataset != dataset.fingerprint() {
            return Err(Error::input(
                &dataset.path,
                dataset.not_that_of(dir),
                "give the dataset of that run, or start anew with -o",
            ));
        }
        let mut config = config;
        // What was read before the folder was locked may be older.
        config.lengths.clone_from(&saved.config.lengths);
        let done = saved.state.iteration;
        let ended = done >= saved.config.last_iterations();
        let used = [saved.clock.wall_seconds, saved.clock.all_cpu_seconds];
        let extended = match extension {
            Some(Extension::Seconds(more)) => {
                let so_far = used[usize::from(config.budget_cpu.is_some())];
                *budget_of(&mut config) = Some(so_far + more);
                let longer = f64::from(done) * (1.0 + more / so_far.max(1e-3));
                let longer = (longer as u32).max(done.saturating_add(FEWEST));
                ended.then_some(longer)
            }
            Some(Extension::Iterations(all)) => {
                let what = format!("{all}; the run has had {done} already, more expected");
                Error::unless(all > done, "--iterations", &what)?;
                let_iterate(&mut config);
                (all != saved.config.last_iterations()).then_some(all)
            }
            None => {
                check_budgets(&config, &saved.config, used, ended)?;
                None
            }
        };
        if let Some(fault) = saved.tuning.fault(device.info()) {
            return Err(Error::input(
                checkpoint::path(dir),
                format!("its kernels cannot be built for this device ({fault})"),
                "resume on the device it was trained on, with --device",
            ));
        }
        // Another tuning would add in another order: the run goes on as it began.
        let device = device.clone().with_tuning(saved.tuning);
        config.validate()?;
        let changed = extended.is_some() || config != saved.config;
        let (config, mut to_come) = go_on(config, done);
        if extended.is_some() {
            to_come.clear();
        }
        let begun = Begun {
            anti_aliasing: Some(!saved.state.rows.filter.is_empty()),
            detail: Some(saved.state.detail.clone()),
            clearance: Some(saved.state.clearance.clone()),
            background: Some(saved.state.background),
        };
        let dataset = dataset.as_begun(saved.state.swept);
        let plan = Plan::begun(&dataset, &config, &begun)?.on_device(&device);
        let from = From {
            plan,
            to_come,
            saved: Some(saved),
            extended,
            lock,
        };
        let mut run = Self::open(dir, dataset, from, &device, clock)?;
        if changed {
            // Who is killed before the next checkpoint goes on by the new length or budget, too.
            run.save(true, false)?;
        }
        Ok(run)
    }

    /// Begins the run, or goes on from its checkpoint. The photos move to the device one by one, so that nobody holds their pixels on
    /// the host from then on.
    fn open(
        dir: &Path,
        dataset: Dataset,
        from: From,
        device: &Device,
        clock: Clock,
    ) -> Result<Self> {
        let From {
            plan,
            to_come,
            saved,
            extended,
            lock,
        } = from;
        let again = lock.is_some();
        check_clock(&plan.config)?;
        let mut record = start::record(&dataset, &plan, device);
        record.config.lengths.extend(&to_come);
        if saved.is_some() && dir.join(RECORD_FILE).exists() {
            // A finished run keeps what its trace has shown.
            let before = RunRecord::read(dir)?;
            record.funnel = before.funnel;
            record.peak_rss_bytes = before.peak_rss_bytes;
        }
        let mut exports = Exports::new(&dataset, plan.behind());
        let splats = match &saved {
            Some(saved) => Cow::Borrowed(&saved.state.splats),
            None => Cow::Owned(start::first(&dataset, &plan, &mut exports.remarks)?),
        };
        let (mut trainer, test) = trainer(device, dataset, &plan, &splats)?;
        if saved.is_none() {
            trainer.spread_from_host(&splats, &GaussianRows::default())?;
        }
        let defines = Defines::new(device.tuning());
        let evaluator = (!test.is_empty()).then(|| Evaluator::new(device, defines, test));
        let evaluator = evaluator.transpose()?;
        let [metrics, density] = [METRICS_FILE, DENSITY_FILE].map(|name| dir.join(name));
        let mut rows = Vec::new();
        if let Some(Checkpoint { state, .. }) = &saved {
            trainer.restore(state)?;
            if let Some(length) = extended {
                trainer.set_length(length, size_beyond(&plan.config))?;
                record
                    .config
                    .lengths
                    .clone_from(&trainer.plan().config.lengths);
            }
            rows = read_rows::<MetricsRow>(&metrics)?;
            rows.retain(|row| row.iteration <= state.iteration);
        } else if again {
            record.write(dir)?;
        }
        let losses = patience::losses(&rows, trainer.full_size_from());
        patience::check(&plan.config, &losses)?;
        let done = saved.as_ref().map(|saved| saved.state.iteration);
        let stepped = saved.as_ref().map(stepped);
        // The trainer's configuration: an extension has made it longer.
        let sizes = sizes(&trainer, done);
        let pace = Pace::new(&trainer.plan().for_budgets(), to_come, sizes);
        let forecast = forecast(device, &trainer, evaluator.as_ref(), pace.budget())?;
        let clock = match &saved {
            Some(saved) => clock.after(saved.clock),
            None => clock,
        };
        let lock = match lock {
            Some(lock) => lock,
            None => start::make_folder(dir, &record)?,
        };
        let free = |_: &Error| {
            if !again {
                start::abandon_folder(dir);
            }
        };
        let metrics = MetricsWriter::open(metrics, done).inspect_err(free)?;
        let density = DensityWriter::open(density, stepped).inspect_err(free)?;
        let mut run = Self {
            _lock: lock,
            dir: dir.to_path_buf(),
            exports,
            pace,
            forecast,
            began: (done.unwrap_or(0), clock.train_seconds()),
            config: plan.config,
            trainer,
            evaluator,
            record,
            losses,
            metrics,
            density,
            clock,
            stages: saved.map_or_else(Vec::new, |saved| saved.stages),
            psnr: None,
            loss: None,
            evaluated: rows.last().map(|row| row.iteration),
            saved: done,
            watch: None,
        };
        run.write_record().inspect_err(free)?;
        Ok(run)
    }
}

/// The trainer of a dataset's training views, and the held-out views, whose photos share one budget. The device's helpers train, too.
fn trainer(
    device: &Device,
    dataset: Dataset,
    plan: &Plan,
    splats: &Gaussians,
) -> Result<(Trainer, ViewSet)> {
    let budget = dataset.image_budget;
    let shared = match device.helpers() {
        Helpers::Devices(_) => dataset.train.clone(),
        _ => Vec::new(),
    };
    let (path, copy) = match device.helpers() {
        Helpers::Processes(_) => (dataset.path.clone(), DatasetCopy::of(&dataset)),
        _ => Default::default(),
    };
    let photos = Photos::new(device, budget);
    let train = ViewSet::new(&photos, dataset.train)?;
    let test = ViewSet::new(&photos, dataset.test)?;
    let splats = match device.helpers() {
        Helpers::None => Cow::Borrowed(splats),
        // Of no meaning: each device gets its part of the rows, and none all of them.
        _ => Cow::Owned(Gaussians::zeros(splats.sh_degree(), 1)),
    };
    let mut trainer = Trainer::with_views(train, plan, &splats)?;
    trainer.recruit(device.helpers(), &shared, budget, |trainer| {
        beginning((&path, copy), trainer, splats.sh_degree())
    })?;
    Ok((trainer, test))
}

/// The sizes of photos that a budget chooses from, the largest first: all where the run begins, no smaller ones than before where it goes on
/// from its end, which it has had `done` iterations before, else that which it has. Photos that cannot be halved keep their size.
fn sizes(trainer: &Trainer, done: Option<u32>) -> Vec<TrainingSize> {
    let config = &trainer.plan().config;
    let now = config.last_size();
    let from_its_end = match config.lengths.split_last() {
        Some((last, before)) => {
            let end = before.last().map_or(config.iterations, |l| l.iterations);
            Some(last.from) == done && last.from >= end
        }
        None => false,
    };
    let may_be = |size: &TrainingSize| match trainer.halves() {
        true if done.is_none() => true,
        true if from_its_end => size.area() >= now.area(),
        _ => *size == now,
    };
    TrainingSize::ALL.into_iter().filter(may_be).collect()
}

/// The forecast of a run that begins or goes on.
fn forecast(
    device: &Device,
    trainer: &Trainer,
    evaluator: Option<&Evaluator>,
    budget: Option<&Budget>,
) -> Result<Forecast> {
    if let Some(evaluator) = evaluator {
        // The end is to take no compiler's time, and not to fail for want of room.
        evaluator.warm_up()?;
    }
    // The clocks of all processes are added up.
    let shortest = Budget::shortest(budget) * device.helpers().ranks() as f64;
    let times = [Budget::latest(budget), shortest];
    // One device takes FLIP, while others that share the iterations wait.
    let ranks = match budget.is_some_and(|budget| budget.cpu) {
        true => 1,
        false => device.helpers().ranks(),
    };
    let host = (picture_cost()?, ranks);
    Ok(Forecast::new(trainer, evaluator, times, host))
}

/// The budget that a run goes by, or the one of time if it has none.
fn budget_of(config: &mut TrainConfig) -> &mut Option<f64> {
    match config.budget_cpu.is_some() {
        true => &mut config.budget_cpu,
        false => &mut config.time_budget,
    }
}

/// The size of the photos beyond the end of a run: as it was, or the one asked for where no budget is left.
fn size_beyond(config: &TrainConfig) -> TrainingSize {
    match config.has_budget() {
        true => config.last_size(),
        false => TrainingSize::Full,
    }
}

/// Takes the budgets away, so that iterations alone say how long a run is.
fn let_iterate(config: &mut TrainConfig) {
    (config.time_budget, config.budget_cpu) = (None, None);
}

/// Refuses a budget of CPU seconds where nobody counts them.
fn check_clock(config: &TrainConfig) -> Result<()> {
    let what = "this system does not tell the CPU seconds of a process; use --time-budget";
    let counted = config.budget_cpu.is_none() || process_cpu_seconds() > 0.0;
    Error::unless(counted, "--budget-cpu", what)
}

/// The last iteration whose density step is in the table already: that of a step that the checkpoint comes before is written again.
fn stepped(saved: &Checkpoint) -> u32 {
    if let Some(step) = &saved.state.deciding {
        return step.begun.saturating_sub(1);
    }
    match saved.state.next {
        Next::Pause | Next::Density => saved.state.iteration.saturating_sub(1),
        _ => saved.state.iteration,
    }
}

/// Refuses another budget than a run had so far where it changes nothing: `used` are wall and CPU seconds.
fn check_budgets(
    asked: &TrainConfig,
    saved: &TrainConfig,
    used: [f64; 2],
    ended: bool,
) -> Result<()> {
    let budgets = |config: &TrainConfig| [config.time_budget, config.budget_cpu];
    if budgets(asked) == budgets(saved) {
        // The run's own may be used up: then it is brought to its end.
        return Ok(());
    }
    if ended {
        let what =
            "the run has come to its end already; give what it is to have more with --extend";
        return Err(Error::config("--time-budget", what));
    }
    for (name, budget, used) in [
        ("--time-budget", asked.time_budget, used[0]),
        ("--budget-cpu", asked.budget_cpu, used[1]),
    ] {
        if budget.is_some_and(|budget| used >= budget) {
            let what = format!("{used:.0} s are gone already; give a larger one, or --extend");
            return Err(Error::config(name, what));
        }
    }
    Ok(())
}
