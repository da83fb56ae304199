//! The report of a comparison: tables, and charts of every group over every clock.

use std::path::Path;

use crate::base::files::between;
use crate::chart::axis::{Axis, Scale};
use crate::chart::svg::{Banded, band_chart};
use crate::chart::text::{fixed, href};
use crate::lab::compare::comparison::{Comparison, Difference, values};
use crate::lab::compare::curve::{Curve, band};
use crate::lab::compare::group::{FIGURES, Group, Reach};
use crate::lab::compare::load::{Clock, Loaded};
use crate::lab::compare::paired::{Paired, PairedTime};
use crate::lab::report::{Report, Section};
use crate::lab::stats::Spread;
use crate::lab::table::{Table, digits, few, folder_name, or_dash, spread};
use crate::run::MetricsRow;
use crate::run::report::page::REPORT_FILE;

/// A quantity of an evaluation with its axis.
type Quantity = (Axis<'static>, fn(&MetricsRow) -> Option<f64>);

/// Quantities that are drawn.
const QUANTITIES: [Quantity; 3] = [
    (Axis::framing("PSNR", "dB"), |r| r.psnr),
    (Axis::framing("SSIM", ""), |r| r.ssim),
    (Axis::from_zero("Gaussians", Scale::Number), |r| {
        Some(r.gaussians as f64)
    }),
];

/// Links from a page to the reports of the runs compared, as far as these are there and a relative path leads to them.
#[must_use]
pub fn reports(c: &Comparison, page: &Path) -> Section {
    let folder = match page.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    };
    let link = |run: &Loaded| {
        let way = between(folder, &Path::new(&run.path).join(REPORT_FILE))?;
        Some((run.path.clone(), href(&way)))
    };
    Section::Links {
        summary: "Reports of the runs".into(),
        links: c.runs().filter_map(link).collect(),
    }
}

/// Caveats and tables of a comparison.
#[must_use]
pub fn brief(c: &Comparison) -> Report {
    let d = &c.dataset;
    let mut sections = vec![Section::Table(finals(c))];
    if !c.thresholds.is_empty() {
        sections.extend([times(c, c.clock), relative(c)].map(Section::Table));
    }
    Report {
        title: format!("{}: error against run time", folder_name(&d.path)),
        subtitle: format!(
            "{} training and {} held-out views, {} × {} px · {} runs in {} groups · {} · mhsplat {}",
            d.train_views,
            d.test_views,
            d.width,
            d.height,
            c.runs().count(),
            c.groups.len(),
            values("device", c.runs()).join(", "),
            c.version
        ),
        note: c.clock.words()[2].into(),
        warnings: c.warnings.clone(),
        sections,
    }
}

/// The whole comparison as a report.
#[must_use]
pub fn report(c: &Comparison) -> Report {
    let has = |clock: &Clock| *clock != c.clock && c.runs().all(|r| r.has(*clock));
    let others: Vec<Clock> = Clock::all().filter(has).collect();
    let clocks = [&[c.clock], &others[..]].concat();
    let rows = c.relative.iter().map(|p| (p.label.clone(), Some(p)));
    let title = format!("{} against the others", c.reference);
    let mut report = brief(c);
    let pairs = against(title, "group", &c.reference, rows);
    report.sections.push(Section::Table(pairs));
    let drawn = QUANTITIES.iter().map(|q| charts(c, q, &clocks));
    report.sections.extend(drawn);
    report.sections.push(Section::Table(differences(c)));
    if !c.thresholds.is_empty() {
        let times = others.iter().map(|k| Section::Table(times(c, *k)));
        report.sections.push(Section::Details {
            summary: "Other clocks".into(),
            sections: times.collect(),
        });
    }
    report
}

/// `median (min–max)`; the figure alone if all samples are spelt alike.
fn range(s: &Spread, text: impl Fn(f64) -> String) -> String {
    match text(s.min) == text(s.max) {
        true => text(s.median),
        false => spread(s, text),
    }
}

/// A number with so many decimals, or to three digits, or to the whole.
fn amount(value: f64, decimals: Option<usize>) -> String {
    match decimals {
        None if value < 1000.0 => digits(value),
        decimals => fixed(value, decimals.unwrap_or(0)),
    }
}

/// A ratio or a geometric mean of ratios.
pub fn ratios(s: &Spread) -> String {
    few(s, |v| fixed(v, 2))
}

/// The time at which all runs reached it, or some, or "not reached".
fn reach(r: &Reach) -> String {
    let times: Vec<f64> = r.runs.iter().flatten().map(|c| c.at).collect();
    let Some(s) = Spread::of(&times) else {
        return "not reached".into();
    };
    let some = match r.spread {
        Some(_) => String::new(),
        None => format!("{} of {}: ", r.reached(), r.runs.len()),
    };
    let sign = if r.at_most() { "≤ " } else { "" };
    format!("{some}{sign}{}", range(&s, |v| amount(v, None)))
}

/// A PSNR as a heading.
fn decibels(psnr: f64) -> String {
    let text = format!("{psnr:.2}");
    format!("{} dB", text.trim_end_matches('0').trim_end_matches('.'))
}

/// A row per group or pair of groups, a column per threshold.
fn by_threshold(
    c: &Comparison,
    title: String,
    note: String,
    rows: impl Iterator<Item = (String, Vec<String>)>,
) -> Table {
    let names: Vec<String> = c.thresholds.iter().map(|t| decibels(*t)).collect();
    let names = names.iter().map(String::as_str);
    let columns: Vec<&str> = std::iter::once("group").chain(names).collect();
    let rows = rows.map(|(label, cells)| [vec![label], cells].concat());
    Table::new(title, note, &columns, rows)
}

/// Final figures of every group.
fn finals(c: &Comparison) -> Table {
    let row = |g: &Group| {
        let figures = FIGURES.iter().map(|(key, _, decimals, _)| {
            or_dash(g.end.get(key), |s| range(s, |v| amount(v, *decimals)))
        });
        let runs = [g.label.clone(), g.runs.len().to_string()];
        runs.into_iter().chain(figures).collect()
    };
    let names = FIGURES.iter().map(|f| f.1);
    let columns: Vec<&str> = ["group", "runs"].into_iter().chain(names).collect();
    let note = "Median (min–max) over the runs of a group; means over the held-out views.";
    Table::new("At the end", note, &columns, c.groups.iter().map(row))
}

/// Times to equal PSNR by one clock.
fn times(c: &Comparison, clock: Clock) -> Table {
    let row = |g: &Group| {
        let cell = |place: usize| or_dash(g.reach(place, clock), reach);
        (g.label.clone(), (0..c.thresholds.len()).map(cell).collect())
    };
    by_threshold(
        c,
        format!("Time to equal PSNR, {}", clock.words()[0]),
        format!(
            "The first time at which the mean PSNR of the held-out views is that or more, interpolated between \
             evaluations: median (min–max) where all runs reach it, else how many of them and when. {}",
            c.threshold_rule
        ),
        c.groups.iter().map(row),
    )
}

/// Times of every other group over those of the reference, pair by pair.
fn relative(c: &Comparison) -> Table {
    let row = |p: &Paired| {
        let of = p.seeds.len();
        let cell = |t: &PairedTime| match (&t.spread, t.reached) {
            (Some(s), _) => ratios(s),
            (None, [a, b]) if [a, b] == [of, of] => "–".into(),
            (None, [a, b]) => format!("{} {a}, {} {b} of {of}", c.reference, p.label),
        };
        (p.label.clone(), p.to_psnr.iter().map(cell).collect())
    };
    by_threshold(
        c,
        format!("Time over that of {}, {}", c.reference, c.clock.words()[0]),
        format!(
            "Above 1: {0} is sooner. Ratios of the runs of equal seeds: median, and the range of three pairs and more. \"{0} 3, … 2 \
             of 3\": so many of the paired runs reach the value, and there is no ratio of all pairs; –: all reach it, but one \
             had it at its first evaluation.",
            c.reference
        ),
        c.relative.iter().map(row),
    )
}

/// Figures of the reference against other groups, a row each: a name, and the pairs if there are any.
pub fn against<'a>(
    title: String,
    names: &str,
    reference: &str,
    rows: impl IntoIterator<Item = (String, Option<&'a Paired>)>,
) -> Table {
    let columns = [
        names,
        "pairs",
        "time ratio",
        "worst",
        "no later",
        "Δ PSNR, dB",
        "Δ SSIM",
        "Δ FLIP",
        "values reached by",
    ];
    let change = |p: &Paired, place: usize| {
        let (key, _, decimals, _) = FIGURES[place];
        let signed = |v: f64| {
            let plus = if v > 0.0 { "+" } else { "" };
            format!("{plus}{}", amount(v, decimals))
        };
        or_dash(p.change.get(key), |s| few(s, signed))
    };
    let row = |(name, pairs): (String, Option<&Paired>)| {
        let Some(p) = pairs else {
            let mut row = vec!["–".to_owned(); columns.len()];
            row[..2].clone_from_slice(&[name, "not compared".to_owned()]);
            return row;
        };
        vec![
            name,
            p.pairs_text(),
            or_dash(p.mean.as_ref(), ratios),
            or_dash(p.worst, |(psnr, ratio)| {
                format!("{} at {}", fixed(ratio, 2), decibels(psnr))
            }),
            format!("{} of {}", p.no_later, p.mean_of),
            change(p, 1),
            change(p, 2),
            change(p, 3),
            p.counts.text(reference, &p.label),
        ]
    };
    Table::new(
        title,
        format!(
            "Runs of equal seeds; median, and the range of three pairs and more. Time ratio: time to equal PSNR of the other over that \
             of {reference} (above 1, {reference} is sooner), geometric mean over the values at which every pair has a ratio; a run \
             that does not reach a value has none. Worst: the lowest median of these values. No later: how many of them have a median \
             of 1 or more. Δ: final figure of {reference} less that of the other (more PSNR and SSIM, and less FLIP, are better). \
             Values reached by: all runs of both, of one, or of neither."
        ),
        &columns,
        rows.into_iter().map(row),
    )
}

/// Options, devices and versions that are not the same everywhere.
fn differences(c: &Comparison) -> Table {
    let labels = c.groups.iter().map(|g| g.label.as_str());
    let columns: Vec<&str> = std::iter::once("").chain(labels).collect();
    let row = |d: &Difference| [std::slice::from_ref(&d.what), &d.values].concat();
    Table::new(
        "Differences",
        "Options, device and version; everything else is the same in all runs.",
        &columns,
        c.differences.iter().map(row),
    )
}

/// A group as a line: the median of its runs, the range around it, and each run.
fn line(g: &Group, clock: Clock, of: fn(&MetricsRow) -> Option<f64>) -> Banded {
    let curves: Vec<Curve> = g.runs.iter().map(|r| r.curve(clock, of)).collect();
    let median = band(&curves);
    let several = curves.len() > 1;
    let ends: Option<Vec<f64>> = curves.iter().map(Curve::last).collect();
    let samples = curves.iter().filter(|_| several);
    let ranges = median.iter().filter(|_| several);
    Banded {
        name: g.label.clone(),
        line: median.iter().map(|(x, s)| (*x, s.median)).collect(),
        band: ranges.map(|(x, s)| (*x, s.min, s.max)).collect(),
        samples: samples.map(|k| k.points().to_vec()).collect(),
        value: ends.and_then(|v| Spread::of(&v)).map(|s| s.median),
    }
}

/// One quantity against each clock.
fn charts(c: &Comparison, (axis, of): &Quantity, clocks: &[Clock]) -> Section {
    let figure = |clock: &Clock| {
        let label = clock.words()[1];
        let scale = match clock {
            Clock::Iterations => Scale::Number,
            _ => Scale::Seconds,
        };
        let lines: Vec<Banded> = c.groups.iter().map(|g| line(g, *clock, *of)).collect();
        let name = format!("{} against {label}", axis.label);
        band_chart(&name, &Axis::from_zero(label, scale), axis, &lines)
    };
    Section::Charts {
        title: axis.label.into(),
        note: "Line: median of the runs of a group, as far as all of them go; band: their range; thin: each run to its end. The \
               figure is the median of the ends."
            .into(),
        figures: clocks.iter().map(figure).collect(),
    }
}
