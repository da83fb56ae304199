//! The files of `mhsplat bench -o DIR`.

use std::fmt::Write;
use std::path::Path;

use crate::base::error::Result;
use crate::lab::bench::record::{BenchRecord, Outcome, Stage};
use crate::lab::bench::report::report;
use crate::lab::bench::tables::done;
use crate::lab::folder::{one_or_all, write_files};

/// Columns of `bench.csv`: a row per stage of a case, per whole iteration, and per variant of a stage. Cells that do not
/// apply are empty.
pub const COLUMNS: [&str; 17] = [
    "device",
    "scene",
    "gaussians",
    "width",
    "height",
    "pairs",
    "stage",
    "variant",
    "median_ms",
    "min_ms",
    "max_ms",
    "cpu_ms",
    "samples",
    "rate",
    "unit",
    "share_of_peak",
    "max_rel_error",
];

/// The document of `bench --json`, of several devices an array.
///
/// # Errors
/// None that a user can cause: what is measured can be written.
pub fn json(outcomes: &[Outcome]) -> Result<String> {
    one_or_all("bench.json", outcomes)
}

/// Writes `bench.json`, `bench.csv`, `bench.md` and `bench.html`.
///
/// # Errors
/// A folder that is not empty or cannot be written.
pub fn write_folder(dir: &Path, outcomes: &[Outcome]) -> Result<()> {
    let report = report(outcomes);
    let files = [
        ("bench.json", json(outcomes)? + "\n"),
        ("bench.csv", csv(outcomes)),
        ("bench.md", report.to_markdown()),
        ("bench.html", report.to_html()),
    ];
    write_files(dir, &files)
}

/// A cell of text, quoted by RFC 4180.
fn quoted(text: &str) -> String {
    format!("\"{}\"", text.replace('"', "\"\""))
}

/// Every device as one table of [`COLUMNS`].
#[must_use]
pub fn csv(outcomes: &[Outcome]) -> String {
    let mut out = COLUMNS.join(",") + "\n";
    for record in done(outcomes) {
        cases(&mut out, record);
        for p in &record.precision {
            let _ = writeln!(
                out,
                "{},,,,,,{},{},{},{},{},,{},,,,{}",
                quoted(&record.device),
                p.stage,
                quoted(&p.variant),
                p.median_ms,
                p.min_ms,
                p.max_ms,
                p.samples,
                p.max_rel_error
            );
        }
    }
    out
}

fn cases(out: &mut String, record: &BenchRecord) {
    let optional = |v: Option<f64>| v.map_or_else(String::new, |v| v.to_string());
    for case in &record.cases {
        let prefix = format!(
            "{},{},{},{},{},{}",
            quoted(&record.device),
            quoted(&case.scene),
            case.gaussians,
            case.width,
            case.height,
            case.pairs
        );
        let i = &case.iteration;
        let _ = writeln!(
            out,
            "{prefix},iteration,,{},{},{},{},{},,,,",
            i.median_ms, i.min_ms, i.max_ms, i.cpu_ms, i.samples
        );
        let stage = |out: &mut String, s: &Stage| {
            let _ = writeln!(
                out,
                "{prefix},{},,{},{},{},{},{},{},{},{},",
                s.name,
                s.median_ms,
                s.min_ms,
                s.max_ms,
                optional(s.cpu_ms),
                s.samples,
                s.rate,
                s.unit,
                optional(s.share_of_peak)
            );
        };
        case.stages.iter().for_each(|s| stage(out, s));
    }
}
