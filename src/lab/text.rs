//! Reports as text for a terminal: what is folded away on a page is left out, tables are aligned.

use std::fmt::Write;

use crate::lab::report::{Report, Section};
use crate::lab::table::Table;

/// Blanks between two columns.
const GAP: usize = 2;

/// The report in lines that a terminal of so many columns holds, but for sentences. A table that is wider has a paragraph per row.
#[must_use]
pub fn text(report: &Report, width: usize) -> String {
    let mut out = String::new();
    part(&mut out, report, width);
    out
}

fn part(out: &mut String, report: &Report, width: usize) {
    if !out.is_empty() {
        out.push('\n');
    }
    let _ = writeln!(out, "{}", report.title);
    let warnings = report.warnings.iter().map(|text| format!("! {text}"));
    let facts = [&report.subtitle, &report.note].map(String::clone);
    for line in facts.into_iter().chain(warnings) {
        paragraph(out, &line, width);
    }
    for section in &report.sections {
        match section {
            Section::Table(table) if table.rows.is_empty() => (),
            Section::Table(table) => rows(out, table, width),
            Section::Text(text) => paragraph(out, text, width),
            Section::Link { text, to } => paragraph(out, &format!("{text}: {to}"), width),
            Section::Part(inner) => part(out, inner, width),
            Section::Details { summary, .. } => {
                paragraph(out, &format!("{summary}: with --markdown"), width);
            }
            Section::Charts { .. } | Section::Links { .. } => (),
        }
    }
}

fn rows(out: &mut String, table: &Table, width: usize) {
    let _ = writeln!(out, "\n{}", table.title);
    paragraph(out, &table.note, width);
    let columns = table.columns.len();
    let lines = || std::iter::once(&table.columns).chain(&table.rows);
    let widest = |k: usize| lines().filter_map(|row| row.get(k)).map(|c| len(c)).max();
    let widths: Vec<usize> = (0..columns).map(|k| widest(k).unwrap_or(0)).collect();
    if widths.iter().sum::<usize>() + GAP * columns.saturating_sub(1) > width {
        return records(out, table, width);
    }
    let left: Vec<bool> = (0..columns).map(|k| k == 0 || table.is_text(k)).collect();
    for row in lines() {
        let mut line = String::new();
        for (k, (cell, width)) in row.iter().zip(&widths).enumerate() {
            let blanks = " ".repeat(width - len(cell));
            let gap = " ".repeat(if k > 0 { GAP } else { 0 });
            let _ = match left[k] {
                true => write!(line, "{gap}{cell}{blanks}"),
                false => write!(line, "{gap}{blanks}{cell}"),
            };
        }
        let _ = writeln!(out, "{}", line.trim_end());
    }
}

/// Each row as its first cell and, indented, the others with the names of their columns.
fn records(out: &mut String, table: &Table, width: usize) {
    for row in &table.rows {
        let mut cells = table.columns.iter().zip(row);
        let _ = writeln!(out, "{}", cells.next().map_or("", |(_, first)| first));
        let named = cells
            .filter(|(_, cell)| !cell.is_empty())
            .map(|(column, cell)| format!("{column} {cell}").trim().replace(' ', "\u{a0}"));
        let words: Vec<String> = named.collect();
        for line in wrapped(&words.join(", "), width.saturating_sub(GAP)) {
            let _ = writeln!(out, "{}{}", " ".repeat(GAP), line.replace('\u{a0}', " "));
        }
    }
}

fn paragraph(out: &mut String, text: &str, width: usize) {
    for line in wrapped(text, width) {
        let _ = writeln!(out, "{line}");
    }
}

/// Lines of at most `width` characters, but for longer words.
fn wrapped(text: &str, width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split([' ', '\n']).filter(|word| !word.is_empty()) {
        match lines.last_mut() {
            Some(line) if len(line) + 1 + len(word) <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

fn len(text: &str) -> usize {
    text.chars().count()
}
