//! The charts of the page: quality, density control and time by stage.

use std::fmt::Write;

use crate::chart::axis::{Axis, Scale};
use crate::chart::svg::{Banded, Bar, band_chart, bar_chart};
use crate::chart::text::{escape, fixed, grouped, span};
use crate::config::Sampler;
use crate::density::DensityStats;
use crate::run::density_trace::FunnelRow;
use crate::run::record::{RunRecord, StageRecord};
use crate::run::table::{DensityRow, MetricsRow};
use crate::train::TIMING_INTERVAL;

const TIME: Axis<'static> = Axis::from_zero("training time", Scale::Seconds);
const ITERATION: Axis<'static> = number("iteration");
const PSNR: Axis<'static> = Axis::framing("PSNR", "dB");
const SSIM: Axis<'static> = Axis::framing("SSIM", "");
const SHARE: Axis<'static> = Axis::from_zero("accepted", Scale::Percent);

/// An axis from zero for a plain number.
const fn number(label: &str) -> Axis<'_> {
    Axis::from_zero(label, Scale::Number)
}

fn points<R>(rows: &[R], x: impl Fn(&R) -> f64, y: impl Fn(&R) -> Option<f64>) -> Vec<(f64, f64)> {
    rows.iter()
        .filter_map(|r| y(r).map(|value| (x(r), value)))
        .collect()
}

/// Writes a chart of a single line.
fn line(out: &mut String, title: &str, x: Axis<'_>, y: Axis<'_>, points: Vec<(f64, f64)>) {
    out.push_str(&band_chart(title, &x, &y, &[Banded::line("", points)]));
}

/// Charts of scores, number of Gaussians and loss.
pub(super) fn quality(out: &mut String, rows: &[MetricsRow], density: &[DensityRow]) {
    let time = |r: &MetricsRow| r.train_seconds;
    let iteration = |r: &MetricsRow| f64::from(r.iteration);
    out.push_str("<h2>Quality on held-out views</h2><div class=charts>\n");
    type Score = fn(&MetricsRow) -> Option<f64>;
    let scores: [(&str, Axis<'_>, Score); 2] =
        [("PSNR", PSNR, |r| r.psnr), ("SSIM", SSIM, |r| r.ssim)];
    for (name, y, score) in scores {
        let [over_time, over_steps] = ["time", "iterations"].map(|x| format!("{name} against {x}"));
        line(out, &over_time, TIME, y, points(rows, time, score));
        line(
            out,
            &over_steps,
            ITERATION,
            y,
            points(rows, iteration, score),
        );
    }
    out.push_str("</div>\n<h2>Gaussians and loss</h2><div class=charts>\n");
    // Density steps come more often than evaluations; evaluations also cover the time without density control.
    let mut counts = points(rows, time, |r| Some(r.gaussians as f64));
    counts.extend(
        density
            .iter()
            .map(|r| (r.train_seconds, r.gaussians as f64)),
    );
    counts.sort_by(|a, b| a.0.total_cmp(&b.0));
    let gaussians = number("Gaussians");
    line(out, "Gaussians against time", TIME, gaussians, counts);
    let loss = points(rows, time, |r| r.loss);
    line(out, "Training loss", TIME, number("loss"), loss);
    out.push_str("</div>\n");
}

/// One number of a step.
type Count = fn(&DensityStats) -> u64;

/// Charts of the counts of each density step.
pub(super) fn density_control(out: &mut String, sampler: Sampler, density: &[DensityRow]) {
    if sampler == Sampler::None {
        out.push_str("<h2>Density control</h2><p class=note>A fixed set of Gaussians.</p>\n");
        return;
    }
    out.push_str("<h2>Density control, per step</h2><div class=charts>\n");
    let shown: &[(&str, Count)] = match sampler {
        Sampler::Adc => &[
            ("cloned", |s| s.cloned),
            ("split", |s| s.split),
            ("removed", |s| s.pruned),
        ],
        Sampler::Mcmc => &[("born", |s| s.accepted), ("relocated", |s| s.relocated)],
        _ => &[
            ("born", |s| s.accepted),
            ("relocated", |s| s.relocated),
            ("removed", |s| s.pruned),
        ],
    };
    if sampler == Sampler::Mh {
        acceptance(out, density);
    }
    let changes = shown.iter().map(|(name, count)| {
        let counts = points(density, step_of, |r| Some(count(&r.stats) as f64));
        Banded::line(*name, counts)
    });
    let changes: Vec<Banded> = changes.collect();
    let unit = number("Gaussians");
    out.push_str(&band_chart("Changes", &ITERATION, &unit, &changes));
    match sampler {
        Sampler::Mh => voxels(out, density),
        Sampler::Adc => resets(out, density),
        _ => (),
    }
    out.push_str("</div>\n");
}

fn step_of(row: &DensityRow) -> f64 {
    f64::from(row.iteration)
}

fn acceptance(out: &mut String, density: &[DensityRow]) {
    let rate = |pair: [u64; 2]| (pair[0] > 0).then(|| pair[1] as f64 / pair[0] as f64);
    let phases = [
        ("coarse", points(density, step_of, |r| rate(r.stats.coarse))),
        ("fine", points(density, step_of, |r| rate(r.stats.fine))),
        (
            "in image space",
            points(density, step_of, |r| rate(r.stats.pixel)),
        ),
    ];
    let proposed = phases.into_iter().filter(|(_, rates)| !rates.is_empty());
    let lines: Vec<Banded> = proposed
        .map(|(name, rates)| Banded::line(name, rates))
        .collect();
    out.push_str(&band_chart("Acceptance", &ITERATION, &SHARE, &lines));
}

fn voxels(out: &mut String, density: &[DensityRow]) {
    let voxels = points(density, step_of, |r| Some(r.stats.occupied_voxels as f64));
    let unit = number("voxels");
    line(out, "Occupied voxels", ITERATION, unit, voxels);
    // D is the mean over the proposals, so a step without proposals has none.
    let prior = points(density, step_of, |r| {
        (r.stats.proposed > 0).then_some(r.stats.mean_prior)
    });
    line(out, "Mean voxel prior D", ITERATION, number("D"), prior);
}

fn resets(out: &mut String, density: &[DensityRow]) {
    let mut sum = 0;
    let so_far = density.iter().map(|r| {
        sum += r.stats.opacity_resets;
        (step_of(r), sum as f64)
    });
    let (so_far, unit) = (so_far.collect(), number("resets"));
    line(out, "Opacity resets so far", ITERATION, unit, so_far);
}

/// Table of what became of the Gaussians that each kind of move made; nothing without a trace.
pub(super) fn funnel(out: &mut String, rows: &[FunnelRow]) {
    if rows.is_empty() {
        return;
    }
    out.push_str(
        "<h2>What became of births and relocations</h2><div class=charts><div class=chart><table>\
         <tr><th>made by</th><th class=n>proposed</th><th class=n>made</th><th class=n>alive one step later</th>\
         <th class=n>in use at the end</th><th class=n>share of the picture</th></tr>",
    );
    for row in rows {
        let share = |n: u64| match row.made {
            0 => "–".to_owned(),
            made => format!(
                "{} ({} %)",
                grouped(n),
                fixed(100.0 * n as f64 / made as f64, 0)
            ),
        };
        let _ = write!(
            out,
            "<tr><td>{}</td><td class=n>{}</td><td class=n>{}</td><td class=n>{}</td><td class=n>{}</td>\
             <td class=n>{} %</td></tr>",
            row.kind,
            row.proposed.map_or_else(|| "–".to_owned(), grouped),
            grouped(row.made),
            share(row.alive),
            share(row.in_use),
            fixed(100.0 * row.share, 1)
        );
    }
    out.push_str(
        "</table></div></div><p class=note>In use: opacity above 0.05. Share of the picture: blending weight over all training \
         views; the rest is that of the Gaussians that training began with.</p>\n",
    );
}

/// Chart and table of the time by stage.
pub(super) fn stages(out: &mut String, record: &RunRecord) {
    let total: f64 = record.stages.iter().map(|s| s.seconds).sum();
    let bar = |s: &StageRecord| {
        let (share, seconds) = (s.seconds / total, digits(s.seconds));
        let percent = fixed(100.0 * share, 1);
        Bar {
            name: s.name.clone(),
            value: s.seconds,
            text: match share.is_finite() {
                true => format!("{seconds} s · {percent} %"),
                false => format!("{seconds} s"),
            },
        }
    };
    let bars: Vec<Bar> = record.stages.iter().map(bar).collect();
    out.push_str("<h2>Time by stage</h2><div class=charts>\n");
    out.push_str(&bar_chart("Seconds in each stage", &bars));
    if bars.is_empty() {
        out.push_str("</div>\n");
        return;
    }
    out.push_str(
        "<div class=chart><table>\
         <tr><th>stage</th><th class=n>calls</th><th class=n>ms per call</th></tr>",
    );
    for stage in &record.stages {
        let per_call = match stage.calls {
            0 => "–".to_owned(),
            n => digits(1e3 * stage.seconds / n as f64),
        };
        let _ = write!(
            out,
            "<tr><td>{}</td><td class=n>{}</td><td class=n>{per_call}</td></tr>",
            escape(&stage.name),
            grouped(stage.calls)
        );
    }
    let _ = writeln!(
        out,
        "</table></div></div><p class=note>{} in stages, of {} of training. Taken in one iteration of {TIMING_INTERVAL}, which stands for \
         all, or with <code>--profile</code> in each.</p>",
        span(total),
        span(record.train_seconds)
    );
}

/// A measured value with three digits or its whole part.
fn digits(value: f64) -> String {
    let decimals = match value {
        v if v < 10.0 => 2,
        v if v < 100.0 => 1,
        _ => 0,
    };
    fixed(value, decimals)
}
