//! Figures as tables: the same rows for Markdown and for the page.

pub use crate::lab::table::Table;

use std::fmt::Write;

use crate::lab::bench::growth::SYNTHETIC;
use crate::lab::bench::record::{BenchRecord, Case, Outcome, Stage};
use crate::lab::stats::{Ratio, Spread};
use crate::lab::table::{digits, ranged, write_markdown};

fn ranged_ratio(r: &Ratio) -> String {
    ranged(r.median, r.low, r.high)
}

/// `N Gaussians, W × H px` of a case, after the scene's name where it is no synthetic one.
pub(super) fn case_title(case: &Case) -> String {
    let name = match case.scene.as_str() {
        SYNTHETIC => String::new(),
        other => format!("{other}, "),
    };
    let (n, w, h) = (case.gaussians, case.width, case.height);
    format!("{name}{n} Gaussians, {w} × {h} px")
}

/// Work per second with its unit: lanes in 10⁹, bytes in GB.
fn rate(stage: &Stage) -> String {
    let unit = match stage.unit {
        "bytes/s" => "GB/s",
        _ => "Glanes/core-s",
    };
    let figure = ranged(
        1e-9 * stage.rate,
        1e-9 * stage.rate_min,
        1e-9 * stage.rate_max,
    );
    format!("{figure} {unit}")
}

/// `median (min–max)` times `factor`, a dash where there is none.
fn maybe(figures: [Option<f64>; 3], factor: f64) -> String {
    match figures {
        [Some(median), Some(min), Some(max)] => ranged(factor * median, factor * min, factor * max),
        _ => "–".into(),
    }
}

fn table(title: &str, note: &'static str, columns: &[&str], rows: Vec<Vec<String>>) -> Table {
    Table {
        title: title.into(),
        note: note.into(),
        columns: columns.iter().map(|c| (*c).to_owned()).collect(),
        rows,
    }
}

fn peak(record: &BenchRecord) -> Table {
    let p = &record.peak;
    let mut rows = vec![vec![
        "multiply-adds in f32, whole device".into(),
        ranged(p.fma.median, p.fma.min, p.fma.max),
        "GFLOP/s".into(),
        p.fma.samples.to_string(),
    ]];
    if let Some(core) = p.fma_core {
        rows.push(vec![
            "multiply-adds in f32, per second of CPU time".into(),
            ranged(core.median, core.min, core.max),
            "GFLOP/core-s".into(),
            core.samples.to_string(),
        ]);
    }
    rows.push(vec![
        "copy, read and written".into(),
        ranged(p.copy.median, p.copy.min, p.copy.max),
        "GB/s".into(),
        p.copy.samples.to_string(),
    ]);
    let columns = ["peak", "median (min–max)", "unit", "samples"];
    table("Measured peak", "", &columns, rows)
}

fn iterations(record: &BenchRecord) -> Table {
    let row = |c: &Case| {
        let i = &c.iteration;
        vec![
            case_title(c),
            ranged(i.median_ms, i.min_ms, i.max_ms),
            ranged(i.cpu_ms, i.cpu_min_ms, i.cpu_max_ms),
            ranged(i.cores_busy, i.cores_busy_min, i.cores_busy_max),
            c.pairs.to_string(),
            digits(1e-6 * i.lanes as f64),
            digits(i.bytes_per_gaussian),
            format!("{} of {}", i.samples, i.iterations),
        ]
    };
    let columns = [
        "case",
        "ms",
        "CPU ms",
        "cores busy",
        "pairs",
        "M lanes",
        "B/Gaussian",
        "samples",
    ];
    let note = "Wall time of one iteration, median (min–max) of so many samples of so many iterations. Where other programs share the machine, compare by CPU ms.";
    table(
        "Whole iteration",
        note,
        &columns,
        record.cases.iter().map(row).collect(),
    )
}

pub(super) fn stages(case: &Case) -> Table {
    let row = |s: &Stage| {
        vec![
            s.name.to_owned(),
            ranged(s.median_ms, s.min_ms, s.max_ms),
            maybe([s.cpu_ms, s.cpu_min_ms, s.cpu_max_ms], 1.0),
            rate(s),
            maybe([s.share_of_peak, s.share_min, s.share_max], 100.0),
        ]
    };
    let note = "Device time per iteration, median (min–max). CPU ms and core-s are device time times the cores busy over the whole \
         iteration, so they are too low by what other stages leave idle (see above). Share of the measured peak: FLOP of the lanes over the multiply-adds, \
         bytes over the copy; above 100 % where data stay in a cache.";
    table(
        &case_title(case),
        note,
        &["stage", "ms", "CPU ms", "rate", "% of peak"],
        case.stages.iter().map(row).collect(),
    )
}

fn growth(record: &BenchRecord) -> Table {
    let rows = record.growth.iter().map(|g| {
        let [from, to] = g.between;
        vec![
            g.what.clone(),
            ranged_ratio(&g.exponent),
            g.points.to_string(),
            format!("{from} to {to}"),
            ranged_ratio(&g.ratio),
        ]
    });
    let columns = ["growth", "exponent", "cases", "from, to", "ratio"];
    let note = "Least squares in the logarithms; ranges from the smallest and largest samples. Memory is known, not sampled.";
    table("Growth", note, &columns, rows.collect())
}

fn precision(record: &BenchRecord) -> Table {
    let rows = record.precision.iter().map(|p| {
        vec![
            p.stage.to_owned(),
            p.variant.clone(),
            ranged(p.median_ms, p.min_ms, p.max_ms),
            format!("{:.1e}", p.max_rel_error),
            format!("{:.1e}", p.median_rel_error),
        ]
    });
    let note = "Error over the largest value of the f64 reference, which has the same alpha cut, but for the rows named `cut`: \
         there it has none. The largest error counts values in which a contribution at the cut fell to the other side.";
    table(
        "Work and precision",
        note,
        &["stage", "variant", "ms", "largest error", "median error"],
        rows.collect(),
    )
}

fn failures(record: &BenchRecord) -> Table {
    let rows = record.failed.iter();
    let rows = rows.map(|f| vec![f.what.clone(), f.error.clone()]);
    table("Not measured", "", &["what", "why"], rows.collect())
}

/// Every table of a device that has a row.
pub(super) fn of_record(record: &BenchRecord) -> Vec<Table> {
    let mut all = vec![peak(record), iterations(record)];
    all.extend(record.cases.iter().map(stages));
    all.extend([growth(record), precision(record), failures(record)]);
    all.retain(|t| !t.rows.is_empty());
    all
}

/// Peaks and iteration times of several devices side by side; none for fewer than two.
pub(super) fn comparison(records: &[&BenchRecord]) -> Option<Table> {
    let mut titles: Vec<String> = Vec::new();
    for case in records.iter().flat_map(|r| &r.cases) {
        let title = case_title(case);
        if !titles.contains(&title) {
            titles.push(title);
        }
    }
    let cell = |title: &str, r: &BenchRecord| {
        let case = r.cases.iter().find(|c| case_title(c) == title);
        case.map_or_else(
            || "–".into(),
            |c| {
                let i = &c.iteration;
                ranged(i.median_ms, i.min_ms, i.max_ms)
            },
        )
    };
    let row = |name: String, cell: &dyn Fn(&BenchRecord) -> String| -> Vec<String> {
        let cells = records.iter().map(|r| cell(r));
        std::iter::once(name).chain(cells).collect()
    };
    let of = |s: &Spread| ranged(s.median, s.min, s.max);
    let mut rows = vec![
        row("multiply-adds, GFLOP/s".into(), &|r| of(&r.peak.fma)),
        row("copy, GB/s".into(), &|r| of(&r.peak.copy)),
    ];
    rows.extend(titles.into_iter().map(|title| {
        let name = format!("{title}, ms");
        row(name, &|r| cell(&title, r))
    }));
    (records.len() > 1).then(|| Table {
        title: "Devices side by side".into(),
        note: "Measured peaks, and wall time of one iteration, median (min–max).".into(),
        columns: row("".into(), &|r| r.device.clone()),
        rows,
    })
}

/// The records that there are.
pub(super) fn done<'a>(outcomes: &'a [Outcome]) -> Vec<&'a BenchRecord> {
    let record = |o: &'a Outcome| match o {
        Outcome::Done(r) => Some(r.as_ref()),
        Outcome::Failed { .. } => None,
    };
    outcomes.iter().filter_map(record).collect()
}

/// Every device as Markdown.
#[must_use]
pub fn markdown(outcomes: &[Outcome]) -> String {
    let mut out = format!("# mhsplat {} bench\n", env!("CARGO_PKG_VERSION"));
    if let Some(table) = comparison(&done(outcomes)) {
        write_markdown(&mut out, &table, "##");
    }
    for outcome in outcomes {
        match outcome {
            Outcome::Done(record) => {
                let a = &record.about;
                let _ = write!(
                    out,
                    "\n## {}\n\n{}, driver {}, {} compute units\n",
                    record.device, a.platform, a.driver, a.compute_units
                );
                for table in of_record(record) {
                    write_markdown(&mut out, &table, "###");
                }
            }
            Outcome::Failed { device, error } => {
                let _ = write!(out, "\n## {device}\n\nNot measured: {error}\n");
            }
        }
    }
    out
}
