//! The one shape of what a measuring command reports, and its exporters: Markdown, and a page in the style of a run's report
//! (`text.rs` has the one for terminals).
//!
//! A command builds sections; headings, escaping, the page around them and the rule about what may be overwritten are here.

use std::fmt::Write;
use std::path::Path;

use crate::base::error::{Error, Result};
use crate::chart::text::escape;
use crate::lab::table::Table;
use crate::run::report::page::page;

/// Mark of a page that a later command may replace.
pub const GENERATOR: &str = "<!-- written by mhsplat, which may replace it -->";

/// A report, or a part of one under a heading of its own.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Report {
    /// Heading.
    pub title: String,
    /// Line of facts below the heading; may be empty.
    pub subtitle: String,
    /// Sentences on how to read it; may be empty.
    pub note: String,
    /// Caveats, one per entry.
    pub warnings: Vec<String>,
    /// Contents in their order.
    pub sections: Vec<Section>,
}

/// One piece of a report.
#[derive(Debug, Clone, PartialEq)]
pub enum Section {
    /// A table; one without rows is left out.
    Table(Table),
    /// Charts side by side, as HTML of the [`crate::chart`] room; pages only.
    Charts {
        /// Heading; may be empty.
        title: String,
        /// Sentences on how to read them; may be empty.
        note: String,
        /// One figure each.
        figures: Vec<String>,
    },
    /// A paragraph.
    Text(String),
    /// A link to a file beside the report.
    Link {
        /// Text of the link.
        text: String,
        /// Relative path of the file.
        to: String,
    },
    /// Links that a page shows on request; pages only.
    Links {
        /// Line that stands for them.
        summary: String,
        /// Text and target of each.
        links: Vec<(String, String)>,
    },
    /// A report of its own, one heading lower.
    Part(Report),
    /// Sections that a page shows on request.
    Details {
        /// Line that stands for them.
        summary: String,
        /// The sections.
        sections: Vec<Section>,
    },
}

impl Report {
    /// The report as Markdown.
    #[must_use]
    pub fn to_markdown(&self) -> String {
        let mut out = String::new();
        self.markdown(&mut out, 1);
        out
    }

    fn markdown(&self, out: &mut String, level: usize) {
        if level > 1 {
            out.push('\n');
        }
        let _ = writeln!(out, "{} {}", "#".repeat(level), self.title);
        for text in [&self.subtitle, &self.note] {
            if !text.is_empty() {
                let _ = writeln!(out, "\n{text}");
            }
        }
        for warning in &self.warnings {
            let _ = writeln!(out, "\n> {}", warning.replace('\n', " "));
        }
        markdown(out, &self.sections, level + 1);
    }

    /// The report as one self-contained page.
    #[must_use]
    pub fn to_html(&self) -> String {
        let mut body = format!("{GENERATOR}\n");
        self.html(&mut body, 1);
        page(&format!("{} · mhsplat", self.title), &body)
    }

    fn html(&self, out: &mut String, level: usize) {
        let title = escape(&self.title);
        let _ = write!(out, "<h{level}>{title}</h{level}>");
        paragraph(out, "sub", &self.subtitle);
        paragraph(out, "note", &self.note);
        if !self.warnings.is_empty() {
            out.push_str("<div class=warn><b>Caveats</b><ul>");
            for warning in &self.warnings {
                let _ = write!(out, "<li>{}</li>", escape(warning));
            }
            out.push_str("</ul></div>");
        }
        out.push('\n');
        html(out, &self.sections, level + 1);
    }

    /// Writes the page; replaces an earlier one, but nothing else.
    ///
    /// # Errors
    /// A path that [`check_page`] refuses or that cannot be written.
    pub fn write_page(&self, path: &Path) -> Result<()> {
        check_page(path)?;
        crate::base::files::write_bytes(path, self.to_html().as_bytes())
    }
}

/// Refuses a path that holds anything but a page of [`Report::write_page`].
///
/// # Errors
/// A file without the mark, or one that cannot be read.
pub fn check_page(path: &Path) -> Result<()> {
    let ours = || std::fs::read_to_string(path).is_ok_and(|text| text.contains(GENERATOR));
    if !path.exists() || ours() {
        return Ok(());
    }
    Err(Error::input(
        path,
        "exists and is not a page that mhsplat wrote; it is not overwritten",
        "choose another file with -o",
    ))
}

fn markdown(out: &mut String, sections: &[Section], level: usize) {
    for section in sections {
        match section {
            Section::Table(table) if table.rows.is_empty() => (),
            Section::Table(table) => markdown_table(out, table, level),
            Section::Text(text) => {
                let _ = writeln!(out, "\n{text}");
            }
            Section::Link { text, to } => {
                let _ = writeln!(out, "\n[{text}]({to})");
            }
            Section::Part(part) => part.markdown(out, level),
            Section::Details { summary, sections } => {
                let _ = writeln!(out, "\n{} {summary}", "#".repeat(level));
                markdown(out, sections, level + 1);
            }
            Section::Charts { .. } | Section::Links { .. } => (),
        }
    }
}

fn markdown_table(out: &mut String, table: &Table, level: usize) {
    let line = |cells: &[String]| -> String {
        let cell = |text: &String| text.replace('|', "\\|").replace('\n', " ");
        let cells: Vec<String> = cells.iter().map(cell).collect();
        format!("| {} |\n", cells.join(" | "))
    };
    let _ = write!(out, "\n{} {}\n\n", "#".repeat(level), table.title);
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

fn paragraph(out: &mut String, class: &str, text: &str) {
    if !text.is_empty() {
        let _ = write!(out, "<p class={class}>{}</p>", escape(text));
    }
}

fn html(out: &mut String, sections: &[Section], level: usize) {
    for section in sections {
        match section {
            Section::Table(table) if table.rows.is_empty() => (),
            Section::Table(table) => html_table(out, table, level),
            Section::Charts { figures, .. } if figures.is_empty() => (),
            Section::Charts {
                title,
                note,
                figures,
            } => {
                if !title.is_empty() {
                    let _ = write!(out, "<h{level}>{}</h{level}>", escape(title));
                }
                paragraph(out, "note", note);
                let _ = writeln!(out, "<div class=charts>\n{}</div>", figures.concat());
            }
            Section::Text(text) => {
                let _ = writeln!(out, "<p>{}</p>", escape(text));
            }
            Section::Link { text, to } => {
                let (text, to) = (escape(text), escape(to));
                let _ = writeln!(out, "<p><a href=\"{to}\">{text}</a></p>");
            }
            Section::Links { links, .. } if links.is_empty() => (),
            Section::Links { summary, links } => {
                let _ = write!(out, "<details><summary>{}</summary><ul>", escape(summary));
                for (text, to) in links {
                    let (text, to) = (escape(text), escape(to));
                    let _ = write!(out, "<li><a href=\"{to}\">{text}</a></li>");
                }
                out.push_str("</ul></details>\n");
            }
            Section::Part(part) => part.html(out, level),
            Section::Details { summary, sections } => {
                let _ = write!(out, "<details><summary>{}</summary>", escape(summary));
                html(out, sections, level + 1);
                out.push_str("</details>\n");
            }
        }
    }
}

fn html_table(out: &mut String, table: &Table, level: usize) {
    let text: Vec<bool> = (0..table.columns.len())
        .map(|k| k == 0 || table.is_text(k))
        .collect();
    let line = |out: &mut String, cells: &[String], tag: &str| {
        out.push_str("<tr>");
        for (k, cell) in cells.iter().enumerate() {
            let left = text.get(k).is_some_and(|text| *text);
            let class = if left { "" } else { " class=n" };
            let _ = write!(out, "<{tag}{class}>{}</{tag}>", escape(cell));
        }
        out.push_str("</tr>");
    };
    let _ = write!(out, "<h{level}>{}</h{level}>", escape(&table.title));
    paragraph(out, "note", &table.note);
    out.push_str("<div class=scroll><table>");
    line(out, &table.columns, "th");
    for row in &table.rows {
        line(out, row, "td");
    }
    out.push_str("</table></div>\n");
}
