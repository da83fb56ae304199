//! The tables of a bench.

use crate::lab::bench::growth::SYNTHETIC;
use crate::lab::bench::record::{BenchRecord, Case, Outcome, Stage};
use crate::lab::stats::Spread;
use crate::lab::table::{Table, digits, or_dash, ratio, spread};

/// `N Gaussians, W × H px` of a case, after the name of a scene from a file.
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
    let figure = spread(&stage.rate.scaled(1e-9), digits);
    format!("{figure} {unit}")
}

fn peak(record: &BenchRecord) -> Table {
    let p = &record.peak;
    let row = |name: &str, s: &Spread, unit: &str| {
        let samples = s.samples.to_string();
        vec![name.to_owned(), spread(s, digits), unit.to_owned(), samples]
    };
    let mut rows = vec![row("multiply-adds in f32, whole device", &p.fma, "GFLOP/s")];
    let core = p.fma_core.as_ref();
    rows.extend(core.map(|c| {
        row(
            "multiply-adds in f32, per second of CPU time",
            c,
            "GFLOP/core-s",
        )
    }));
    rows.push(row("copy, read and written", &p.copy, "GB/s"));
    let columns = ["peak", "median (min–max)", "unit", "samples"];
    Table::new("Measured peak", "", &columns, rows)
}

fn iterations(record: &BenchRecord) -> Table {
    let row = |c: &Case| {
        let i = &c.iteration;
        vec![
            case_title(c),
            spread(&i.ms, digits),
            spread(&i.cpu_ms, digits),
            spread(&i.cores_busy, digits),
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
        vec![
            s.name.to_owned(),
            spread(&s.ms, digits),
            or_dash(s.cpu_ms, |s| spread(&s, digits)),
            rate(s),
            or_dash(s.share, |r| ratio(&r.scaled(100.0))),
        ]
    };
    let note = "Device time per iteration, median (min–max). CPU ms and core-s are device time times the cores busy over the whole \
         iteration, so they are too low by what other stages leave idle (see above). Share of the measured peak: FLOP of the lanes over the multiply-adds, \
         bytes over the copy; above 100 % where data stay in a cache.";
    let columns = ["stage", "ms", "CPU ms", "rate", "% of peak"];
    Table::new(
        case_title(case),
        note,
        &columns,
        case.stages.iter().map(row),
    )
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
            spread(&p.ms, digits),
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

/// Every table of a device.
pub(super) fn of_record(record: &BenchRecord) -> Vec<Table> {
    let mut all = vec![peak(record), iterations(record)];
    all.extend(record.cases.iter().map(stages));
    all.extend([growth(record), precision(record), failures(record)]);
    all
}

/// Peaks and iteration times of several devices side by side; `None` for fewer than two.
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
        let time = case.map(|c| &c.iteration);
        or_dash(time, |i| spread(&i.ms, digits))
    };
    let row = |name: String, cell: &dyn Fn(&BenchRecord) -> String| -> Vec<String> {
        let cells = records.iter().map(|r| cell(r));
        std::iter::once(name).chain(cells).collect()
    };
    let mut rows = vec![
        row("multiply-adds, GFLOP/s".into(), &|r| {
            spread(&r.peak.fma, digits)
        }),
        row("copy, GB/s".into(), &|r| spread(&r.peak.copy, digits)),
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

/// Records of the devices that were measured.
pub(super) fn done<'a>(outcomes: &'a [Outcome]) -> Vec<&'a BenchRecord> {
    let record = |o: &'a Outcome| match o {
        Outcome::Done(r) => Some(r.as_ref()),
        Outcome::Failed { .. } => None,
    };
    outcomes.iter().filter_map(record).collect()
}
