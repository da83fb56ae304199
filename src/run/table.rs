//! Comma-separated tables that grow while a run goes on: header, then a row per event, flushed at once.
//!
//! Cells are numbers only, so nothing needs quoting. An absent number is an empty cell.

use std::fs::{File, OpenOptions};
use std::io::Write;
use std::marker::PhantomData;
use std::path::{Path, PathBuf};

use crate::base::error::{Error, Result};

/// One number of a table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Cell {
    /// A count.
    Count(u64),
    /// A measured value.
    Real(f64),
    /// A value that may be absent (an empty cell).
    Maybe(Option<f64>),
}

/// A row of a table: its columns, and the way to text and back.
pub trait Row: Sized {
    /// Column names, in order.
    const COLUMNS: &'static [&'static str];

    /// Iteration the row belongs to; a resumed run drops the rows beyond its checkpoint.
    fn iteration(&self) -> u32;

    /// The cells, in the order of [`Row::COLUMNS`].
    fn cells(&self) -> Vec<Cell>;

    /// The row of these cells; `None` where one is missing or not a number.
    fn parse(cells: &mut Cells<'_>) -> Option<Self>;
}

/// The cells of one line, read from left to right.
#[derive(Debug)]
pub struct Cells<'a>(std::str::Split<'a, char>);

impl Cells<'_> {
    /// The next cell as a count.
    pub fn count<T: std::str::FromStr>(&mut self) -> Option<T> {
        self.0.next()?.trim().parse().ok()
    }

    /// The next cell as a finite number.
    pub fn real(&mut self) -> Option<f64> {
        self.maybe()?
    }

    /// The next cell as a finite number or nothing.
    pub fn maybe(&mut self) -> Option<Option<f64>> {
        let text = self.0.next()?.trim();
        if text.is_empty() {
            return Some(None);
        }
        let value: f64 = text.parse().ok()?;
        value.is_finite().then_some(Some(value))
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
    /// A new table with a header and no rows; an existing file is replaced.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be written.
    pub fn create(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        crate::base::files::write_bytes(path, header::<R>().as_bytes())?;
        Self::open(path)
    }

    /// Goes on with an existing table after a resume: rows of iterations beyond `iteration`, and a last line that a
    /// crash cut short, are dropped. Without a file, a new table.
    ///
    /// # Errors
    /// [`Error::Input`] when the file is another table, [`Error::Io`] when it cannot be read or written.
    pub fn append(path: impl AsRef<Path>, iteration: u32) -> Result<Self> {
        let path = path.as_ref();
        if !path.exists() {
            return Self::create(path);
        }
        let rows = read_table::<R>(path)?;
        let mut text = header::<R>();
        for row in rows.iter().filter(|r| r.iteration() <= iteration) {
            text.push_str(&line(path, row)?);
        }
        crate::base::files::write_bytes(path, text.as_bytes())?;
        Self::open(path)
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

    fn open(path: &Path) -> Result<Self> {
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
    let mut lines = complete.lines();
    let found = lines.next().unwrap_or("").trim();
    let expected = R::COLUMNS.join(",");
    if found != expected {
        let what = format!("header is `{found}`, expected `{expected}`");
        return Err(Error::input(path, what, "remove or rename the file"));
    }
    let mut rows = Vec::new();
    for (index, text) in lines.enumerate() {
        if text.trim().is_empty() {
            continue;
        }
        let mut cells = Cells(text.split(','));
        match R::parse(&mut cells) {
            Some(row) if cells.0.next().is_none() => rows.push(row),
            _ => {
                let what = format!(
                    "line {}: `{text}`, expected {} finite numbers",
                    index + 2,
                    R::COLUMNS.len()
                );
                return Err(Error::input(path, what, "remove the line"));
            }
        }
    }
    Ok(rows)
}

fn header<R: Row>() -> String {
    R::COLUMNS.join(",") + "\n"
}

fn line<R: Row>(path: &Path, row: &R) -> Result<String> {
    let mut text = String::new();
    for (cell, column) in row.cells().iter().zip(R::COLUMNS) {
        if !text.is_empty() {
            text.push(',');
        }
        match *cell {
            Cell::Count(value) => text.push_str(&value.to_string()),
            Cell::Maybe(None) => {}
            Cell::Real(value) | Cell::Maybe(Some(value)) if value.is_finite() => {
                text.push_str(&value.to_string());
            }
            Cell::Real(value) | Cell::Maybe(Some(value)) => {
                return Err(Error::Numerics {
                    stage: path.display().to_string(),
                    what: format!(
                        "{column} is {value} at iteration {}; only finite numbers are written",
                        row.iteration()
                    ),
                });
            }
        }
    }
    text.push('\n');
    Ok(text)
}
