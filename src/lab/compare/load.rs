//! Run folders as they are compared.

use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::base::error::{Error, Result};
use crate::lab::compare::curve::Curve;
use crate::run::{METRICS_FILE, MetricsRow, RECORD_FILE, RunRecord, read_rows};

/// A clock to compare runs by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Default, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Clock {
    /// CPU seconds of the process while training: the clock to compare by if other programs share the machine.
    #[default]
    Cpu,
    /// Seconds of training; evaluation and export left out.
    Train,
    /// Seconds since the start.
    Wall,
    /// Iterations.
    Iterations,
}

impl Clock {
    /// All of them, in the order of the page.
    pub const ALL: [Self; 4] = [Self::Cpu, Self::Train, Self::Wall, Self::Iterations];

    /// Reading at an evaluation.
    #[must_use]
    pub fn of(self, row: &MetricsRow) -> f64 {
        match self {
            Self::Cpu => row.cpu_seconds,
            Self::Train => row.train_seconds,
            Self::Wall => row.wall_seconds,
            Self::Iterations => f64::from(row.iteration),
        }
    }

    /// Name and unit.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Cpu => "CPU seconds",
            Self::Train => "training seconds",
            Self::Wall => "wall seconds",
            Self::Iterations => "iterations",
        }
    }
}

/// A run to compare, by itself or as a sample of a named group.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Source {
    /// Name of its group; `None`: grouped by its options.
    pub group: Option<String>,
    /// Run folder.
    pub path: PathBuf,
}

impl Source {
    /// Parses `RUN` or `NAME=RUN`; a folder whose own name has the sign is itself.
    #[must_use]
    pub fn parse(text: &str) -> Self {
        let whole = Self {
            group: None,
            path: text.into(),
        };
        match text.split_once('=') {
            Some((name, path)) if !name.is_empty() && !whole.path.exists() => Self {
                group: Some(name.into()),
                path: path.into(),
            },
            _ => whole,
        }
    }
}

/// A run that was read.
#[derive(Debug, Clone)]
pub struct Loaded {
    /// Path and group as given.
    pub source: Source,
    /// Content of `run.json`.
    pub record: RunRecord,
    /// Rows of `metrics.csv` that evaluated held-out views, at least one.
    pub rows: Vec<MetricsRow>,
}

impl Loaded {
    /// A quantity of every evaluation over a clock.
    #[must_use]
    pub fn curve(&self, clock: Clock, of: impl Fn(&MetricsRow) -> Option<f64>) -> Curve {
        let point = |r: &MetricsRow| Some((clock.of(r), of(r)?));
        Curve::new(self.rows.iter().filter_map(point))
    }

    /// PSNR over a clock.
    #[must_use]
    pub fn psnr(&self, clock: Clock) -> Curve {
        self.curve(clock, |r| r.psnr)
    }

    /// Returns true if every row has CPU seconds.
    #[must_use]
    pub fn has_cpu(&self) -> bool {
        self.rows.iter().all(|r| r.cpu_seconds > 0.0)
    }

    /// Returns true if the scores are those of the end, not of the last evaluation before something stopped the run.
    #[must_use]
    pub fn finished(&self) -> bool {
        finished(&self.record)
    }
}

/// Returns true if a run came to its end: by its iterations, its time budget or its patience.
#[must_use]
pub fn finished(record: &RunRecord) -> bool {
    let out_of_time = |budget: f64| record.train_seconds >= budget;
    record.iterations >= record.config.iterations
        || record.stalled.is_some()
        || record.config.time_budget.is_some_and(out_of_time)
}

/// Reads a run and adds its caveats to `warnings`; `None` for one without any evaluation yet.
fn load(source: &Source, warnings: &mut Vec<String>) -> Result<Option<Loaded>> {
    let dir = &source.path;
    let fix = "give the folder that `mhsplat train -o` wrote";
    let missing = |name: &str| -> Result<()> {
        if dir.join(name).is_file() {
            return Ok(());
        }
        let what = match dir.exists() {
            true => format!("holds no {name}"),
            false => "no such folder".to_owned(),
        };
        Err(Error::input(dir, what, fix))
    };
    missing(RECORD_FILE)?;
    missing(METRICS_FILE)?;
    let record = RunRecord::read(dir)?;
    let rows = read_rows::<MetricsRow>(dir.join(METRICS_FILE))?;
    let rows: Vec<_> = rows.into_iter().filter(|r| r.psnr.is_some()).collect();
    let name = dir.display();
    if rows.is_empty() {
        let why = match record.dataset.test_views {
            0 => "no view was held out",
            _ => "not evaluated yet",
        };
        warnings.push(format!("{name}: left out, {why}"));
        return Ok(None);
    }
    let run = Loaded {
        source: source.clone(),
        record,
        rows,
    };
    if !run.finished() {
        let (done, all) = (run.record.iterations, run.record.config.iterations);
        let last = run.rows.last().map_or(0, |r| r.iteration);
        warnings.push(format!(
            "{name}: unfinished, {done} of {all} iterations; its evaluation after {last} stands for its end"
        ));
    }
    Ok(Some(run))
}

/// Reads all runs. A folder that is given twice counts once.
///
/// # Errors
/// A folder that is no run, files of it that cannot be read, or nothing that can be compared.
pub fn load_all(sources: &[Source], warnings: &mut Vec<String>) -> Result<Vec<Loaded>> {
    let mut seen: Vec<PathBuf> = Vec::new();
    let mut runs = Vec::new();
    for source in sources {
        let real = std::fs::canonicalize(&source.path).unwrap_or_else(|_| source.path.clone());
        if seen.contains(&real) {
            warnings.push(format!("{}: given twice", source.path.display()));
            continue;
        }
        seen.push(real);
        runs.extend(load(source, warnings)?);
    }
    if runs.is_empty() {
        let first = sources.first().map_or(Path::new("."), |s| s.path.as_path());
        return Err(Error::input(
            first,
            "no run with an evaluation of held-out views",
            "wait for one, or hold views out with --test-every",
        ));
    }
    Ok(runs)
}
