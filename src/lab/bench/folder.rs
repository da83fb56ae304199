//! The files of `mhsplat bench -o DIR`.

use std::path::Path;

use crate::base::error::Result;
use crate::lab::bench::record::Outcome;
use crate::lab::bench::report::report;
use crate::lab::folder::{one_or_all, write_files};
use crate::lab::stats::Spread;

/// Header of `bench.csv`: a row per stage of a case, per whole iteration, and per variant of a stage. Cells that do not
/// apply are empty.
const HEADER: &str = "device,scene,gaussians,width,height,pairs,stage,variant,median_ms,min_ms,max_ms,cpu_ms,samples,\
     rate,unit,share_of_peak,max_rel_error\n";

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
fn times(ms: &Spread, cpu: Option<Spread>) -> String {
    let cpu = cell(cpu.map(|s| s.median));
    format!("{},{},{},{cpu},{}", ms.median, ms.min, ms.max, ms.samples)
}

fn cell(value: Option<f64>) -> String {
    value.map_or_else(String::new, |v| v.to_string())
}

/// Every device as one table, as in [`write_folder`].
#[must_use]
pub fn csv(outcomes: &[Outcome]) -> String {
    let mut out = HEADER.to_owned();
    for record in outcomes.iter().filter_map(Outcome::record) {
        let device = quoted(&record.device);
        for case in &record.cases {
            let scene = quoted(&case.scene);
            let (n, w, h, pairs) = (case.gaussians, case.width, case.height, case.pairs);
            let prefix = format!("{device},{scene},{n},{w},{h},{pairs}");
            let whole = times(&case.iteration.ms, Some(case.iteration.cpu_ms));
            out += &format!("{prefix},iteration,,{whole},,,,\n");
            for s in &case.stages {
                let (times, share) = (times(&s.ms, s.cpu_ms), cell(s.share.map(|r| r.median)));
                let (name, rate, unit) = (s.name, s.rate.median, s.unit);
                out += &format!("{prefix},{name},,{times},{rate},{unit},{share},\n");
            }
        }
        for p in &record.precision {
            let (variant, times) = (quoted(&p.variant), times(&p.ms, None));
            let (stage, error) = (p.stage, p.max_rel_error);
            out += &format!("{device},,,,,,{stage},{variant},{times},,,,{error}\n");
        }
    }
    out
}
