//! The tables of a comparison.

use crate::chart::text::fixed;
use crate::lab::compare::comparison::Comparison;
use crate::lab::compare::load::Clock;
use crate::lab::compare::outcome::{GroupOutcome, Reach, SHARES};
use crate::lab::compare::paired::{Paired, PairedTime};
use crate::lab::compare::remarks::{Difference, unequal};
use crate::lab::stats::Spread;
use crate::lab::table::{Table, digits, few, or_dash, spread};

/// `median (min–max)` with so many decimals; the figure alone if all samples are spelt alike, a dash of `None`.
fn ended(figures: Option<Spread>, decimals: usize) -> String {
    let text = |v: f64| fixed(v, decimals);
    or_dash(figures, |s| match text(s.min) == text(s.max) {
        true => text(s.median),
        false => spread(&s, text),
    })
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
        _ => spread(s, amount),
    }
}

/// The time at which all runs reached it, or some, or "not reached".
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

/// A PSNR as a heading.
#[must_use]
pub fn decibels(psnr: f64) -> String {
    let text = format!("{psnr:.2}");
    format!("{} dB", text.trim_end_matches('0').trim_end_matches('.'))
}

/// `3`, or `3 of 2 seeds` if there are fewer seeds than runs.
fn samples(g: &GroupOutcome) -> String {
    match (g.runs.len(), g.seeds) {
        (runs, seeds) if runs == seeds => runs.to_string(),
        (runs, seeds) => format!("{runs} of {seeds} seeds"),
    }
}

/// `first` columns, then one per threshold.
fn by_threshold<'a>(first: &[&'a str], thresholds: &'a [String]) -> Vec<&'a str> {
    let own = first.iter().copied();
    own.chain(thresholds.iter().map(String::as_str)).collect()
}

fn threshold_names(c: &Comparison) -> Vec<String> {
    c.thresholds.iter().map(|t| decibels(*t)).collect()
}

/// Final figures of every group.
#[must_use]
pub fn finals(c: &Comparison) -> Table {
    let has_cpu = c.groups.iter().all(|g| g.cpu_seconds.is_some());
    let clock = if has_cpu { Clock::Cpu } else { Clock::Train };
    let row = |g: &GroupOutcome| {
        let seconds = match has_cpu {
            true => g.cpu_seconds,
            false => g.train_seconds,
        };
        vec![
            g.label.clone(),
            samples(g),
            ended(g.gaussians, 0),
            ended(g.psnr, 2),
            ended(g.ssim, 3),
            ended(g.flip, 3),
            or_dash(seconds, |s| amounts(&s)),
        ]
    };
    let note = format!(
        "Median (min–max) over the runs of a group; means over the held-out views; {}.",
        match unequal(&c.groups, c.reference_place()).is_empty() {
            true => "numbers of Gaussians are equal to 2 %",
            false => "numbers of Gaussians are not equal",
        }
    );
    let columns = ["group", "runs", "Gaussians", "PSNR, dB", "SSIM", "FLIP"];
    let columns = [&columns[..], &[clock.name()]].concat();
    Table::new("At the end", note, &columns, c.groups.iter().map(row))
}

/// Times to equal PSNR by one clock.
#[must_use]
pub fn times(c: &Comparison, clock: Clock) -> Table {
    let row = |g: &GroupOutcome| {
        let cell = |place: usize| or_dash(g.reach(place, clock), reach);
        let cells = (0..c.thresholds.len()).map(cell);
        std::iter::once(g.label.clone()).chain(cells).collect()
    };
    Table::new(
        format!("Time to equal PSNR, {}", clock.name()),
        format!(
            "The first time at which the mean PSNR of the held-out views is that or more, interpolated between \
             evaluations: median (min–max) where all runs reach it, else how many of them and when. {}",
            c.threshold_rule
        ),
        &by_threshold(&["group"], &threshold_names(c)),
        c.groups.iter().map(row),
    )
}

/// The ratio of the pairs at one threshold; if not all have one, in how many of them the reference is no later.
fn ratio(t: &PairedTime, reference: &str) -> String {
    let known = t.verdict();
    match (&t.spread, known.of) {
        (Some(s), _) => few(s, |v| fixed(v, 2)),
        (None, 0) => "–".into(),
        (None, _) => format!("{reference} {} of {}", known.holds, known.of),
    }
}

/// Times of every other group over those of the reference, pair by pair.
#[must_use]
pub fn relative(c: &Comparison) -> Table {
    let row = |p: &Paired| {
        let mean = or_dash(p.mean.as_ref(), |m| {
            let of = format!("{} of {}", p.mean_of, p.to_psnr.len());
            format!("{}, {of}", few(m, |v| fixed(v, 2)))
        });
        let counts = p.counts.text(&c.reference, &p.label);
        let mut row = vec![
            p.label.clone(),
            p.pairs_text(),
            mean,
            p.no_later.text(),
            counts,
        ];
        row.extend(p.to_psnr.iter().map(|t| ratio(t, &c.reference)));
        row
    };
    let first = [
        "group",
        "pairs",
        "geometric mean",
        "no later",
        "values reached by",
    ];
    Table::new(
        format!("Time over that of {}, {}", c.reference, c.clock.name()),
        format!(
            "Above 1: {0} is sooner. Ratios run by run: by seed, or in the order of the runs where the groups have no seed in \
             common; median, and the range of three pairs and more. \"{0} 2 of 3\": not all pairs have a ratio, because a run has not \
             reached the value or had it at its first evaluation; {0} is no later in 2 of the 3 in which that is known (a finished run \
             that has not reached a value never does); –: not known of any. The mean is over the values at which every pair has a \
             ratio. \"No later\": {0}, at every value at which it is known.",
            c.reference
        ),
        &by_threshold(&first, &threshold_names(c)),
        c.relative.iter().map(row),
    )
}

/// Times to a share of a run's own final PSNR.
pub(super) fn shares(c: &Comparison) -> Table {
    let mut clocks = vec![c.clock, Clock::Iterations];
    clocks.dedup();
    let name = |clock: &Clock, share: f64| format!("{:.0} %, {}", 100.0 * share, clock.name());
    let names = clocks.iter().flat_map(|k| SHARES.map(|s| name(k, s)));
    let names: Vec<String> = names.collect();
    let row = |g: &GroupOutcome| {
        let mut row = vec![g.label.clone()];
        for clock in &clocks {
            let of = |r: &&Reach| r.clock == *clock;
            let found = g.to_share.iter().map(|s| s.reach.iter().find(of));
            row.extend(found.map(|r| or_dash(r, reach)));
        }
        row
    };
    Table::new(
        "Time to 95 % and 98 % of the final PSNR",
        "Of each run's own final PSNR in dB: how soon it is nearly done, not how good it is.",
        &by_threshold(&["group"], &names),
        c.groups.iter().map(row),
    )
}

/// Options, devices and versions that are not the same everywhere.
pub(super) fn differences(c: &Comparison) -> Table {
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

/// Every run at its last evaluation.
pub(super) fn runs(c: &Comparison) -> Table {
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
    let columns = [
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
    ];
    Table::new("Runs", "At the last evaluation.", &columns, rows)
}
