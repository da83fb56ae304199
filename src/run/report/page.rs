//! `report.html`: one self-contained page about a run, for a phone as well as for a desk.
//!
//! Style, charts and images are all inside; the page's own content policy forbids it to load anything. Every string that
//! comes from the run (file names, device names) is escaped.

use std::fmt::Write;
use std::path::Path;

use crate::base::error::Result;
use crate::base::files::between;
use crate::chart::text::{escape, fixed, grouped, href, span};
use crate::config::Init;
use crate::run::record::{FinalRecord, Item, PlanRecord, RunRecord, TrainingScores};
use crate::run::report::gallery::{ERROR_FULL_SCALE, GalleryItem, colormap, data_uri};
use crate::run::report::{advice, map, panels, settings};
use crate::run::table::{DensityRow, MetricsRow};
use crate::run::viewer::{SCENE_PAGE, SceneView, photo_uri};

/// Name of the page in the run folder.
pub const REPORT_FILE: &str = "report.html";

/// Writes `report.html` into `run_dir`, replacing it as a whole. Any slice may be empty.
///
/// # Errors
/// [`crate::base::error::Error::Numerics`] when a gallery image does not match its size, [`crate::base::error::Error::Io`] when
/// writing fails.
pub fn write_report(
    run_dir: &Path,
    record: &RunRecord,
    rows: &[MetricsRow],
    density: &[DensityRow],
    gallery: &[GalleryItem],
    cameras: &[SceneView],
) -> Result<()> {
    let mut body = String::new();
    headlines(&mut body, record, rows);
    if run_dir.join(SCENE_PAGE).exists() {
        let _ = writeln!(
            body,
            "<p><a href=\"{SCENE_PAGE}\">Move about in the scene</a></p>"
        );
    }
    origin(&mut body, record, run_dir);
    let of = |training: bool| gallery.iter().filter(move |item| item.training == training);
    views(&mut body, record, of(false).collect())?;
    scores(&mut body, record.final_scores.as_ref());
    training(&mut body, record.training.as_ref(), of(true).collect())?;
    map::section(&mut body, cameras);
    if record.ended() {
        advice::section(&mut body, record, rows);
    }
    panels::quality(&mut body, rows, density);
    panels::stages(&mut body, record);
    plan(&mut body, &record.plan);
    body.push_str("<details><summary>Density control, step by step</summary>\n");
    panels::density_control(&mut body, record.config.sampler, density);
    panels::funnel(&mut body, &record.funnel);
    body.push_str("</details>\n");
    settings::section(&mut body, record, run_dir);
    let title = format!("{} · mhsplat", folder_name(&record.dataset.path));
    crate::base::files::write_bytes(&run_dir.join(REPORT_FILE), page(&title, &body).as_bytes())
}

/// The script of pages: a cursor and zoom for charts, enlarged pictures.
const SCRIPT: &str = include_str!("page.js");

/// SHA-256 of [`SCRIPT`] in base64, by which a page's content policy lets this one script run and no other. Test: report.
const SCRIPT_HASH: &str = "yXsGs2C8tiM5sJQZfDNNyLMdf8YDvv9pkk2BOfqX+bo=";

/// A complete page of the report's style around `body` (HTML). It can be read without its script.
#[must_use]
pub fn page(title: &str, body: &str) -> String {
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"/>\
         <meta name=\"viewport\" content=\"width=device-width,initial-scale=1\"/>\
         <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none';style-src 'unsafe-inline';img-src data:;\
         script-src 'sha256-{SCRIPT_HASH}'\"/>\
         <title>{}</title><style>\n{}</style></head><body>\n{body}<script>{SCRIPT}</script></body></html>\n",
        escape(title),
        include_str!("report.css")
    )
}

/// The last part of a path, for titles.
pub(crate) fn folder_name(path: &str) -> &str {
    let name = path.trim_end_matches(['/', '\\']);
    let name = name.rsplit(['/', '\\']).next().unwrap_or(name);
    if name.is_empty() { "run" } else { name }
}

/// A [`span`] with its units set small.
fn small_units(span: &str) -> String {
    let words = span.split(' ').enumerate().map(|(index, word)| {
        if index % 2 == 1 {
            format!("<small>{word}</small>")
        } else {
            word.to_owned()
        }
    });
    words.collect::<Vec<_>>().join(" ")
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
        grouped(record.config.last_iterations().into()),
        escape(&record.version)
    );
    let scored = rows.last().map(|row| row.iteration);
    if let Some(scored) = scored.filter(|n| *n < record.iterations) {
        let n = grouped(scored.into());
        let _ = writeln!(
            out,
            "<p class=note>Scores of held-out views are those after {n} iterations.</p>"
        );
    }
    let cpu = match record.cpu_seconds {
        s if s > 0.0 => small_units(&span(s)),
        _ => "<small>not measured</small>".to_owned(),
    };
    let memory = match record.peak_rss_bytes {
        0 => "<small>not measured</small>".to_owned(),
        bytes => format!(
            "{:.2} <small>GiB</small>",
            bytes as f64 / f64::from(1 << 30)
        ),
    };
    let mut heads = score_heads(record.final_scores.as_ref(), rows);
    if let Some(training) = &record.training {
        let value = format!("{} <small>dB</small>", fixed(training.psnr, 2));
        heads.push(("PSNR, training views", value));
    }
    heads.extend([
        ("Gaussians", grouped(record.gaussians)),
        ("Training time", small_units(&span(record.train_seconds))),
        ("CPU time", cpu),
        ("Peak memory", memory),
    ]);
    out.push_str("<dl class=heads>");
    for (name, value) in heads {
        let _ = write!(out, "<div><dt>{name}</dt><dd>{value}</dd></div>");
    }
    let _ = writeln!(
        out,
        "<div class=wide><dt>Device</dt><dd>{}</dd></div></dl>",
        escape(&record.device.name)
    );
}

/// The last scores of the held-out views, colour-corrected ones included if there are any.
fn score_heads(scores: Option<&FinalRecord>, rows: &[MetricsRow]) -> Vec<(&'static str, String)> {
    let decibels = |v: f64| format!("{} <small>dB</small>", fixed(v, 2));
    let last = scores.map(|f| (f.mean.psnr, f.mean.ssim));
    let last = last.or_else(|| rows.iter().rev().find_map(|r| r.psnr.zip(r.ssim)));
    let flip = scores.and_then(|f| f.mean.flip);
    let dash = || "–".to_owned();
    let mut heads = vec![
        ("PSNR, held-out", last.map_or_else(dash, |l| decibels(l.0))),
        ("SSIM, held-out", last.map_or_else(dash, |l| fixed(l.1, 4))),
        ("FLIP, held-out", flip.map_or_else(dash, |v| fixed(v, 4))),
    ];
    if let Some((psnr, ssim)) = scores.and_then(|f| f.mean.cc_psnr.zip(f.mean.cc_ssim)) {
        heads.push(("PSNR, colour-corrected", decibels(psnr)));
        heads.push(("SSIM, colour-corrected", fixed(ssim, 4)));
    }
    heads
}

fn plan(out: &mut String, plan: &PlanRecord) {
    fn rows(items: &[Item]) -> impl Iterator<Item = (&str, &str)> {
        items.iter().map(|i| (&*i.what, &*i.why))
    }
    out.push_str("<h2>Left out, and why</h2>\n");
    if plan.left_out.is_empty() {
        out.push_str("<p class=note>Nothing.</p>");
    } else {
        settings::table(out, rows(&plan.left_out));
    }
    if !plan.kept.is_empty() {
        let count = plan.kept.len();
        let _ = write!(out, "<details><summary>Kept ({count})</summary>");
        settings::table(out, rows(&plan.kept));
        out.push_str("</details>");
    }
    out.push('\n');
}

/// Says which scene file the run began with, and leads to the report of the run that the file is of, if its path is relative and leads
/// there from the present folder.
fn origin(out: &mut String, record: &RunRecord, run_dir: &Path) {
    let Init::File(file) = &record.config.init else {
        return;
    };
    let name = escape(&file.display().to_string());
    let report = file.parent().map(|dir| dir.join(REPORT_FILE));
    let to = report.filter(|_| file.is_relative());
    let to = to.and_then(|report| between(run_dir, &report));
    let name = match to {
        Some(to) => format!("<a href=\"{}\">{name}</a>", href(&to)),
        None => name,
    };
    let _ = writeln!(out, "<p>Began with the Gaussians of {name}</p>");
}

fn views(out: &mut String, record: &RunRecord, gallery: Vec<&GalleryItem>) -> Result<()> {
    out.push_str("<h2>Held-out views</h2>\n");
    if gallery.is_empty() {
        out.push_str(match record.ended() || record.final_scores.is_none() {
            true => "<p class=note>No renders in this report.</p>\n",
            false => {
                "<p class=note>Pictures come at the end of the run, or where it is stopped.</p>\n"
            }
        });
        return Ok(());
    }
    let stops: Vec<String> = (0..=10u8)
        .map(|i| {
            let [r, g, b] = colormap(f64::from(i) / 10.0);
            format!("rgb({r} {g} {b})")
        })
        .collect();
    let _ = writeln!(
        out,
        "<p class=note>Error: mean absolute difference over R, G, B of values in [0, 1].</p>\
         <div class=ramp><span>0</span><i style=\"background:linear-gradient(90deg,{})\"></i><span>≥ {ERROR_FULL_SCALE}</span></div>",
        stops.join(",")
    );
    trios(out, gallery, data_uri)
}

/// Pictures of the worst training views; JPEG files, a tenth of PNG files in size.
fn training(
    out: &mut String,
    scores: Option<&TrainingScores>,
    gallery: Vec<&GalleryItem>,
) -> Result<()> {
    if gallery.is_empty() {
        return Ok(());
    }
    let scored = scores.map_or(gallery.len(), |s| s.views);
    let _ = writeln!(
        out,
        "<h2>Training views</h2><p class=note>The worst of {scored} that were scored: what is wrong with these was not learnt.</p>"
    );
    trios(out, gallery, photo_uri)
}

/// A function that makes a data URI of an image: its name, its bytes, its width and height.
type ToUri = fn(&str, &[u8], u32, u32) -> Result<String>;

/// Photo, render and error of views, the worst first: what is wrong with a scene shows there.
fn trios(out: &mut String, mut gallery: Vec<&GalleryItem>, to_uri: ToUri) -> Result<()> {
    gallery.sort_by(|a, b| a.psnr.total_cmp(&b.psnr));
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
            let uri = to_uri(&item.view, rgb, item.width, item.height)?;
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
    // In the order of `Scores::named`.
    let columns = [
        ("PSNR, dB", 2),
        ("SSIM", 4),
        ("FLIP", 4),
        ("PSNR, colour-corrected, dB", 2),
        ("SSIM, colour-corrected", 4),
    ];
    let corrected = scores.per_view.iter().any(|s| s.scores.cc_psnr.is_some());
    let (columns, note) = match corrected {
        true => (
            &columns[..],
            "<p class=note>Colour-corrected: after the affine fit of the render's colours to the photo's; a held-out view has no \
             exposure of its own.</p>",
        ),
        false => (&columns[..3], ""),
    };
    let count = scores.per_view.len();
    let _ = write!(
        out,
        "<details><summary>Scores of all {count} held-out views</summary>{note}<table><tr><th>view</th>"
    );
    for (title, _) in columns {
        let _ = write!(out, "<th class=n>{title}</th>");
    }
    out.push_str("</tr>");
    for score in &scores.per_view {
        let _ = write!(out, "<tr><td>{}</td>", escape(&score.view));
        for ((_, decimals), (_, value)) in columns.iter().zip(score.scores.named()) {
            let figure = fixed(value.unwrap_or(f64::NAN), *decimals);
            let _ = write!(out, "<td class=n>{figure}</td>");
        }
        out.push_str("</tr>");
    }
    out.push_str("</table></details>\n");
}
