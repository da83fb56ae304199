//! The figures as tables of text.

use crate::chart::text::fixed;
use crate::lab::compare::load::Clock;
use crate::lab::compare::outcome::{GroupOutcome, Reach};
use crate::lab::compare::relative::{Bounded, Limit};
use crate::lab::compare::{Comparison, outcome, remarks};
use crate::lab::stats::{Ratio, Spread};
use crate::lab::table::{Table, digits, write_markdown};

/// `median (min–max)` with so many decimals; the figure alone where all samples are that, a dash of none.
fn spread(figures: Option<Spread>, decimals: usize) -> String {
    let text = |v: f64| fixed(v, decimals);
    match figures {
        None => "–".into(),
        Some(s) if text(s.min) == text(s.max) => text(s.median),
        Some(s) => format!("{} ({}–{})", text(s.median), text(s.min), text(s.max)),
    }
}

/// Seconds or iterations, to three digits or to the whole.
fn amount(value: f64) -> String {
    if value >= 1000.0 {
        return fixed(value, 0);
    }
    digits(value)
}

fn amounts(s: &Spread) -> String {
    match s.samples {
        1 => amount(s.median),
        _ => format!("{} ({}–{})", amount(s.median), amount(s.min), amount(s.max)),
    }
}

fn ratio(r: &Ratio) -> String {
    let [median, low, high] = [r.median, r.low, r.high].map(|v| fixed(v, 2));
    format!("{median} ({low}–{high})")
}

/// When it was reached: by all runs, by some, or not.
fn reach(r: &Reach) -> String {
    let sign = if r.at_most() { "≤ " } else { "" };
    if let Some(s) = &r.spread {
        return format!("{sign}{}", amounts(s));
    }
    let times: Vec<f64> = r.runs.iter().flatten().map(|c| c.at).collect();
    match Spread::of(&times) {
        None => "not reached".into(),
        Some(s) => {
            let (low, high) = (amount(s.min), amount(s.max));
            let span = if low == high {
                low
            } else {
                format!("{low}–{high}")
            };
            format!("{} of {}: {sign}{span}", r.reached(), r.runs.len())
        }
    }
}

/// `≥ 1.42`.
#[must_use]
pub fn limit(l: &Limit) -> String {
    format!("{}{}", l.bound.sign(), fixed(l.value, 2))
}

/// A mean of bounds: what is a bound of both sides is none.
#[must_use]
pub fn bounded(b: &Bounded) -> String {
    let figure = limit(&b.limit());
    match (b.at_least, b.at_most) {
        (low, high) if low > 0 && high > 0 => {
            format!("{figure}, of {}, no bound: {low} ≥, {high} ≤", b.of)
        }
        _ => format!("{figure}, of {}", b.of),
    }
}

/// A PSNR as a heading.
#[must_use]
pub fn decibels(psnr: f64) -> String {
    let text = format!("{psnr:.2}");
    format!("{} dB", text.trim_end_matches('0').trim_end_matches('.'))
}

/// `3 runs`, with the seeds where they are fewer.
fn samples(g: &GroupOutcome) -> String {
    match (g.runs.len(), g.seeds) {
        (runs, seeds) if runs == seeds => runs.to_string(),
        (runs, seeds) => format!("{runs} of {seeds} seeds"),
    }
}

fn strings<const N: usize>(columns: [&str; N]) -> Vec<String> {
    columns.map(str::to_owned).to_vec()
}

/// What every group ends with.
#[must_use]
pub fn finals(c: &Comparison) -> Table {
    let has_cpu = c.groups.iter().all(|g| g.cpu_seconds.is_some());
    let clock = if has_cpu { Clock::Cpu } else { Clock::Train };
    let row = |g: &GroupOutcome| {
        vec![
            g.label.clone(),
            samples(g),
            spread(g.gaussians, 0),
            spread(g.psnr, 2),
            spread(g.ssim, 3),
            spread(g.flip, 3),
            match has_cpu {
                true => g.cpu_seconds,
                false => g.train_seconds,
            }
            .as_ref()
            .map_or_else(|| "–".into(), amounts),
        ]
    };
    Table {
        title: "At the end".into(),
        note: format!(
            "Median (min–max) over the runs of a group; means over the held-out views; {}.",
            match remarks::unequal(&c.groups, c.reference_place()).is_empty() {
                true => "numbers of Gaussians are equal to 2 %",
                false => "numbers of Gaussians are not equal",
            }
        ),
        columns: strings([
            "group",
            "runs",
            "Gaussians",
            "PSNR, dB",
            "SSIM",
            "FLIP",
            clock.name(),
        ]),
        rows: c.groups.iter().map(row).collect(),
    }
}

/// Times to equal PSNR by one clock.
#[must_use]
pub fn times(c: &Comparison, clock: Clock) -> Table {
    let mut columns = vec!["group".to_owned()];
    columns.extend(c.thresholds.iter().map(|t| decibels(*t)));
    let row = |g: &GroupOutcome| {
        let cell = |place: usize| g.reach(place, clock).map_or_else(|| "–".into(), reach);
        let cells = (0..c.thresholds.len()).map(cell);
        std::iter::once(g.label.clone()).chain(cells).collect()
    };
    Table {
        title: format!("Time to equal PSNR, {}", clock.name()),
        note: format!(
            "The first time at which the mean PSNR of the held-out views is that or more, interpolated between \
             evaluations: median (min–max) where all runs reach it, else how many of them and when. {}",
            c.threshold_rule
        ),
        columns,
        rows: c.groups.iter().map(row).collect(),
    }
}

/// Times over those of the reference.
#[must_use]
pub fn relative(c: &Comparison) -> Table {
    let mut columns = strings([
        "group",
        "geometric mean",
        "values reached by",
        "bounded mean",
    ]);
    columns.extend(c.thresholds.iter().map(|t| decibels(*t)));
    let rows = c.relative.iter().map(|r| {
        let cell = |t: &crate::lab::compare::relative::RelativeTime| match (&t.ratio, &t.why) {
            (Some(found), _) => ratio(found),
            (None, why) => {
                let why = why.clone().unwrap_or_default();
                t.limit
                    .map_or(why.clone(), |l| format!("{}: {why}", limit(&l)))
            }
        };
        let mean = r.mean.as_ref().map_or_else(
            || "–".into(),
            |m| format!("{}, {} of {}", ratio(m), r.mean_of, r.to_psnr.len()),
        );
        let bounded = r.bounded.as_ref().map_or_else(|| "–".into(), bounded);
        let counts = r.counts.text(&c.reference, &r.label);
        let mut row = vec![r.label.clone(), mean, counts, bounded];
        row.extend(r.to_psnr.iter().map(cell));
        row
    });
    Table {
        title: format!("Time over that of {}, {}", c.reference, c.clock.name()),
        note: format!(
            "Above 1: later than {}. Ratio of the medians (range that the samples allow); only of runs of three seeds and \
             more on both sides, of the seeds that both have where these are so many, and where all of them reach it: the \
             mean is of those alone. In the bounded mean a run that has not reached a value counts with the last reading of \
             its clock: ≥ where the group has not, ≤ where {} has not; values that neither reaches are left out of it.",
            c.reference, c.reference
        ),
        columns,
        rows: rows.collect(),
    }
}

fn shares(c: &Comparison) -> Table {
    let mut columns = vec!["group".to_owned()];
    let mut clocks = vec![c.clock, Clock::Iterations];
    clocks.dedup();
    for clock in &clocks {
        for share in outcome::SHARES {
            columns.push(format!("{:.0} %, {}", 100.0 * share, clock.name()));
        }
    }
    let row = |g: &GroupOutcome| {
        let mut row = vec![g.label.clone()];
        for clock in &clocks {
            let of = |r: &&Reach| r.clock == *clock;
            let found = g.to_share.iter().map(|s| s.reach.iter().find(of));
            row.extend(found.map(|r| r.map_or_else(|| "–".into(), reach)));
        }
        row
    };
    Table {
        title: "Time to 95 % and 98 % of the final PSNR".into(),
        note: "Of each run's own final PSNR in dB: how soon it is nearly done, not how good it is."
            .into(),
        columns,
        rows: c.groups.iter().map(row).collect(),
    }
}

fn differences(c: &Comparison) -> Table {
    let mut columns = vec![String::new()];
    columns.extend(c.groups.iter().map(|g| g.label.clone()));
    let row = |d: &crate::lab::compare::remarks::Difference| {
        let cells = d.values.iter().cloned();
        std::iter::once(d.what.clone()).chain(cells).collect()
    };
    Table {
        title: "What differs".into(),
        note: "Options, device and version; everything else is the same in all runs.".into(),
        columns,
        rows: c.differences.iter().map(row).collect(),
    }
}

fn runs(c: &Comparison) -> Table {
    let rows = c.groups.iter().flat_map(|g| {
        g.runs.iter().map(move |r| {
            let optional = |v: Option<f64>| fixed(v.unwrap_or(f64::NAN), 4);
            let end = if r.finished { "" } else { ", unfinished" };
            vec![
                g.label.clone(),
                format!("{}{end}", r.path),
                r.seed.to_string(),
                r.iterations.to_string(),
                r.gaussians.to_string(),
                fixed(r.psnr, 2),
                optional(r.ssim),
                optional(r.flip),
                amount(r.cpu_seconds),
                amount(r.train_seconds),
                amount(r.wall_seconds),
            ]
        })
    });
    Table {
        title: "Runs".into(),
        note: "At the last evaluation.".into(),
        columns: strings([
            "group",
            "run",
            "seed",
            "iterations",
            "Gaussians",
            "PSNR, dB",
            "SSIM",
            "FLIP",
            "CPU s",
            "training s",
            "wall s",
        ]),
        rows: rows.collect(),
    }
}

/// Clocks that a comparison can tell times by, its own first.
pub(super) fn clocks(c: &Comparison) -> Vec<Clock> {
    let has = |clock: &Clock| c.runs.iter().all(|r| *clock != Clock::Cpu || r.has_cpu());
    let others = Clock::ALL.into_iter().filter(|k| *k != c.clock);
    std::iter::once(c.clock).chain(others.filter(has)).collect()
}

/// Every table: the figures by the comparison's own clock, what they rest on, and those for closer looks.
#[must_use]
pub fn tables(c: &Comparison) -> [Vec<Table>; 3] {
    let mut first = vec![finals(c)];
    let mut more = Vec::new();
    if !c.thresholds.is_empty() {
        first.push(times(c, c.clock));
        first.push(relative(c));
        more.extend(clocks(c).into_iter().skip(1).map(|k| times(c, k)));
    }
    let rest = vec![shares(c), differences(c)];
    more.push(runs(c));
    [first, rest, more].map(|mut part| {
        part.retain(|t| !t.rows.is_empty());
        part
    })
}

/// Everything as Markdown.
#[must_use]
pub fn markdown(c: &Comparison) -> String {
    let d = &c.dataset;
    let mut out = format!(
        "# {}\n\n{} × {} px, {} training and {} held-out views; times by {}\n",
        crate::lab::compare::page::title(c),
        d.width,
        d.height,
        d.train_views,
        d.test_views,
        c.clock.name()
    );
    for warning in &c.warnings {
        out.push_str(&format!("\n> {warning}\n"));
    }
    for table in tables(c).iter().flatten() {
        write_markdown(&mut out, table, "##");
    }
    out
}
