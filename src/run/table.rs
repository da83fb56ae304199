//! CSV tables that grow during a run: a header, then one row per evaluation or density step, flushed at once.
//!
//! Cells hold numbers only, so nothing is quoted. An absent number is an empty cell.

use std::fs::{File, OpenOptions};
use std::io::Write;
use std::marker::PhantomData;
use std::path::{Path, PathBuf};

use csv::{ReaderBuilder, StringRecord, Trim, WriterBuilder};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::base::error::{Error, Result};
use crate::density::DensityStats;

/// A row of a table. Its fields are written in their order, nested ones flattened, as many as there are columns.
pub trait Row: Serialize + DeserializeOwned {
    /// Column names, in order, separated by commas.
    const COLUMNS: &'static str;

    /// Iteration the row belongs to; a resumed run drops the rows beyond its checkpoint.
    fn iteration(&self) -> u32;
}

/// Name of the table of evaluations in the run folder.
pub const METRICS_FILE: &str = "metrics.csv";

/// Name of the table of density steps in the run folder; from it the report can be made again after a resume.
pub const DENSITY_FILE: &str = "density.csv";

/// Appends to `metrics.csv`.
pub type MetricsWriter = TableWriter<MetricsRow>;

/// Appends to `density.csv`.
pub type DensityWriter = TableWriter<DensityRow>;

/// State of a run at one evaluation. Counts are sums since the start of the run.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct MetricsRow {
    /// Iterations done.
    pub iteration: u32,
    /// Seconds of training, evaluation and export left out.
    pub train_seconds: f64,
    /// Seconds since the start.
    pub wall_seconds: f64,
    /// CPU seconds over the span of `train_seconds`.
    pub cpu_seconds: f64,
    /// Training loss; absent before the first iteration.
    pub loss: Option<f64>,
    /// Mean PSNR of the held-out views in dB; absent without such views.
    pub psnr: Option<f64>,
    /// Mean SSIM of the held-out views; absent without such views.
    pub ssim: Option<f64>,
    /// Number of Gaussians.
    pub gaussians: u64,
    /// Proposed births.
    pub proposed: u64,
    /// Accepted births.
    pub accepted: u64,
    /// Dead Gaussians moved.
    pub relocated: u64,
    /// Gaussians removed.
    pub pruned: u64,
    /// Non-finite values met (and stopped) in gradients or parameters.
    pub non_finite: u64,
}

impl Row for MetricsRow {
    const COLUMNS: &'static str = "iteration,train_seconds,wall_seconds,cpu_seconds,loss,psnr,ssim,gaussians,proposed,accepted,relocated,pruned,non_finite";

    fn iteration(&self) -> u32 {
        self.iteration
    }
}

/// One density step.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct DensityRow {
    /// Iteration of the step.
    pub iteration: u32,
    /// Seconds of training so far.
    pub train_seconds: f64,
    /// Number of Gaussians after the step.
    pub gaussians: u64,
    /// Counts of this step (not sums over the run); zero for those that the sampler does not have.
    pub stats: DensityStats,
}

impl Row for DensityRow {
    const COLUMNS: &'static str = "iteration,train_seconds,gaussians,proposed,accepted,relocated,pruned,coarse_proposed,coarse_accepted,fine_proposed,fine_accepted,occupied_voxels,mean_prior,cloned,split,opacity_resets,pixel_proposed,pixel_accepted";

    fn iteration(&self) -> u32 {
        self.iteration
    }
}

/// Appends rows to a table.
#[derive(Debug)]
pub struct TableWriter<R> {
    path: PathBuf,
    file: File,
    row: PhantomData<fn(&R)>,
}

impl<R: Row> TableWriter<R> {
    /// A new table, which replaces an existing file, or, after a resume from `iteration`, an existing table without its rows of
    /// later iterations and a last line that a crash cut short.
    ///
    /// # Errors
    /// [`Error::Input`] when the file to go on with is another table, [`Error::Io`] when it cannot be read or written.
    pub fn open(path: impl AsRef<Path>, iteration: Option<u32>) -> Result<Self> {
        let path = path.as_ref();
        let mut text = format!("{}\n", R::COLUMNS);
        if let Some(iteration) = iteration.filter(|_| path.exists()) {
            let rows = read_rows::<R>(path)?.into_iter();
            for row in rows.filter(|row| row.iteration() <= iteration) {
                text.push_str(&line(path, &row)?);
            }
        }
        crate::base::files::write_bytes(path, text.as_bytes())?;
        let file = OpenOptions::new().append(true).open(path);
        Ok(Self {
            path: path.to_path_buf(),
            file: file.map_err(|e| Error::io(path, e))?,
            row: PhantomData,
        })
    }

    /// Adds a row; on return the system has it.
    ///
    /// # Errors
    /// [`Error::Numerics`] when a number is not finite (nothing is written), [`Error::Io`] when writing fails.
    pub fn write(&mut self, row: &R) -> Result<()> {
        let text = line(&self.path, row)?;
        self.file
            .write_all(text.as_bytes())
            .and_then(|()| self.file.flush())
            .map_err(|e| Error::io(&self.path, e))
    }
}

/// All complete rows of the table at `path`. A last line without its newline was cut short and is left out.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read, [`Error::Input`] when the header or a row is not this table's.
pub fn read_rows<R: Row>(path: impl AsRef<Path>) -> Result<Vec<R>> {
    let path = path.as_ref();
    let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, e))?;
    let complete = text.rfind('\n').map_or("", |end| &text[..end]);
    let (header, rows) = complete.split_once('\n').unwrap_or((complete, ""));
    let (expected, count) = (R::COLUMNS, R::COLUMNS.split(',').count());
    if header.trim() != expected {
        let what = format!("header is `{}`, expected `{expected}`", header.trim());
        return Err(Error::input(path, what, "remove or rename the file"));
    }
    let mut reader = ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .trim(Trim::All)
        .from_reader(rows.as_bytes());
    let parse = |record: csv::Result<StringRecord>| {
        let record = record.map_err(|e| Error::input(path, e.to_string(), "remove the line"))?;
        let row = record.deserialize(None).ok();
        let finite = |cell: &str| !cell.parse().is_ok_and(|v: f64| !v.is_finite());
        let whole = record.len() == count && record.iter().all(finite);
        row.filter(|_| whole).ok_or_else(|| {
            let what = format!(
                "line {}: `{}`, expected {count} finite numbers",
                record.position().map_or(0, |p| p.line() + 1),
                record.iter().collect::<Vec<_>>().join(","),
            );
            Error::input(path, what, "remove the line")
        })
    };
    reader.records().map(parse).collect()
}

/// The line of a row. Numbers are written as `Display` spells them: the shortest digits that read back as the same bits.
fn line<R: Row>(path: &Path, row: &R) -> Result<String> {
    let refused = |what: String| Error::numerics(path.display().to_string(), what);
    let mut writer = WriterBuilder::new()
        .has_headers(false)
        .from_writer(Vec::new());
    let written = writer.serialize(row).map_err(|e| refused(e.to_string()));
    let bytes = written.and_then(|()| writer.into_inner().map_err(|e| refused(e.to_string())))?;
    let text = String::from_utf8_lossy(&bytes);
    let cells = text.trim_end().split(',').zip(R::COLUMNS.split(','));
    let plain = cells.map(|(cell, column)| match cell.parse::<f64>() {
        Ok(value) if !value.is_finite() => Err(refused(format!(
            "{column} is {value} at iteration {}; only finite numbers are written",
            row.iteration()
        ))),
        // The crate writes 3.0 and 1e16; counts beyond 2⁵³ must not pass through f64.
        Ok(value) if cell.contains(['.', 'e']) => Ok(value.to_string()),
        _ => Ok(cell.to_owned()),
    });
    Ok(plain.collect::<Result<Vec<_>>>()?.join(",") + "\n")
}
