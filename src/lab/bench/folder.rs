//! The files of `mhsplat bench -o DIR`.

use std::fmt::Write;
use std::path::Path;

use crate::base::error::Result;
use crate::lab::bench::record::Outcome;
use crate::lab::bench::report::report;
use crate::lab::bench::tables::done;
use crate::lab::folder::{one_or_all, write_files};
use crate::lab::stats::Spread;

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

/// The cells of a time: median, min, max, CPU time, samples.
fn times(ms: &Spread, cpu: Option<f64>) -> String {
    let cpu = cpu.map_or_else(String::new, |v| v.to_string());
    format!("{},{},{},{cpu},{}", ms.median, ms.min, ms.max, ms.samples)
}

/// Every device as one table of `COLUMNS`.
#[must_use]
pub fn csv(outcomes: &[Outcome]) -> String {
    let mut out = COLUMNS.join(",") + "\n";
    for record in done(outcomes) {
        let device = quoted(&record.device);
        for case in &record.cases {
            let scene = quoted(&case.scene);
            let (n, w, h, pairs) = (case.gaussians, case.width, case.height, case.pairs);
            let prefix = format!("{device},{scene},{n},{w},{h},{pairs}");
            let i = &case.iteration;
            let whole = times(&i.ms, Some(i.cpu_ms.median));
            let _ = writeln!(out, "{prefix},iteration,,{whole},,,,");
            for s in &case.stages {
                let times = times(&s.ms, s.cpu_ms.map(|c| c.median));
                let share = s.share.map_or_else(String::new, |r| r.median.to_string());
                let (rate, unit) = (s.rate.median, s.unit);
                let _ = writeln!(out, "{prefix},{},,{times},{rate},{unit},{share},", s.name);
            }
        }
        for p in &record.precision {
            let (variant, times) = (quoted(&p.variant), times(&p.ms, None));
            let error = p.max_rel_error;
            let _ = writeln!(
                out,
                "{device},,,,,,{},{variant},{times},,,,{error}",
                p.stage
            );
        }
    }
    out
}
