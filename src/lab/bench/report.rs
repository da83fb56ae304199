//! The report of a bench: every device with its tables and charts, and several side by side; and the files of `-o DIR`.

use std::collections::BTreeSet;
use std::path::Path;

use crate::base::error::Result;
use crate::chart::svg::{Bar, LogPoint, LogSeries, bar_chart, log_log_chart};
use crate::chart::text::fixed;
use crate::lab::bench::record::{BenchRecord, Case, Outcome, Stage};
use crate::lab::bench::scene::SYNTHETIC;
use crate::lab::folder::{one_or_all, write_files};
use crate::lab::report::{Report, Section};
use crate::lab::stats::Spread;
use crate::lab::table::{Table, digits, or_dash, ratio, spread};

/// Least error that is drawn: f64 results may agree to the last bit.
const MIN_ERROR: f64 = 1e-17;
/// Header of `bench.csv`: a row per stage of a case, per whole iteration, and per variant of a stage. Cells that do not
/// apply are empty.
const HEADER: &str = "device,scene,gaussians,width,height,pairs,stage,variant,median_ms,min_ms,max_ms,cpu_ms,samples,\
     rate,unit,share_of_peak,max_rel_error\n";
/// Case whose stages are drawn: Gaussians and pixels.
const COMMON: (usize, u32) = (100_000, 800);

/// All devices as a report.
#[must_use]
pub fn report(outcomes: &[Outcome]) -> Report {
    let records: Vec<&BenchRecord> = outcomes.iter().filter_map(Outcome::record).collect();
    let mut sections = Vec::new();
    if records.len() > 1 {
        sections.push(Section::Table(comparison(&records)));
    }
    sections.extend(outcomes.iter().map(|outcome| {
        Section::Part(match outcome {
            Outcome::Done(record) => device(record),
            Outcome::Failed { device, error } => Report {
                title: device.clone(),
                subtitle: format!("Not measured: {error}"),
                ..Report::default()
            },
        })
    }));
    Report {
        title: "Bench".into(),
        subtitle: format!(
            "mhsplat {} · figures are medians of several samples; the tables give their range",
            env!("CARGO_PKG_VERSION")
        ),
        sections,
        ..Report::default()
    }
}

/// Peaks and iteration times of several devices side by side.
fn comparison(records: &[&BenchRecord]) -> Table {
    let mut titles: Vec<String> = Vec::new();
    for title in records.iter().flat_map(|r| &r.cases).map(title) {
        if !titles.contains(&title) {
            titles.push(title);
        }
    }
    let row = |name: String, cell: &dyn Fn(&BenchRecord) -> String| -> Vec<String> {
        let cells = records.iter().map(|r| cell(r));
        std::iter::once(name).chain(cells).collect()
    };
    let mut rows = vec![
        row("multiply-adds, GFLOP/s".into(), &|r| figure(&r.peak.fma)),
        row("copy, GB/s".into(), &|r| figure(&r.peak.copy)),
    ];
    rows.extend(titles.into_iter().map(|of| {
        row(format!("{of}, ms"), &|r| {
            let case = r.cases.iter().find(|c| title(c) == of);
            or_dash(case, |c| figure(&c.iteration.ms))
        })
    }));
    Table {
        title: "Devices side by side".into(),
        note: "Measured peaks, and wall time of one iteration, median (min–max).".into(),
        columns: row(String::new(), &|r| r.device.clone()),
        rows,
    }
}

fn device(record: &BenchRecord) -> Report {
    let a = &record.about;
    let mut tables = vec![peak(record), iterations(record)];
    tables.extend(record.cases.iter().map(stages));
    tables.extend([growth(record), precision(record), failures(record)]);
    let common = |c: &&Case| c.scene == SYNTHETIC && (c.gaussians, c.width) == COMMON;
    let common = record.cases.iter().find(common).or(record.cases.last());
    let mut figures = vec![growth_chart(record), precision_chart(record)];
    figures.extend(common.map(stage_chart));
    let charts = Section::Charts {
        title: "Charts".into(),
        note: String::new(),
        figures,
    };
    let tables = tables.into_iter().map(Section::Table);
    Report {
        title: record.device.clone(),
        subtitle: format!("{}, driver {}, {}", a.platform, a.driver, a.units()),
        sections: std::iter::once(charts).chain(tables).collect(),
        ..Report::default()
    }
}

/// `N Gaussians, W × H px` of a case, after the name of a scene from a file.
fn title(case: &Case) -> String {
    let name = match case.scene.as_str() {
        SYNTHETIC => String::new(),
        other => format!("{other}, "),
    };
    let (n, w, h) = (case.gaussians, case.width, case.height);
    format!("{name}{n} Gaussians, {w} × {h} px")
}

fn figure(s: &Spread) -> String {
    spread(s, digits)
}

fn peak(record: &BenchRecord) -> Table {
    let p = &record.peak;
    let row = |name: &str, s: &Spread, unit: &str| {
        let samples = s.samples.to_string();
        vec![name.to_owned(), figure(s), unit.to_owned(), samples]
    };
    let per_core = "multiply-adds in f32, per second of CPU time";
    let core = p.fma_core.iter().map(|c| row(per_core, c, "GFLOP/core-s"));
    let mut rows = vec![row("multiply-adds in f32, whole device", &p.fma, "GFLOP/s")];
    rows.extend(core);
    rows.push(row("copy, read and written", &p.copy, "GB/s"));
    let columns = ["peak", "median (min–max)", "unit", "samples"];
    Table::new("Measured peak", "", &columns, rows)
}

fn iterations(record: &BenchRecord) -> Table {
    let row = |c: &Case| {
        let i = &c.iteration;
        vec![
            title(c),
            figure(&i.ms),
            figure(&i.cpu_ms),
            figure(&i.cores_busy),
            c.pairs.to_string(),
            digits(1e-6 * i.lanes as f64),
            digits(i.bytes_per_gaussian),
            format!("{} of {}", i.ms.samples, i.iterations),
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
    let rows = record.cases.iter().map(row);
    Table::new("Whole iteration", note, &columns, rows)
}

fn stages(case: &Case) -> Table {
    let row = |s: &Stage| {
        // Lanes in 10⁹, bytes in GB.
        let unit = match s.unit {
            "bytes/s" => "GB/s",
            _ => "Glanes/core-s",
        };
        vec![
            s.name.to_owned(),
            figure(&s.ms),
            or_dash(s.cpu_ms, |s| figure(&s)),
            format!("{} {unit}", figure(&s.rate.scaled(1e-9))),
            or_dash(s.share, |r| ratio(&r.scaled(100.0))),
        ]
    };
    let tuning = case.tuning;
    let note = format!(
        "Device time per iteration, median (min–max). CPU ms and core-s are device time times the cores busy over the whole \
         iteration, so they are too low by what other stages leave idle (see above). Share of the measured peak: FLOP of the lanes over the multiply-adds, \
         bytes over the copy; above 100 % where data stay in a cache. Tuning: {tuning}."
    );
    let columns = ["stage", "ms", "CPU ms", "rate", "% of peak"];
    Table::new(title(case), &note, &columns, case.stages.iter().map(row))
}

fn growth(record: &BenchRecord) -> Table {
    let rows = record.growth.iter().map(|g| {
        let [from, to] = g.between;
        vec![
            g.what.clone(),
            ratio(&g.exponent),
            g.points.to_string(),
            format!("{from} to {to}"),
            ratio(&g.ratio),
        ]
    });
    let columns = ["growth", "exponent", "cases", "from, to", "ratio"];
    let note = "Least squares in the logarithms; ranges from the smallest and largest samples. Memory is known, not sampled.";
    Table::new("Growth", note, &columns, rows)
}

fn precision(record: &BenchRecord) -> Table {
    let rows = record.precision.iter().map(|p| {
        vec![
            p.stage.to_owned(),
            p.variant.clone(),
            figure(&p.ms),
            format!("{:.1e}", p.max_rel_error),
            format!("{:.1e}", p.median_rel_error),
        ]
    });
    let note = "Error over the largest value of the f64 reference, which has the same alpha cut, but for the rows named `cut`: \
         there it has none. The largest error counts values in which a contribution at the cut fell to the other side.";
    let columns = ["stage", "variant", "ms", "largest error", "median error"];
    Table::new("Work and precision", note, &columns, rows)
}

fn failures(record: &BenchRecord) -> Table {
    let rows = record.failed.iter();
    let rows = rows.map(|f| vec![f.what.clone(), f.error.clone()]);
    Table::new("Not measured", "", &["case", "reason"], rows)
}

/// Iteration times of the synthetic cases against the number of Gaussians, a line per resolution.
fn growth_chart(record: &BenchRecord) -> String {
    let cases = || record.cases.iter().filter(|c| c.scene == SYNTHETIC);
    let widths: BTreeSet<u32> = cases().map(|c| c.width).collect();
    let series = widths.into_iter().map(|width| {
        let mut cases: Vec<&Case> = cases().filter(|c| c.width == width).collect();
        cases.sort_by_key(|c| c.gaussians);
        let point = |c: &&Case| LogPoint {
            x: c.gaussians as f64,
            y: c.iteration.ms.median,
            label: digits(c.iteration.ms.median),
            tip: format!("{}: {} ms", title(c), figure(&c.iteration.ms)),
        };
        LogSeries {
            name: format!("{width} px"),
            points: cases.iter().map(point).collect(),
            line: true,
        }
    });
    let series: Vec<LogSeries> = series.collect();
    log_log_chart("Iteration against size", "Gaussians", "ms", &series)
}

/// Error against time of every variant of the splat stages.
fn precision_chart(record: &BenchRecord) -> String {
    let series = ["splat", "splat_grad"].map(|stage| {
        let rows = record.precision.iter().filter(|p| p.stage == stage);
        let point = rows.map(|p| LogPoint {
            x: p.ms.median,
            y: p.max_rel_error.max(MIN_ERROR),
            label: p.variant.clone(),
            tip: format!(
                "{stage}, {}: {} ms, largest error {:.1e}, median {:.1e}",
                p.variant,
                figure(&p.ms),
                p.max_rel_error,
                p.median_rel_error
            ),
        });
        LogSeries {
            name: stage.to_owned(),
            points: point.collect(),
            line: false,
        }
    });
    log_log_chart("Work and precision", "ms", "largest error", &series)
}

fn stage_chart(case: &Case) -> String {
    let total: f64 = case.stages.iter().map(|s| s.ms.median).sum();
    let bar = |s: &Stage| {
        let (ms, share) = (digits(s.ms.median), 100.0 * s.ms.median / total);
        Bar {
            name: s.name.to_owned(),
            value: s.ms.median,
            text: format!("{ms} ms · {} %", fixed(share, 1)),
        }
    };
    let bars: Vec<Bar> = case.stages.iter().map(bar).collect();
    bar_chart(&format!("Stages, {}", title(case)), &bars)
}

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
    let cpu = cpu.map_or_else(String::new, |s| s.median.to_string());
    format!("{},{},{},{cpu},{}", ms.median, ms.min, ms.max, ms.samples)
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
                let times = times(&s.ms, s.cpu_ms);
                let share = s.share.map_or_else(String::new, |r| r.median.to_string());
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
