//! Run folders as they are compared, and the refusal of those that are not comparable.

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use serde::Serialize;

use crate::base::error::{Error, Result};
use crate::lab::compare::curve::Curve;
use crate::lab::table::folder_name;
use crate::run::report::settings::flatten;
use crate::run::{METRICS_FILE, MetricsRow, RECORD_FILE, RunRecord, read_rows};

/// Options that change no result, or only by chance.
const BESIDE: [&str; 7] = [
    "seed",
    "trace-density",
    "eval-every",
    "export-every",
    "export",
    "checkpoint-every",
    "image-budget",
];

const CPU_NOTE: &str = "Times are CPU seconds of the process while training, loading included, evaluations and kernels \
                        compiled in mid-run left out: other programs on the machine change them least.";
const TRAIN_NOTE: &str = "Times are seconds of training, loading included, evaluations and kernels compiled in mid-run \
                          left out; other programs on the machine delay them.";

/// A clock to compare runs by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Default, ValueEnum)]
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
    pub fn all() -> impl Iterator<Item = Self> {
        Self::value_variants().iter().copied()
    }

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

    /// Name with its unit, quantity on an axis, and what the times include.
    #[must_use]
    pub fn words(self) -> [&'static str; 3] {
        match self {
            Self::Cpu => ["CPU seconds", "CPU time", CPU_NOTE],
            Self::Train => ["training seconds", "training time", TRAIN_NOTE],
            Self::Wall => [
                "wall seconds",
                "wall time",
                "Times are seconds since the start, evaluations included.",
            ],
            Self::Iterations => ["iterations", "iterations", ""],
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

/// Name and value of a fact that may tell a run from others.
pub type Fact = (String, String);

/// A run that was read; as JSON, its last evaluation.
#[derive(Debug, Clone, Serialize)]
pub struct Loaded {
    /// Folder.
    pub path: String,
    /// Name of its group as given.
    #[serde(skip)]
    pub group: Option<String>,
    /// Seed.
    pub seed: u64,
    /// True if the scores are those of the end, not of the last evaluation before something stopped the run.
    pub finished: bool,
    /// Its last evaluation; the Gaussians include those removed after it because no training view shows them.
    #[serde(flatten)]
    pub last: MetricsRow,
    /// Mean FLIP of the end; `None` for unfinished runs and those of earlier versions.
    pub flip: Option<f64>,
    /// Content of `run.json`.
    #[serde(skip)]
    pub record: RunRecord,
    /// Rows of `metrics.csv` that evaluated held-out views, at least one.
    #[serde(skip)]
    pub rows: Vec<MetricsRow>,
    /// Dataset, seed, and [`Loaded::setting`].
    #[serde(skip)]
    pub facts: Vec<Fact>,
}

impl Loaded {
    /// A quantity of every evaluation over a clock.
    #[must_use]
    pub fn curve(&self, clock: Clock, of: impl Fn(&MetricsRow) -> Option<f64>) -> Curve {
        let point = |r: &MetricsRow| Some((clock.of(r), of(r)?));
        Curve::new(self.rows.iter().filter_map(point))
    }

    /// Returns true if every row has a reading of the clock.
    #[must_use]
    pub fn has(&self, clock: Clock) -> bool {
        clock != Clock::Cpu || self.rows.iter().all(|r| r.cpu_seconds > 0.0)
    }

    /// Value of a fact.
    #[must_use]
    pub fn fact(&self, name: &str) -> &str {
        let found = self.facts.iter().find(|f| f.0 == name);
        found.map_or("none", |f| f.1.as_str())
    }

    /// Options that change a result by more than chance, device and version.
    #[must_use]
    pub fn setting(&self) -> &[Fact] {
        &self.facts[2..]
    }
}

/// Everything that may tell two runs apart.
fn facts(record: &RunRecord) -> Vec<Fact> {
    let fact = |(name, value): (&str, &str)| (name.to_owned(), value.to_owned());
    let seed = record.seed.to_string();
    let run = [("dataset", record.dataset.path.as_str()), ("seed", &seed)];
    let options = flatten(&record.config).into_iter();
    let options = options.filter(|(name, _)| !BESIDE.contains(&name.as_str()));
    let device = &record.device;
    let machine = [
        ("device", device.name.as_str()),
        ("platform", &device.platform),
        ("driver", &device.driver),
        ("version", &record.version),
        ("commit", &record.commit),
    ];
    let run = run.map(fact).into_iter();
    run.chain(options).chain(machine.map(fact)).collect()
}

/// Returns true if a run came to its end: by its iterations, its time budget or its patience.
#[must_use]
pub fn finished(record: &RunRecord) -> bool {
    // Records of earlier versions do not say that they ran out of time.
    let out_of_time = |budget: f64| record.out_of_time || record.train_seconds >= budget;
    record.iterations >= record.config.last_iterations()
        || record.stalled.is_some()
        || record
            .config
            .time_budget
            .map_or(record.out_of_time, out_of_time)
}

/// Reads a run and adds its caveats to `warnings`; `None` for one without any evaluation yet.
fn load(source: &Source, warnings: &mut Vec<String>) -> Result<Option<Loaded>> {
    let dir = &source.path;
    for name in [RECORD_FILE, METRICS_FILE] {
        if !dir.join(name).is_file() {
            let what = match dir.exists() {
                true => format!("holds no {name}"),
                false => "no such folder".to_owned(),
            };
            let fix = "give the folder that `mhsplat train -o` wrote";
            return Err(Error::input(dir, what, fix));
        }
    }
    let record = RunRecord::read(dir)?;
    let rows = read_rows::<MetricsRow>(dir.join(METRICS_FILE))?;
    let mut rows: Vec<_> = rows.into_iter().filter(|r| r.psnr.is_some()).collect();
    // Those that are removed at the end were trained.
    if let Some(last) = rows.last_mut().filter(|_| finished(&record)) {
        last.gaussians += record.removed;
    }
    let name = dir.display().to_string();
    let Some(last) = rows.last().copied() else {
        let why = match record.dataset.test_views {
            0 => "no view was held out",
            _ => "not evaluated yet",
        };
        warnings.push(format!("{name}: left out, {why}"));
        return Ok(None);
    };
    let finished = finished(&record);
    if !finished {
        let (done, all) = (record.iterations, record.config.last_iterations());
        warnings.push(format!(
            "{name}: unfinished, {done} of {all} iterations; its evaluation after {} stands for its end",
            last.iteration
        ));
    }
    let scores = record.final_scores.as_ref().filter(|_| finished);
    Ok(Some(Loaded {
        path: name,
        group: source.group.clone(),
        seed: record.seed,
        finished,
        last,
        flip: scores.and_then(|f| f.mean.flip),
        facts: facts(&record),
        record,
        rows,
    }))
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
        if !seen.contains(&real) {
            seen.push(real);
            runs.extend(load(source, warnings)?);
        }
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

/// The reason why two runs are not comparable; `None` if they are.
fn difference(a: &Loaded, b: &Loaded) -> Option<String> {
    let (x, y) = (&a.record.dataset, &b.record.dataset);
    if (x.width, x.height) != (y.width, y.height) {
        let [from, to] = [x, y].map(|d| format!("{} × {}", d.width, d.height));
        return Some(format!("another resolution, {to} instead of {from} pixels"));
    }
    if (x.train_views, x.test_views) != (y.train_views, y.test_views) {
        let [from, to] = [x, y].map(|d| format!("{} + {}", d.train_views, d.test_views));
        return Some(format!(
            "another split, {to} instead of {from} training and held-out views"
        ));
    }
    let scores = [a, b].map(|r| r.record.final_scores.iter().flat_map(|f| &f.per_view));
    let [p, q] = scores.map(|views| views.map(|v| &v.view).collect::<Vec<_>>());
    if p != q && !p.is_empty() && !q.is_empty() {
        return Some("other held-out views".into());
    }
    let same = match (&x.fingerprint, &y.fingerprint) {
        (Some(p), Some(q)) => p == q,
        // Records of earlier versions have no fingerprint. Folders move, their names rarely change.
        _ => x.layout == y.layout && folder_name(&x.path) == folder_name(&y.path),
    };
    (!same).then(|| {
        format!(
            "another dataset, {} instead of {}: views, cameras, lenses, sizes or masks differ, or one run is of an earlier version",
            y.path, x.path
        )
    })
}

/// Refuses runs of another dataset, resolution, split or other held-out views than the first one's, or warns of them if
/// `allow` is set.
///
/// # Errors
/// The first such run.
pub fn check_comparable(runs: &[Loaded], allow: bool, warnings: &mut Vec<String>) -> Result<()> {
    let background = |r: &Loaded| r.record.background();
    let first = &runs[0];
    for run in &runs[1..] {
        let (path, against) = (&run.path, &first.path);
        if let Some(what) = difference(first, run) {
            if !allow {
                return Err(Error::input(
                    path,
                    format!("{what} (of {against}): not comparable"),
                    "leave it out, or give --allow-different",
                ));
            }
            warnings.push(format!("not comparable: {path} has {what} (of {against})"));
        } else if background(run) != background(first) {
            warnings.push(format!(
                "{path}: scored over another background, which counts where photos are transparent or no Gaussian is (of {against})"
            ));
        }
    }
    Ok(())
}
