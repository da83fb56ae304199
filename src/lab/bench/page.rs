//! `bench.html`: every device on one page.

use std::collections::BTreeSet;
use std::fmt::Write;

use crate::chart::bars::{Bar, bar_chart};
use crate::chart::loglog::{LogPoint, LogSeries, log_log_chart};
use crate::chart::text::escape;
use crate::lab::bench::growth::SYNTHETIC;
use crate::lab::bench::record::{BenchRecord, Case, Outcome, Precision, Stage};
use crate::lab::bench::tables::{case_title, comparison, done, of_record};
use crate::lab::bench::work::Load;
use crate::lab::table::{Table, digits, ranged, write_html as write_table};
use crate::run::report::page;

/// Errors below this are drawn as this: f64 results may agree to the last bit.
const LEAST_ERROR: f64 = 1e-17;
/// The case that devices are compared by: Gaussians and pixels.
const COMMON: (usize, u32) = (100_000, 800);

/// The page, complete.
#[must_use]
pub fn page(outcomes: &[Outcome]) -> String {
    let records = done(outcomes);
    let mut body = format!(
        "<h1>Bench</h1><p class=sub>mhsplat {} · figures are medians of several samples; the tables give their range</p>\n",
        env!("CARGO_PKG_VERSION")
    );
    if let Some(side_by_side) = comparison(&records) {
        compare(&mut body, &records, &side_by_side);
    }
    for outcome in outcomes {
        match outcome {
            Outcome::Done(record) => device(&mut body, record),
            Outcome::Failed { device, error } => {
                let (device, error) = (escape(device), escape(error));
                let _ = writeln!(body, "<h2>{device}</h2><p>Not measured: {error}</p>");
            }
        }
    }
    page::page("mhsplat bench", &body)
}

/// Iteration times against N of the synthetic cases at one width, as a series.
fn time_series(record: &BenchRecord, width: u32, name: String) -> LogSeries {
    let cases = record.cases.iter();
    let mut cases: Vec<&Case> = cases
        .filter(|c| c.scene == SYNTHETIC && c.width == width)
        .collect();
    cases.sort_by_key(|c| c.gaussians);
    let point = |c: &&Case| {
        let i = &c.iteration;
        LogPoint {
            x: c.gaussians as f64,
            y: i.median_ms,
            label: digits(i.median_ms),
            tip: format!(
                "{}: {} ms",
                case_title(c),
                ranged(i.median_ms, i.min_ms, i.max_ms)
            ),
        }
    };
    LogSeries {
        name,
        points: cases.iter().map(point).collect(),
        line: true,
    }
}

fn compare(out: &mut String, records: &[&BenchRecord], side_by_side: &Table) {
    write_table(out, side_by_side, "h2");
    out.push_str("<div class=charts>\n");
    for width in widths(records.iter().flat_map(|r| &r.cases)) {
        let series: Vec<LogSeries> = records
            .iter()
            .map(|r| time_series(r, width, r.device.clone()))
            .collect();
        let title = format!("Iteration at {width} × {width} px");
        out.push_str(&log_log_chart(&title, "Gaussians", "ms", &series));
    }
    out.push_str("</div>\n");
}

/// Widths of the synthetic cases, rising.
fn widths<'a>(cases: impl Iterator<Item = &'a Case>) -> Vec<u32> {
    let synthetic = cases.filter(|c| c.scene == SYNTHETIC);
    let all: BTreeSet<u32> = synthetic.map(|c| c.width).collect();
    all.into_iter().collect()
}

fn device(out: &mut String, record: &BenchRecord) {
    let a = &record.about;
    let _ = writeln!(
        out,
        "<h2>{}</h2><p class=sub>{}, driver {}, {} compute units</p>",
        escape(&record.device),
        escape(&a.platform),
        escape(&a.driver),
        a.compute_units
    );
    headlines(out, record);
    out.push_str("<h3>Charts</h3><div class=charts>\n");
    let series: Vec<LogSeries> = widths(record.cases.iter())
        .iter()
        .map(|w| time_series(record, *w, format!("{w} px")))
        .collect();
    out.push_str(&log_log_chart(
        "Iteration against size",
        "Gaussians",
        "ms",
        &series,
    ));
    if let Some(case) = common_case(record) {
        out.push_str(&stage_shares(case));
    }
    for stage in ["splat", "splat_grad"] {
        let rows: Vec<&Precision> = record
            .precision
            .iter()
            .filter(|p| p.stage == stage)
            .collect();
        let title = format!("Work and precision of {stage}");
        out.push_str(&log_log_chart(
            &title,
            "ms",
            "largest error",
            &by_kind(&rows),
        ));
    }
    out.push_str("</div>\n");
    for table in of_record(record) {
        write_table(out, &table, "h3");
    }
}

/// The case of [`COMMON`] size, else the last.
fn common_case(record: &BenchRecord) -> Option<&Case> {
    let common = |c: &&Case| c.scene == SYNTHETIC && (c.gaussians, c.width) == COMMON;
    record.cases.iter().find(common).or(record.cases.last())
}

fn headlines(out: &mut String, record: &BenchRecord) {
    let p = &record.peak;
    let mut heads = vec![
        ("Multiply-adds", digits(p.fma_gflops), "GFLOP/s"),
        ("Copy", digits(p.copy_gbs), "GB/s"),
    ];
    if let Some(case) = common_case(record) {
        heads.push(("Iteration", digits(case.iteration.median_ms), "ms"));
        heads.push(("CPU time", digits(case.iteration.cpu_ms), "ms"));
        let lanes = |s: &&Stage| Load::flop_per_lane(s.name).is_some();
        let rates = case.stages.iter().filter(lanes);
        heads.extend(rates.map(|s| (s.name, digits(1e-9 * s.rate), "G/core-s")));
    }
    out.push_str("<dl class=heads>");
    for (name, value, unit) in heads {
        let _ = write!(
            out,
            "<div><dt>{}</dt><dd>{value} <small>{unit}</small></dd></div>",
            escape(name)
        );
    }
    out.push_str("</dl>");
    if let Some(case) = common_case(record) {
        let _ = writeln!(
            out,
            "<p class=note>Iteration, and lanes of the splat kernels: {}.</p>",
            escape(&case_title(case))
        );
    }
}

fn stage_shares(case: &Case) -> String {
    let total: f64 = case.stages.iter().map(|s| s.median_ms).sum();
    let bars: Vec<Bar> = case
        .stages
        .iter()
        .map(|s| Bar {
            name: s.name.to_owned(),
            value: s.median_ms,
            text: format!(
                "{} ms · {} %",
                digits(s.median_ms),
                crate::chart::text::fixed(100.0 * s.median_ms / total, 1)
            ),
        })
        .collect();
    let title = format!("Stages, {} Gaussians, {} px", case.gaussians, case.width);
    bar_chart(&title, &bars)
}

/// Variants of a kind share a colour: vector widths, style, precision, cut-offs.
fn by_kind(rows: &[&Precision]) -> Vec<LogSeries> {
    let kinds = [
        ("f32, lanes", "f32 × ", true),
        ("f32, group per tile", "f32, group", false),
        ("f64", "f64", false),
        ("alpha cut, against none", "cut ", true),
    ];
    let point = |p: &&&Precision, prefix: &str| LogPoint {
        x: p.median_ms,
        y: p.max_rel_error.max(LEAST_ERROR),
        label: p.variant.strip_prefix(prefix).unwrap_or("").to_owned(),
        tip: format!(
            "{}: {} ms, largest error {:.1e}, median {:.1e}",
            p.variant,
            ranged(p.median_ms, p.min_ms, p.max_ms),
            p.max_rel_error,
            p.median_rel_error
        ),
    };
    let of_kind = |(name, prefix, labelled): (&str, &'static str, bool)| LogSeries {
        name: name.to_owned(),
        points: rows
            .iter()
            .filter(|p| p.variant.starts_with(prefix))
            .map(|p| {
                let point = point(&p, prefix);
                LogPoint {
                    label: if labelled { point.label } else { String::new() },
                    ..point
                }
            })
            .collect(),
        line: labelled,
    };
    kinds.into_iter().map(of_kind).collect()
}
