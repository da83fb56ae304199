//! The report of a bench: every device, and several side by side.

use std::collections::BTreeSet;

use crate::chart::svg::{Bar, LogPoint, LogSeries, bar_chart, log_log_chart};
use crate::chart::text::fixed;
use crate::lab::bench::growth::SYNTHETIC;
use crate::lab::bench::record::{BenchRecord, Case, Outcome, Precision, Stage};
use crate::lab::bench::tables::{case_title, comparison, done, of_record};
use crate::lab::bench::work::Load;
use crate::lab::report::{Report, Section};
use crate::lab::table::{digits, spread};

/// Least error that is drawn: f64 results may agree to the last bit.
const MIN_ERROR: f64 = 1e-17;
/// Case that devices are compared by: Gaussians and pixels.
const COMMON: (usize, u32) = (100_000, 800);

/// All devices as a report.
#[must_use]
pub fn report(outcomes: &[Outcome]) -> Report {
    let records = done(outcomes);
    let mut sections = Vec::new();
    if let Some(side_by_side) = comparison(&records) {
        sections.push(Section::Table(side_by_side));
        let each = |width: u32| {
            let series = |r: &&BenchRecord| time_series(r, width, r.device.clone());
            let series: Vec<LogSeries> = records.iter().map(series).collect();
            let title = format!("Iteration at {width} × {width} px");
            log_log_chart(&title, "Gaussians", "ms", &series)
        };
        let widths = widths(records.iter().flat_map(|r| &r.cases));
        sections.push(charts("", widths.into_iter().map(each).collect()));
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

fn charts(title: &str, figures: Vec<String>) -> Section {
    Section::Charts {
        title: title.into(),
        note: String::new(),
        figures,
    }
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
            y: i.ms.median,
            label: digits(i.ms.median),
            tip: format!("{}: {} ms", case_title(c), spread(&i.ms, digits)),
        }
    };
    LogSeries {
        name,
        points: cases.iter().map(point).collect(),
        line: true,
    }
}

/// Widths of the synthetic cases, rising.
fn widths<'a>(cases: impl Iterator<Item = &'a Case>) -> Vec<u32> {
    let synthetic = cases.filter(|c| c.scene == SYNTHETIC);
    let all: BTreeSet<u32> = synthetic.map(|c| c.width).collect();
    all.into_iter().collect()
}

fn device(record: &BenchRecord) -> Report {
    let a = &record.about;
    let widths = widths(record.cases.iter());
    let series = widths
        .iter()
        .map(|w| time_series(record, *w, format!("{w} px")));
    let series: Vec<LogSeries> = series.collect();
    let title = "Iteration against size";
    let mut figures = vec![log_log_chart(title, "Gaussians", "ms", &series)];
    figures.extend(common_case(record).map(stage_shares));
    for stage in ["splat", "splat_grad"] {
        let rows = record.precision.iter().filter(|p| p.stage == stage);
        let series = by_kind(&rows.collect::<Vec<_>>());
        let title = format!("Work and precision of {stage}");
        figures.push(log_log_chart(&title, "ms", "largest error", &series));
    }
    let mut sections = headlines(record);
    sections.push(charts("Charts", figures));
    sections.extend(of_record(record).into_iter().map(Section::Table));
    Report {
        title: record.device.clone(),
        subtitle: format!(
            "{}, driver {}, {} compute units",
            a.platform, a.driver, a.compute_units
        ),
        sections,
        ..Report::default()
    }
}

/// The case of [`COMMON`] size, else the last.
fn common_case(record: &BenchRecord) -> Option<&Case> {
    let common = |c: &&Case| c.scene == SYNTHETIC && (c.gaussians, c.width) == COMMON;
    record.cases.iter().find(common).or(record.cases.last())
}

fn headlines(record: &BenchRecord) -> Vec<Section> {
    let p = &record.peak;
    let head = |name: &str, value: f64, unit: &str| [name.into(), digits(value), unit.into()];
    let mut heads = vec![
        head("Multiply-adds", p.fma_gflops, "GFLOP/s"),
        head("Copy", p.copy_gbs, "GB/s"),
    ];
    let Some(case) = common_case(record) else {
        return vec![Section::Headlines(heads)];
    };
    heads.push(head("Iteration", case.iteration.ms.median, "ms"));
    heads.push(head("CPU time", case.iteration.cpu_ms.median, "ms"));
    let lanes = |s: &&Stage| Load::flop_per_lane(s.name).is_some();
    let rates = case.stages.iter().filter(lanes);
    heads.extend(rates.map(|s| head(s.name, 1e-9 * s.rate.median, "G/core-s")));
    let of = format!(
        "Iteration, and lanes of the splat kernels: {}.",
        case_title(case)
    );
    vec![Section::Headlines(heads), Section::Text(of)]
}

fn stage_shares(case: &Case) -> String {
    let total: f64 = case.stages.iter().map(|s| s.ms.median).sum();
    let bars: Vec<Bar> = case
        .stages
        .iter()
        .map(|s| Bar {
            name: s.name.to_owned(),
            value: s.ms.median,
            text: format!(
                "{} ms · {} %",
                digits(s.ms.median),
                fixed(100.0 * s.ms.median / total, 1)
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
        x: p.ms.median,
        y: p.max_rel_error.max(MIN_ERROR),
        label: p.variant.strip_prefix(prefix).unwrap_or("").to_owned(),
        tip: format!(
            "{}: {} ms, largest error {:.1e}, median {:.1e}",
            p.variant,
            spread(&p.ms, digits),
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
