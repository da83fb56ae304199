//! Figures as tables of text: the same rows for Markdown and for a page.

use std::fmt::Write;

use crate::chart::text::escape;

/// A table of text.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// Heading.
    pub title: String,
    /// A sentence on how to read it, may be empty.
    pub note: String,
    /// Column names.
    pub columns: Vec<String>,
    /// Cells.
    pub rows: Vec<Vec<String>>,
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

/// `median (min–max)`.
#[must_use]
pub fn ranged(median: f64, min: f64, max: f64) -> String {
    format!("{} ({}–{})", digits(median), digits(min), digits(max))
}

/// The table as HTML, under a heading of this level (`h2`).
pub fn write_html(out: &mut String, table: &Table, heading: &str) {
    let title = escape(&table.title);
    let _ = write!(out, "<{heading}>{title}</{heading}>");
    if !table.note.is_empty() {
        let _ = write!(out, "<p class=note>{}</p>", escape(&table.note));
    }
    out.push_str("<div class=scroll><table>");
    let line = |out: &mut String, cells: &[String], tag: &str| {
        out.push_str("<tr>");
        for (k, cell) in cells.iter().enumerate() {
            let class = if k == 0 { "" } else { " class=n" };
            let _ = write!(out, "<{tag}{class}>{}</{tag}>", escape(cell));
        }
        out.push_str("</tr>");
    };
    line(out, &table.columns, "th");
    for row in &table.rows {
        line(out, row, "td");
    }
    out.push_str("</table></div>\n");
}

/// The table as Markdown, under a heading of this level (`##`).
pub fn write_markdown(out: &mut String, table: &Table, level: &str) {
    let cell = |text: &str| text.replace('|', "\\|").replace('\n', " ");
    let line = |cells: &[String]| -> String {
        let cells: Vec<String> = cells.iter().map(|c| cell(c)).collect();
        format!("| {} |\n", cells.join(" | "))
    };
    let _ = write!(out, "\n{level} {}\n\n", table.title);
    if !table.note.is_empty() {
        let _ = write!(out, "{}\n\n", table.note);
    }
    out.push_str(&line(&table.columns));
    let rule = vec!["---:"; table.columns.len().saturating_sub(1)];
    let _ = writeln!(out, "| --- | {} |", rule.join(" | "));
    for row in &table.rows {
        out.push_str(&line(row));
    }
}
