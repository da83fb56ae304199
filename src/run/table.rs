//! CSV tables that grow during a run: a header, then one row per event, flushed at once.
//!
//! Cells hold numbers only, so nothing is quoted. An absent number is an empty cell.

use std::fs::{File, OpenOptions};
use std::io::Write;
use std::marker::PhantomData;
use std::path::{Path, PathBuf};

use csv::{ReaderBuilder, StringRecord, Trim, WriterBuilder};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::base::error::{Error, Result};

/// A row of a table. Its fields are written in their order, nested ones flattened, as many as there are columns.
pub trait Row: Serialize + DeserializeOwned {
    /// Column names, in order.
    const COLUMNS: &'static [&'static str];

    /// Iteration the row belongs to; a resumed run drops the rows beyond its checkpoint.
    fn iteration(&self) -> u32;
}

/// Appends rows to a table.
#[derive(Debug)]
pub struct TableWriter<R> {
    path: PathBuf,
    file: File,
    row: PhantomData<fn(&R)>,
}

impl<R: Row> TableWriter<R> {
    /// A new table with a header and no rows; an existing file is replaced.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be written.
    pub fn create(path: impl AsRef<Path>) -> Result<Self> {
        Self::with_rows(path.as_ref(), &[])
    }

    /// Continues an existing table after a resume: rows of iterations beyond `iteration`, and a last line that a crash cut
    /// short, are dropped. Without a file, a new table.
    ///
    /// # Errors
    /// [`Error::Input`] when the file is another table, [`Error::Io`] when it cannot be read or written.
    pub fn append(path: impl AsRef<Path>, iteration: u32) -> Result<Self> {
        let path = path.as_ref();
        let mut rows = Vec::new();
        if path.exists() {
            rows = read_table::<R>(path)?;
            rows.retain(|r| r.iteration() <= iteration);
        }
        Self::with_rows(path, &rows)
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

    fn with_rows(path: &Path, rows: &[R]) -> Result<Self> {
        let mut text = R::COLUMNS.join(",") + "\n";
        for row in rows {
            text.push_str(&line(path, row)?);
        }
        crate::base::files::write_bytes(path, text.as_bytes())?;
        let file = OpenOptions::new()
            .append(true)
            .open(path)
            .map_err(|e| Error::io(path, e))?;
        Ok(Self {
            path: path.to_path_buf(),
            file,
            row: PhantomData,
        })
    }
}

/// All complete rows of the table at `path`. A last line without its newline was cut short and is left out.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read, [`Error::Input`] when the header or a row is not this table's.
pub fn read_table<R: Row>(path: impl AsRef<Path>) -> Result<Vec<R>> {
    let path = path.as_ref();
    let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, e))?;
    let complete = text.rfind('\n').map_or("", |end| &text[..end]);
    let (header, rows) = complete.split_once('\n').unwrap_or((complete, ""));
    let expected = R::COLUMNS.join(",");
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
        let whole = record.len() == R::COLUMNS.len() && record.iter().all(finite);
        row.filter(|_| whole).ok_or_else(|| {
            let what = format!(
                "line {}: `{}`, expected {} finite numbers",
                record.position().map_or(0, |p| p.line() + 1),
                record.iter().collect::<Vec<_>>().join(","),
                R::COLUMNS.len()
            );
            Error::input(path, what, "remove the line")
        })
    };
    reader.records().map(parse).collect()
}

/// The line of a row. Numbers are written as `Display` spells them: the shortest digits that read back as the same bits.
fn line<R: Row>(path: &Path, row: &R) -> Result<String> {
    let refused = |what: String| Error::Numerics {
        stage: path.display().to_string(),
        what,
    };
    let mut writer = WriterBuilder::new()
        .has_headers(false)
        .from_writer(Vec::new());
    let written = writer.serialize(row).map_err(|e| refused(e.to_string()));
    let bytes = written.and_then(|()| writer.into_inner().map_err(|e| refused(e.to_string())))?;
    let text = String::from_utf8_lossy(&bytes);
    let cells = text.trim_end().split(',').zip(R::COLUMNS);
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
