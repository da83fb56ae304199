//! `report.html`: one self-contained page about a run, for a phone as well as for a desk.
//!
//! Style, charts and images are all inside; the page's own content policy forbids it to load anything. Every string that
//! comes from the run (file names, device names) is escaped.

use super::density_log::DensityRow;
use super::gallery::{ERROR_FULL_SCALE, GalleryItem, colormap, data_uri};
use super::metrics::MetricsRow;
use super::record::{FinalRecord, PlanItem, RunRecord};
use super::svg::{Axis, Bar, Scale, Series, bar_chart, line_chart};
use super::{settings, write_atomic};
use crate::error::Result;
use std::fmt::Write;
use std::path::Path;

/// Name of the page in the run folder.
pub const REPORT_FILE: &str = "report.html";

const TIME: Axis<'static> = Axis {
    label: "training time",
    unit: "s",
    scale: Scale::Seconds,
    from_zero: true,
};
const ITERATION: Axis<'static> = Axis {
    label: "iteration",
    unit: "",
    scale: Scale::Number,
    from_zero: true,
};
const PSNR: Axis<'static> = Axis {
    label: "PSNR",
    unit: "dB",
    scale: Scale::Number,
    from_zero: false,
};
const SSIM: Axis<'static> = Axis {
    label: "SSIM",
    unit: "",
    scale: Scale::Number,
    from_zero: false,
};
const SHARE: Axis<'static> = Axis {
    label: "share",
    unit: "%",
    scale: Scale::Percent,
    from_zero: true,
};
const COUNT: Axis<'static> = Axis {
    label: "count",
    unit: "",
    scale: Scale::Number,
    from_zero: true,
};

/// Writes `report.html` into `run_dir`, replacing it as a whole. Any slice may be empty.
///
/// # Errors
/// [`crate::error::Error::Numerics`] when a gallery image does not match its size, [`crate::error::Error::Io`] when
/// writing fails.
pub fn write_report(
    run_dir: &Path,
    record: &RunRecord,
    rows: &[MetricsRow],
    density: &[DensityRow],
    gallery: &[GalleryItem],
) -> Result<()> {
    let mut body = String::new();
    headlines(&mut body, record, rows);
    quality(&mut body, rows, density);
    density_control(&mut body, density);
    stages(&mut body, record);
    plan(&mut body, record);
    views(&mut body, gallery)?;
    scores(&mut body, record.final_scores.as_ref());
    settings::section(&mut body, record, run_dir);
    let title = format!("{} · mhsplat", folder_name(&record.dataset.path));
    write_atomic(&run_dir.join(REPORT_FILE), page(&title, &body).as_bytes())
}

/// A complete page of the report's style around `body` (HTML).
#[must_use]
pub fn page(title: &str, body: &str) -> String {
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"/>\
         <meta name=\"viewport\" content=\"width=device-width,initial-scale=1\"/>\
         <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none';style-src 'unsafe-inline';img-src data:\"/>\
         <title>{}</title><style>\n{}</style></head><body>\n{body}</body></html>\n",
        escape(title),
        include_str!("report.css")
    )
}

/// `text` with the characters replaced that mean something in HTML text or a quoted attribute.
#[must_use]
pub fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            // Other control characters are not allowed in HTML, whichever way they are spelt.
            c if c.is_control() && c != '\n' && c != '\t' => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}

/// `value` in groups of three digits, set apart by narrow no-break spaces.
#[must_use]
pub fn grouped(value: u64) -> String {
    let digits = value.to_string();
    let mut out = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            out.push('\u{202f}');
        }
        out.push(digit);
    }
    out
}

/// Seconds as `12.3 s`, `4 min 05 s` or `1 h 07 min`; a dash where they are not a finite span.
#[must_use]
pub fn span(seconds: f64) -> String {
    if !(seconds.is_finite() && seconds >= 0.0) {
        return "–".to_owned();
    }
    // Judged as it will be shown, so that 119.96 is not "120.0 s" and 7199.7 not "120 min 00 s".
    let whole = seconds.round() as u64;
    match whole {
        0..=9 => format!("{seconds:.2} s"),
        10..=119 => format!("{seconds:.1} s"),
        120..=7199 => format!("{} min {:02} s", whole / 60, whole % 60),
        _ => format!("{} h {:02} min", whole / 3600, whole % 3600 / 60),
    }
}

/// A number with `decimals` places, a dash where it is not finite.
fn fixed(value: f64, decimals: usize) -> String {
    if value.is_finite() {
        format!("{value:.decimals$}").replace('-', "−")
    } else {
        "–".to_owned()
    }
}

fn folder_name(path: &str) -> &str {
    let name = path.trim_end_matches(['/', '\\']);
    let name = name.rsplit(['/', '\\']).next().unwrap_or(name);
    if name.is_empty() { "run" } else { name }
}

fn headlines(out: &mut String, record: &RunRecord, rows: &[MetricsRow]) {
    let d = &record.dataset;
    let _ = write!(
        out,
        "<h1>{}</h1><p class=sub>{} training and {} held-out views, {} × {} px · {} of {} iterations · mhsplat {}</p>",
        escape(folder_name(&d.path)),
        grouped(d.train_views as u64),
        grouped(d.test_views as u64),
        d.width,
        d.height,
        grouped(record.iterations.into()),
        grouped(record.config.iterations.into()),
        escape(&record.version)
    );
    let last = record.final_scores.as_ref().map(|f| (f.psnr, f.ssim));
    let last = last.or_else(|| rows.iter().rev().find_map(|r| r.psnr.zip(r.ssim)));
    let (psnr, ssim) = last.map_or_else(
        || ("–".to_owned(), "–".to_owned()),
        |(p, s)| (format!("{} <small>dB</small>", fixed(p, 2)), fixed(s, 4)),
    );
    let cpu = match record.cpu_seconds {
        s if s > 0.0 => span(s),
        _ => "<small>not measured</small>".to_owned(),
    };
    let heads = [
        ("PSNR, held-out", psnr),
        ("SSIM, held-out", ssim),
        ("Gaussians", grouped(record.gaussians)),
        ("Training time", span(record.train_seconds)),
        ("CPU time", cpu),
    ];
    out.push_str("<dl class=heads>");
    for (name, value) in heads {
        let _ = write!(out, "<div><dt>{name}</dt><dd>{value}</dd></div>");
    }
    let _ = write!(
        out,
        "<div class=wide><dt>Device</dt><dd>{}</dd></div></dl>\n",
        escape(&record.device.name)
    );
}

fn points<R>(rows: &[R], x: impl Fn(&R) -> f64, y: impl Fn(&R) -> Option<f64>) -> Vec<(f64, f64)> {
    rows.iter()
        .filter_map(|r| y(r).map(|value| (x(r), value)))
        .collect()
}

fn single(points: Vec<(f64, f64)>) -> [Series<'static>; 1] {
    [Series { name: "", points }]
}

fn quality(out: &mut String, rows: &[MetricsRow], density: &[DensityRow]) {
    let time = |r: &MetricsRow| r.train_seconds;
    let iteration = |r: &MetricsRow| f64::from(r.iteration);
    out.push_str("<h2>Quality on held-out views</h2><div class=charts>\n");
    let charts = [
        (
            "PSNR against time",
            TIME,
            PSNR,
            points(rows, time, |r| r.psnr),
        ),
        (
            "PSNR against iterations",
            ITERATION,
            PSNR,
            points(rows, iteration, |r| r.psnr),
        ),
        (
            "SSIM against time",
            TIME,
            SSIM,
            points(rows, time, |r| r.ssim),
        ),
        (
            "SSIM against iterations",
            ITERATION,
            SSIM,
            points(rows, iteration, |r| r.ssim),
        ),
    ];
    for (title, x, y, points) in charts {
        out.push_str(&line_chart(title, &x, &y, &single(points)));
    }
    out.push_str("</div>\n<h2>Gaussians and loss</h2><div class=charts>\n");
    // Density steps come more often than evaluations; evaluations also cover the time without density control.
    let mut counts = points(rows, time, |r| Some(r.gaussians as f64));
    counts.extend(points(
        density,
        |r| r.train_seconds,
        |r| Some(r.gaussians as f64),
    ));
    counts.sort_by(|a, b| a.0.total_cmp(&b.0));
    out.push_str(&line_chart(
        "Gaussians against time",
        &TIME,
        &COUNT,
        &single(counts),
    ));
    let loss = points(rows, time, |r| r.loss);
    let axis = Axis {
        label: "loss",
        ..COUNT
    };
    out.push_str(&line_chart("Training loss", &TIME, &axis, &single(loss)));
    out.push_str("</div>\n");
}

fn density_control(out: &mut String, density: &[DensityRow]) {
    let iteration = |r: &DensityRow| f64::from(r.iteration);
    let rate = |pair: [u64; 2]| (pair[0] > 0).then(|| pair[1] as f64 / pair[0] as f64);
    out.push_str("<h2>Density control, per step</h2><div class=charts>\n");
    let phases = [
        Series {
            name: "coarse",
            points: points(density, iteration, |r| rate(r.stats.coarse)),
        },
        Series {
            name: "fine",
            points: points(density, iteration, |r| rate(r.stats.fine)),
        },
    ];
    out.push_str(&line_chart("Acceptance", &ITERATION, &SHARE, &phases));
    let born = [
        Series {
            name: "born",
            points: points(density, iteration, |r| Some(r.stats.accepted as f64)),
        },
        Series {
            name: "relocated",
            points: points(density, iteration, |r| Some(r.stats.relocated as f64)),
        },
        Series {
            name: "removed",
            points: points(density, iteration, |r| Some(r.stats.pruned as f64)),
        },
    ];
    out.push_str(&line_chart("Changes", &ITERATION, &COUNT, &born));
    let voxels = points(density, iteration, |r| Some(r.stats.occupied_voxels as f64));
    out.push_str(&line_chart(
        "Occupied voxels",
        &ITERATION,
        &COUNT,
        &single(voxels),
    ));
    // D is the mean over the proposals, so a step without proposals has none.
    let prior = points(density, iteration, |r| {
        (r.stats.proposed > 0).then_some(r.stats.mean_prior)
    });
    let axis = Axis {
        label: "D",
        ..COUNT
    };
    out.push_str(&line_chart(
        "Mean voxel prior D of the proposals",
        &ITERATION,
        &axis,
        &single(prior),
    ));
    out.push_str("</div>\n");
}

fn stages(out: &mut String, record: &RunRecord) {
    let total: f64 = record.stages.iter().map(|s| s.seconds).sum();
    let bars: Vec<Bar> = record
        .stages
        .iter()
        .map(|s| Bar {
            name: s.name.clone(),
            value: s.seconds,
            text: if total > 0.0 {
                format!(
                    "{} · {} %",
                    span(s.seconds),
                    fixed(100.0 * s.seconds / total, 1)
                )
            } else {
                span(s.seconds)
            },
        })
        .collect();
    out.push_str("<h2>Time by stage</h2>\n");
    out.push_str(&bar_chart("Seconds in each stage", &bars));
    if bars.is_empty() {
        return;
    }
    let _ = write!(
        out,
        "<p class=note>{} in stages, of {} of training.</p><details><summary>Time per call</summary><table>\
         <tr><th>stage</th><th class=n>calls</th><th class=n>ms per call</th></tr>",
        span(total),
        span(record.train_seconds)
    );
    for stage in &record.stages {
        let per_call = match stage.calls {
            0 => "–".to_owned(),
            n => fixed(1e3 * stage.seconds / n as f64, 3),
        };
        let _ = write!(
            out,
            "<tr><td>{}</td><td class=n>{}</td><td class=n>{per_call}</td></tr>",
            escape(&stage.name),
            grouped(stage.calls)
        );
    }
    out.push_str("</table></details>\n");
}

fn plan(out: &mut String, record: &RunRecord) {
    let table = |out: &mut String, items: &[PlanItem]| {
        out.push_str("<table>");
        for item in items {
            let (what, why) = (escape(&item.what), escape(&item.why));
            let _ = write!(out, "<tr><th>{what}</th><td>{why}</td></tr>");
        }
        out.push_str("</table>");
    };
    let plan = &record.plan;
    out.push_str("<h2>Left out, and why</h2>\n");
    if plan.left_out.is_empty() {
        out.push_str("<p class=note>Nothing.</p>");
    } else {
        table(out, &plan.left_out);
    }
    if !plan.kept.is_empty() {
        let _ = write!(
            out,
            "<details><summary>Kept ({})</summary>",
            plan.kept.len()
        );
        table(out, &plan.kept);
        out.push_str("</details>");
    }
    out.push('\n');
}

fn views(out: &mut String, gallery: &[GalleryItem]) -> Result<()> {
    out.push_str("<h2>Held-out views</h2>\n");
    if gallery.is_empty() {
        out.push_str("<p class=note>No renders in this report.</p>\n");
        return Ok(());
    }
    let stops: Vec<String> = (0..=10u8)
        .map(|i| {
            let [r, g, b] = colormap(f64::from(i) / 10.0);
            format!("rgb({r} {g} {b})")
        })
        .collect();
    let _ = write!(
        out,
        "<p class=note>Error: mean absolute difference over R, G, B of values in [0, 1].</p>\
         <div class=ramp><span>0</span><i style=\"background:linear-gradient(90deg,{})\"></i><span>≥ {ERROR_FULL_SCALE}</span></div>\n",
        stops.join(",")
    );
    for item in gallery {
        let _ = write!(
            out,
            "<div class=view><h3>{}<span>{} dB</span><span>SSIM {}</span></h3><div class=trio>",
            escape(&item.view),
            fixed(item.psnr, 2),
            fixed(item.ssim, 4)
        );
        let images = [
            ("photo", &item.photo),
            ("render", &item.render),
            ("error", &item.error),
        ];
        for (name, rgb) in images {
            let uri = data_uri(&item.view, rgb, item.width, item.height)?;
            let _ = write!(
                out,
                "<figure><img alt=\"{name}\" width=\"{}\" height=\"{}\" src=\"{uri}\"/><figcaption>{name}</figcaption></figure>",
                item.width, item.height
            );
        }
        out.push_str("</div></div>\n");
    }
    Ok(())
}

fn scores(out: &mut String, scores: Option<&FinalRecord>) {
    let Some(scores) = scores.filter(|s| !s.per_view.is_empty()) else {
        return;
    };
    let _ = write!(
        out,
        "<details><summary>Scores of all {} held-out views</summary><table>\
         <tr><th>view</th><th class=n>PSNR, dB</th><th class=n>SSIM</th></tr>",
        scores.per_view.len()
    );
    for score in &scores.per_view {
        let _ = write!(
            out,
            "<tr><td>{}</td><td class=n>{}</td><td class=n>{}</td></tr>",
            escape(&score.view),
            fixed(score.psnr, 2),
            fixed(score.ssim, 4)
        );
    }
    out.push_str("</table></details>\n");
}
