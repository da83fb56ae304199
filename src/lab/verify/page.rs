//! The report of a verification: errors of every family, against its stiffness.

use std::path::Path;

use crate::base::error::Result;
use crate::chart::svg::{LogPoint, LogSeries, log_log_chart};
use crate::lab::folder::{one_or_all, write_files};
use crate::lab::report::{Report, Section};
use crate::lab::table::{Table, or_dash};
use crate::lab::verify::check::Row;
use crate::lab::verify::verification::{FamilyNote, Verification};

/// Least error that is drawn.
const MIN_ERROR: f64 = 1e-17;
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

/// Number of comparisons, worst errors in f32 and in f64, and bound of every family.
fn table(v: &Verification) -> Table {
    let line = |note: &FamilyNote| {
        let of: Vec<&Row> = v.cases.iter().filter(|r| r.family == note.name).collect();
        let single = worst(of.iter().copied().filter(|r| !is_double(r)));
        let double = worst(of.iter().copied().filter(|r| is_double(r)));
        let number = |row: Option<&Row>| or_dash(row, |r| format!("{:.1e}", r.max_rel_error));
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
    let note = "Errors are relative to the largest value of a quantity; flips, elements on the other side of a discontinuity, are counted apart.";
    Table::new(
        "Worst of each family",
        note,
        &columns,
        v.families.iter().map(line),
    )
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
                y: r.max_rel_error.max(MIN_ERROR),
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
            or_dash(single, |r| format!("{:.1e}", r.max_rel_error))
        };
        let mut cells = vec![(*family).to_owned()];
        cells.extend(all.iter().map(worst_of));
        cells
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
            "Suite {}: {} comparisons passed, {} failed.",
            v.suite, v.passed, v.failed
        ),
        ..Report::default()
    };
    if v.families.is_empty() {
        part.sections.push(Section::Table(failures(v, true)));
        return part;
    }
    let reasons = v.families.iter().map(|note| {
        Section::Text(format!(
            "{}, {:.0e}: {}.",
            note.name, note.bound, note.reason
        ))
    });
    part.sections = vec![
        Section::Table(table(v)),
        Section::Charts {
            title: "Error against stiffness".into(),
            note: String::new(),
            figures: v.families.iter().map(|note| chart(v, note)).collect(),
        },
        Section::Table(failures(v, false)),
        Section::Details {
            summary: "Reasons of the bounds".into(),
            sections: reasons.collect(),
        },
    ];
    part
}

/// Rows that failed, or all of them.
fn failures(v: &Verification, all: bool) -> Table {
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
    let title = match all {
        true => "Comparisons",
        false => "Failed comparisons",
    };
    Table::new(title, "", &columns, rows.map(line))
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
