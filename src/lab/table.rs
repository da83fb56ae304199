//! Tables of text, and how their figures are spelt.

use crate::lab::stats::{RATIO_SAMPLES, Ratio, Spread};

/// A table of text.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// Heading.
    pub title: String,
    /// Sentences on how to read it; may be empty.
    pub note: String,
    /// Column names.
    pub columns: Vec<String>,
    /// Cells.
    pub rows: Vec<Vec<String>>,
}

impl Table {
    /// A table of these columns.
    pub fn new(
        title: impl Into<String>,
        note: impl Into<String>,
        columns: &[&str],
        rows: impl IntoIterator<Item = Vec<String>>,
    ) -> Self {
        Self {
            title: title.into(),
            note: note.into(),
            columns: columns.iter().map(|c| (*c).to_owned()).collect(),
            rows: rows.into_iter().collect(),
        }
    }

    /// True if most cells of a column that say something begin with a letter.
    #[must_use]
    pub fn is_text(&self, column: usize) -> bool {
        let cells = self.rows.iter().filter_map(|row| row.get(column));
        let (words, others): (Vec<&String>, Vec<&String>) = cells
            .filter(|cell| !cell.is_empty())
            .partition(|cell| cell.starts_with(char::is_alphabetic));
        words.len() > others.len()
    }
}

/// `text` of a figure; a dash for `None`.
pub fn or_dash<T>(figure: Option<T>, text: impl FnOnce(T) -> String) -> String {
    figure.map_or_else(|| "–".into(), text)
}

/// Three significant digits.
#[must_use]
pub fn digits(value: f64) -> String {
    let size = value.abs();
    match size {
        _ if !size.is_finite() => "–".into(),
        0.0 => "0".into(),
        s if !(1e-3..1e6).contains(&s) => format!("{value:.1e}"),
        s => {
            let decimals = (2 - s.log10().floor() as i32).clamp(0, 5) as usize;
            format!("{value:.decimals$}")
        }
    }
}

/// `median (min–max)`, each by `text`.
pub fn spread(s: &Spread, text: impl Fn(f64) -> String) -> String {
    format!("{} ({}–{})", text(s.median), text(s.min), text(s.max))
}

/// [`spread`]; the median alone of fewer than [`RATIO_SAMPLES`] samples.
pub fn few(s: &Spread, text: impl Fn(f64) -> String) -> String {
    match s.samples < RATIO_SAMPLES {
        true => text(s.median),
        false => spread(s, text),
    }
}

/// `median (low–high)` of a ratio in three digits.
#[must_use]
pub fn ratio(r: &Ratio) -> String {
    let [median, low, high] = [r.median, r.low, r.high].map(digits);
    format!("{median} ({low}–{high})")
}

/// The last part of a path, by which a dataset or a run is named.
#[must_use]
pub fn folder_name(path: &str) -> &str {
    let name = path.trim_end_matches(['/', '\\']);
    name.rsplit(['/', '\\']).next().unwrap_or(name)
}
