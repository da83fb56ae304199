//! What a verification found, as text, Markdown and a page with the error of each family against its stiffness.

use std::fmt::Write;
use std::path::Path;

use crate::base::error::Result;
use crate::chart::loglog::{LogPoint, LogSeries, log_log_chart};
use crate::chart::text::escape;
use crate::lab::folder::{one_or_all, write_files};
use crate::lab::table::{Table, write_html, write_markdown};
use crate::lab::verify::Verification;
use crate::lab::verify::check::Row;
use crate::lab::verify::stress::FamilyNote;
use crate::run::report::page;

/// Errors below this are drawn as this.
const LEAST_ERROR: f64 = 1e-17;
/// Stages that have a curve of their own in f32, in the order of their colours.
const CURVES: [&[&str]; 5] = [
    &["project", "dataset", "density"],
    &["splat", "scan", "bin", "sort"],
    &["loss", "metrics", "importance"],
    &["exposure", "splat_grad", "screen_grad", "seen"],
    &["project_grad", "adam", "noise", "edit"],
];

fn is_double(row: &Row) -> bool {
    row.quantity.ends_with("(f64)")
}

fn worst<'a>(rows: impl Iterator<Item = &'a Row>) -> Option<&'a Row> {
    rows.max_by(|a, b| a.max_rel_error.total_cmp(&b.max_rel_error))
}

/// A row per family: how many comparisons, the worst in f32 and in f64, and the bound.
#[must_use]
pub fn table(v: &Verification) -> Table {
    let line = |note: &FamilyNote| {
        let of: Vec<&Row> = v.cases.iter().filter(|r| r.family == note.name).collect();
        let single = worst(of.iter().copied().filter(|r| !is_double(r)));
        let double = worst(of.iter().copied().filter(|r| is_double(r)));
        let number =
            |row: Option<&Row>| row.map_or("–".into(), |r| format!("{:.1e}", r.max_rel_error));
        let failed = of.iter().filter(|r| !r.pass).count();
        vec![
            note.name.to_owned(),
            format!("{}", of.len()),
            format!("{failed}"),
            format!("{}", of.iter().map(|r| r.non_finite).sum::<usize>()),
            number(single),
            format!("{:.0e}", note.bound),
            number(double),
            format!("{}", of.iter().map(|r| r.flips).sum::<usize>()),
            single.map_or(String::new(), |r| {
                format!("{}: {} {}", r.case, r.stage, r.quantity)
            }),
        ]
    };
    let columns = [
        "family",
        "comparisons",
        "failed",
        "not finite",
        "worst in f32",
        "bound",
        "worst in f64",
        "flips",
        "worst in f32 is of",
    ];
    Table {
        title: "Worst of each family".into(),
        note: "Errors are relative to the largest value of a quantity; flips, elements on the other side of a discontinuity, are counted apart.".into(),
        columns: columns.map(str::to_owned).to_vec(),
        rows: v.families.iter().map(line).collect(),
    }
}

/// Error against stiffness of one family: a curve per group of stages in f32, one for all of f64.
fn chart(v: &Verification, note: &FamilyNote) -> String {
    let of: Vec<&Row> = v.cases.iter().filter(|r| r.family == note.name).collect();
    let mut stiffness: Vec<f64> = of.iter().filter_map(|r| r.stiffness).collect();
    stiffness.sort_by(f64::total_cmp);
    stiffness.dedup();
    let series = |name: String, takes: &dyn Fn(&Row) -> bool| {
        let point = |at: &f64| {
            let here = of
                .iter()
                .copied()
                .filter(|r| r.stiffness == Some(*at) && takes(r));
            worst(here).map(|r| LogPoint {
                x: *at,
                y: r.max_rel_error.max(LEAST_ERROR),
                label: String::new(),
                tip: format!(
                    "{}: {} {}, {:.1e}",
                    r.case, r.stage, r.quantity, r.max_rel_error
                ),
            })
        };
        LogSeries {
            name,
            points: stiffness.iter().filter_map(point).collect(),
            line: true,
        }
    };
    let mut all: Vec<LogSeries> = CURVES
        .iter()
        .map(|stages| {
            series(stages.join(", "), &|r: &Row| {
                !is_double(r) && stages.contains(&r.stage)
            })
        })
        .collect();
    all.push(series("all stages, f64".into(), &is_double));
    all.retain(|s| !s.points.is_empty());
    log_log_chart(note.name, note.axis, "largest relative error", &all)
}

/// Devices side by side: the worst of each family in f32. Each is within the family's bound of the reference, so that two
/// devices are within twice that of each other.
fn between(all: &[Verification]) -> Table {
    let mut families: Vec<&str> = Vec::new();
    for row in all.iter().flat_map(|v| &v.cases) {
        if !families.contains(&row.family.as_str()) {
            families.push(&row.family);
        }
    }
    let line = |family: &&str| {
        let worst_of = |v: &Verification| {
            let of = v.cases.iter().filter(|r| r.family == **family);
            let single = worst(of.filter(|r| !is_double(r)));
            single.map_or("–".into(), |r| format!("{:.1e}", r.max_rel_error))
        };
        let mut cells = vec![(*family).to_owned()];
        cells.extend(all.iter().map(worst_of));
        cells
    };
    let devices = all.iter().map(|v| v.device.clone());
    Table {
        title: "Devices side by side".into(),
        note: "Worst error in f32 against one reference.".into(),
        columns: std::iter::once("family".to_owned())
            .chain(devices)
            .collect(),
        rows: families.iter().map(line).collect(),
    }
}

/// `verify.html`, complete.
#[must_use]
pub fn page(all: &[Verification]) -> String {
    let mut body = format!(
        "<h1>Verification</h1><p class=sub>mhsplat {} · every stage against the f64 reference</p>\n",
        env!("CARGO_PKG_VERSION")
    );
    if all.len() > 1 {
        write_html(&mut body, &between(all), "h2");
    }
    for v in all {
        let _ = writeln!(
            body,
            "<h2>{}</h2><p>Suite {}: {} comparisons passed, {} failed.</p>",
            escape(&v.device),
            v.suite,
            v.passed,
            v.failed
        );
        if v.families.is_empty() {
            write_html(&mut body, &failures(v, true), "h3");
            continue;
        }
        write_html(&mut body, &table(v), "h3");
        body.push_str("<h3>Error against stiffness</h3><div class=charts>\n");
        for note in &v.families {
            body.push_str(&chart(v, note));
        }
        body.push_str("</div>\n<h3>Why these bounds</h3><ul>\n");
        for note in &v.families {
            let _ = writeln!(
                body,
                "<li><b>{}</b>, {:.0e}: {}.</li>",
                escape(note.name),
                note.bound,
                escape(note.reason)
            );
        }
        body.push_str("</ul>\n");
        if v.failed > 0 {
            write_html(&mut body, &failures(v, false), "h3");
        }
    }
    page::page("mhsplat verify", &body)
}

/// Rows that failed, or all of them.
#[must_use]
pub fn failures(v: &Verification, all: bool) -> Table {
    let rows = v.cases.iter().filter(|r| all || !r.pass);
    let line = |r: &Row| {
        vec![
            r.family.clone(),
            r.case.clone(),
            r.stage.to_owned(),
            r.quantity.clone(),
            format!("{:.1e}", r.max_rel_error),
            format!("{:.1e}", r.median_rel_error),
            format!("{:.0e}", r.bound),
            format!("{}", r.flips),
            format!("{}", r.non_finite),
            if r.pass {
                String::new()
            } else {
                "FAILED".into()
            },
        ]
    };
    let columns = [
        "family",
        "case",
        "stage",
        "quantity",
        "max",
        "median",
        "bound",
        "flips",
        "not finite",
        "",
    ];
    Table {
        title: if all {
            "Comparisons"
        } else {
            "Failed comparisons"
        }
        .into(),
        note: String::new(),
        columns: columns.map(str::to_owned).to_vec(),
        rows: rows.map(line).collect(),
    }
}

/// All devices as Markdown.
#[must_use]
pub fn markdown(all: &[Verification]) -> String {
    let texts: Vec<String> = all.iter().map(device).collect();
    let mut out = texts.join("\n");
    if all.len() > 1 {
        write_markdown(&mut out, &between(all), "##");
    }
    out
}

fn device(v: &Verification) -> String {
    let mut out = format!("{}: suite {}\n", v.device, v.suite);
    if v.families.is_empty() {
        write_markdown(&mut out, &failures(v, true), "##");
    } else {
        write_markdown(&mut out, &table(v), "##");
        if v.failed > 0 {
            write_markdown(&mut out, &failures(v, false), "##");
        }
    }
    let _ = writeln!(out, "\n{} passed, {} failed", v.passed, v.failed);
    out
}

/// The document of `verify --json`: of one device itself, of several an array.
///
/// # Errors
/// None that a user can cause: what is found can be written.
pub fn json(all: &[Verification]) -> Result<String> {
    one_or_all("verify.json", all)
}

/// Writes `verify.html`, `verify.json` and `verify.md`.
///
/// # Errors
/// A folder that is not empty or cannot be written.
pub fn write_folder(dir: &Path, all: &[Verification]) -> Result<()> {
    let files = [
        ("verify.html", page(all)),
        ("verify.json", json(all)? + "\n"),
        ("verify.md", markdown(all)),
    ];
    write_files(dir, &files)
}
