//! The report of a verification: errors of every family, against its stiffness.

use std::path::Path;

use crate::base::error::Result;
use crate::chart::svg::{LogPoint, LogSeries, log_log_chart};
use crate::lab::folder::{one_or_all, write_files};
use crate::lab::report::{Report, Section};
use crate::lab::table::{Table, or_dash};
use crate::lab::verify::check::{FamilyNote, Row, Verification};

/// Least error that is drawn.
const MIN_ERROR: f64 = 1e-17;
/// Stages that have a curve of their own in f32, in the order of their colours.
const CURVES: [&[&str]; 5] = [
    &["project"],
    &["splat", "scan", "bin", "sort"],
    &["loss", "metrics", "flip", "importance", "photo_error"],
    &["exposure", "splat_grad", "screen_grad", "seen"],
    &["project_grad", "adam", "noise", "edit", "morton"],
];

fn is_double(row: &Row) -> bool {
    row.quantity.ends_with("(f64)")
}

fn worst<'a>(rows: impl Iterator<Item = &'a Row>) -> Option<&'a Row> {
    rows.max_by(|a, b| a.max_rel_error.total_cmp(&b.max_rel_error))
}

/// Worst of some rows in f64, or in f32, as text.
fn worst_in(double: bool, rows: &[&Row], text: impl Fn(&Row) -> String) -> String {
    let of = rows.iter().copied().filter(|r| is_double(r) == double);
    or_dash(worst(of), text)
}

fn error(row: &Row) -> String {
    format!("{:.1e}", row.max_rel_error)
}

fn quantity(row: &Row) -> String {
    format!("{}: {} {}", row.case, row.stage, row.quantity)
}

fn rows_of<'a>(v: &'a Verification, family: &str) -> Vec<&'a Row> {
    v.cases.iter().filter(|r| r.family == family).collect()
}

/// Column of a table: its name and the cell of a row.
type Column<T> = (&'static str, fn(&T) -> String);

fn table<T>(title: &str, note: &str, columns: &[Column<T>], rows: Vec<T>) -> Section {
    let names: Vec<&str> = columns.iter().map(|(name, _)| *name).collect();
    let line = |row: &T| columns.iter().map(|(_, cell)| cell(row)).collect();
    Section::Table(Table::new(title, note, &names, rows.iter().map(line)))
}

fn sum(rows: &[&Row], of: fn(&Row) -> usize) -> String {
    rows.iter().map(|r| of(r)).sum::<usize>().to_string()
}

/// Number of comparisons, worst errors in f32 and in f64, and largest bound on the former, of every family.
fn families(v: &Verification) -> Section {
    let columns: [Column<(&str, Vec<&Row>)>; 10] = [
        ("family", |(name, _)| (*name).into()),
        ("comparisons", |(_, of)| of.len().to_string()),
        ("passed", |(_, of)| sum(of, |r| usize::from(r.pass))),
        ("failed", |(_, of)| sum(of, |r| usize::from(!r.pass))),
        ("not finite", |(_, of)| sum(of, |r| r.non_finite)),
        ("worst in f32", |(_, of)| worst_in(false, of, error)),
        ("bound", |(_, of)| bound(of)),
        ("worst in f64", |(_, of)| worst_in(true, of, error)),
        ("flips", |(_, of)| sum(of, |r| r.flips)),
        ("worst in f32 is of", |(_, of)| {
            worst_in(false, of, quantity)
        }),
    ];
    let note = "Errors are relative to the largest value of a quantity; flips, elements on the other side of a discontinuity, are counted apart.";
    let names = family_names(std::slice::from_ref(v));
    let rows = names.into_iter().map(|name| (name, rows_of(v, name)));
    table("Worst of each family", note, &columns, rows.collect())
}

/// Largest bound on errors in f32.
fn bound(rows: &[&Row]) -> String {
    let single = rows.iter().filter(|r| !is_double(r));
    or_dash(single.map(|r| r.bound).max_by(f64::total_cmp), |b| {
        format!("{b:.0e}")
    })
}

/// Families of the cases, each once.
fn family_names(all: &[Verification]) -> Vec<&'static str> {
    let mut names: Vec<&str> = Vec::new();
    for row in all.iter().flat_map(|v| &v.cases) {
        if !names.contains(&row.family) {
            names.push(row.family);
        }
    }
    names
}

/// Error against stiffness of one family: a curve per group of stages in f32, one for all of f64.
fn chart(v: &Verification, note: &FamilyNote) -> String {
    let of = rows_of(v, note.name);
    let mut stiffness: Vec<f64> = of.iter().filter_map(|r| r.stiffness).collect();
    stiffness.sort_by(f64::total_cmp);
    stiffness.dedup();
    let series = |name: String, takes: &dyn Fn(&Row) -> bool| {
        let point = |at: &f64| {
            let here = |r: &&Row| r.stiffness == Some(*at) && takes(r);
            worst(of.iter().copied().filter(here)).map(|r| LogPoint {
                x: *at,
                y: r.max_rel_error.max(MIN_ERROR),
                label: String::new(),
                tip: format!("{}, {}", quantity(r), error(r)),
            })
        };
        LogSeries {
            name,
            points: stiffness.iter().filter_map(point).collect(),
            line: true,
        }
    };
    let curve = |stages: &&[&str]| {
        let takes = |r: &Row| !is_double(r) && stages.contains(&r.stage);
        series(stages.join(", "), &takes)
    };
    let mut all: Vec<LogSeries> = CURVES.iter().map(curve).collect();
    all.push(series("all stages, f64".into(), &is_double));
    all.retain(|s| !s.points.is_empty());
    log_log_chart(note.name, note.axis, "largest relative error", &all)
}

/// Devices side by side: the worst of each family in f32. Each is within the family's bound of the reference, so that two
/// devices are within twice that of each other.
fn between(all: &[Verification]) -> Table {
    let families = family_names(all);
    let line = |family: &&str| {
        let of = |v: &Verification| worst_in(false, &rows_of(v, family), error);
        let name = (*family).to_owned();
        std::iter::once(name).chain(all.iter().map(of)).collect()
    };
    let devices = all.iter().map(|v| v.device.as_str());
    let columns: Vec<&str> = std::iter::once("family").chain(devices).collect();
    let note = "Worst error in f32 against one reference.";
    Table::new(
        "Devices side by side",
        note,
        &columns,
        families.iter().map(line),
    )
}

/// All devices as a report.
#[must_use]
pub fn report(all: &[Verification]) -> Report {
    let several = (all.len() > 1).then(|| Section::Table(between(all)));
    let devices = all.iter().map(|v| Section::Part(device(v)));
    Report {
        title: "Verification".into(),
        subtitle: format!(
            "mhsplat {} · every stage against the f64 reference",
            env!("CARGO_PKG_VERSION")
        ),
        sections: several.into_iter().chain(devices).collect(),
        ..Report::default()
    }
}

fn device(v: &Verification) -> Report {
    let mut part = Report {
        title: v.device.clone(),
        subtitle: format!(
            "Suite {}: {} comparisons passed, {} failed. Tuning: {}.",
            v.suite, v.passed, v.failed, v.tuning
        ),
        ..Report::default()
    };
    part.sections = vec![families(v), comparisons(v, false)];
    if v.families.is_empty() {
        part.sections.push(Section::Details {
            summary: "All comparisons".into(),
            sections: vec![comparisons(v, true)],
        });
        return part;
    }
    let reasons = v.families.iter().map(|note| {
        Section::Text(format!(
            "{}, {:.0e}: {}.",
            note.name, note.bound, note.reason
        ))
    });
    part.sections.extend([
        Section::Charts {
            title: "Error against stiffness".into(),
            note: String::new(),
            figures: v.families.iter().map(|note| chart(v, note)).collect(),
        },
        Section::Details {
            summary: "Reasons of the bounds".into(),
            sections: reasons.collect(),
        },
    ]);
    part
}

/// Rows that failed, or all of them.
fn comparisons(v: &Verification, all: bool) -> Section {
    let columns: [Column<&Row>; 10] = [
        ("family", |r| r.family.into()),
        ("case", |r| r.case.clone()),
        ("stage", |r| r.stage.into()),
        ("quantity", |r| r.quantity.clone()),
        ("max", |r| error(r)),
        ("median", |r| format!("{:.1e}", r.median_rel_error)),
        ("bound", |r| format!("{:.0e}", r.bound)),
        ("flips", |r| r.flips.to_string()),
        ("not finite", |r| r.non_finite.to_string()),
        ("", |r| if r.pass { "" } else { "FAILED" }.into()),
    ];
    let title = match all {
        true => "Comparisons",
        false => "Failed comparisons",
    };
    let rows = v.cases.iter().filter(|r| all || !r.pass);
    table(title, "", &columns, rows.collect())
}

/// The document of `verify --json`, of several devices an array.
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
    let report = report(all);
    let files = [
        ("verify.html", report.to_html()),
        ("verify.json", json(all)? + "\n"),
        ("verify.md", report.to_markdown()),
    ];
    write_files(dir, &files)
}
