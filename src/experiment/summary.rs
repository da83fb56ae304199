//! What came of an experiment: a page per scene, and all scenes as one page, as Markdown and as JSON.

use std::fmt::Write;

use serde::Serialize;

use super::file::Experiment;
use super::plan::{State, folder, state};
use crate::compare::{self, Comparison, Options, Source};
use crate::error::{Error, Result};
use crate::report::figures::{Table, write_html, write_markdown};
use crate::report::html::{self, escape, fixed};
use crate::report::spread::Ratio;

/// Name of a scene's page in its folder.
const PAGE: &str = "compare.html";

/// One scene.
#[derive(Debug, Serialize)]
pub struct SceneSummary {
    /// Its name.
    pub name: String,
    /// Runs that are missing.
    pub missing: usize,
    /// Its runs side by side; none without any.
    pub comparison: Option<Comparison>,
}

/// All scenes.
#[derive(Debug, Serialize)]
pub struct Summary {
    /// Name of the experiment's file.
    pub experiment: String,
    /// Version of this package.
    pub version: &'static str,
    /// The scenes.
    pub scenes: Vec<SceneSummary>,
}

/// Runs to compare: of the seeds that all settings have, if there is one; else all that there are.
fn sources(e: &Experiment, scene: usize) -> Result<(Vec<Source>, usize, usize)> {
    let mut done = Vec::new();
    for setting in 0..e.settings.len() {
        for seed in &e.seeds {
            let dir = folder(e, scene, setting, *seed);
            if matches!(state(&dir, None)?, State::Done(_)) {
                done.push((setting, *seed, dir));
            }
        }
    }
    let all = e.settings.len() * e.seeds.len();
    let missing = all - done.len();
    let whole = |seed: u64| done.iter().filter(|d| d.1 == seed).count() == e.settings.len();
    let some = e.seeds.iter().any(|s| whole(*s));
    let kept = done.iter().filter(|d| !some || whole(d.1));
    let sources: Vec<Source> = kept
        .map(|(setting, _, dir)| Source {
            group: Some(e.settings[*setting].name.clone()),
            path: dir.clone(),
        })
        .collect();
    let aside = done.len() - sources.len();
    Ok((sources, missing, aside))
}

fn of_scene(e: &Experiment, place: usize) -> Result<SceneSummary> {
    let scene = &e.scenes[place];
    let (sources, missing, aside) = sources(e, place)?;
    let options = Options {
        thresholds: scene.thresholds.clone(),
        ..Options::default()
    };
    let mut comparison = match sources.is_empty() {
        true => None,
        false => Some(compare::compare(&sources, &options)?),
    };
    if let Some(c) = &mut comparison {
        if missing > 0 {
            c.warnings
                .insert(0, format!("{missing} runs of this scene are missing"));
        }
        if aside > 0 {
            c.warnings.insert(
                0,
                format!("{aside} runs of seeds that not all settings have are left out"),
            );
        }
    }
    Ok(SceneSummary {
        name: scene.name.clone(),
        missing,
        comparison,
    })
}

/// Writes `SCENE/compare.html`, and `summary.html`, `summary.md` and `summary.json`, from the runs that are there.
///
/// # Errors
/// Runs that cannot be read or compared, or files that cannot be written.
pub fn write(e: &Experiment) -> Result<Summary> {
    let scenes = (0..e.scenes.len()).map(|s| of_scene(e, s));
    let summary = Summary {
        experiment: e
            .file
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned(),
        version: env!("CARGO_PKG_VERSION"),
        scenes: scenes.collect::<Result<_>>()?,
    };
    for scene in &summary.scenes {
        if let Some(c) = &scene.comparison {
            let file = e.output.join(&scene.name).join(PAGE);
            compare::write_page(&file, &compare::page(c))?;
        }
    }
    let json = serde_json::to_string_pretty(&summary).map_err(|e| Error::Numerics {
        stage: "summary.json".into(),
        what: e.to_string(),
    })?;
    let files = [
        ("summary.html", summary.page()),
        ("summary.md", summary.markdown()),
        ("summary.json", json + "\n"),
    ];
    for (name, text) in files {
        crate::atomic::write_bytes(&e.output.join(name), text.as_bytes())?;
    }
    Ok(summary)
}

/// `1.21 (1.10–1.30)`.
fn ratio(r: &Ratio) -> String {
    let [median, low, high] = [r.median, r.low, r.high].map(|v| fixed(v, 2));
    format!("{median} ({low}–{high})")
}

impl Summary {
    fn compared(&self) -> impl Iterator<Item = (&SceneSummary, &Comparison)> {
        self.scenes
            .iter()
            .filter_map(|s| Some((s, s.comparison.as_ref()?)))
    }

    /// The scene as one table: what every setting ends with, and when it reaches each PSNR.
    fn table(scene: &SceneSummary, c: &Comparison) -> Table {
        let mut table = compare::finals(c);
        let times = compare::times(c, c.clock);
        let heads = times.columns.iter().skip(1).map(|t| format!("to {t}"));
        table.columns[0] = "setting".into();
        table.columns.extend(heads);
        for (row, more) in table.rows.iter_mut().zip(times.rows) {
            row.extend(more.into_iter().skip(1));
        }
        let d = &c.dataset;
        table.title.clone_from(&scene.name);
        table.note = format!(
            "{} × {} px, {} training and {} held-out views, {}. Median (min–max) over the runs; columns \"to\" are {} to that \
             PSNR.",
            d.width,
            d.height,
            d.train_views,
            d.test_views,
            c.device(),
            c.clock.name()
        );
        table
    }

    /// Scene by scene, the other settings against the first: how much later, and how much better in the end.
    fn overview(&self) -> Option<Table> {
        let (_, first) = self.compared().next()?;
        let reference = first.reference.clone();
        let mut others: Vec<String> = Vec::new();
        for (_, c) in self.compared() {
            let new = c.relative.iter().map(|r| r.label.clone());
            others.extend(new.filter(|l| *l != reference).collect::<Vec<_>>());
        }
        others.sort();
        others.dedup();
        let mut columns = vec!["scene".to_owned()];
        for other in &others {
            columns.push(format!("{other}: time"));
            columns.push(format!("{other}: PSNR, dB"));
        }
        let mut rows: Vec<Vec<String>> = Vec::new();
        let mut means: Vec<Vec<Ratio>> = vec![Vec::new(); others.len()];
        for (scene, c) in self.compared().filter(|(_, c)| c.reference == reference) {
            let mut row = vec![scene.name.clone()];
            for (other, means) in others.iter().zip(&mut means) {
                let found = c.relative.iter().find(|r| r.label == *other);
                let mean = found.and_then(|r| Some((r.mean.as_ref()?, r)));
                row.push(mean.map_or_else(
                    || "–".into(),
                    |(m, r)| format!("{}, {} of {}", ratio(m), r.mean_of, r.to_psnr.len()),
                ));
                means.extend(mean.map(|(m, _)| *m));
                let end = |label: &str| {
                    let group = c.groups.iter().find(|g| g.label == label);
                    group.and_then(|g| Some(g.psnr?.median))
                };
                let gain = end(other).zip(end(&reference)).map(|(a, b)| a - b);
                row.push(fixed(gain.unwrap_or(f64::NAN), 2));
            }
            rows.push(row);
        }
        let mut last = vec!["geometric mean".to_owned()];
        for means in &means {
            let mean = compare::geometric_mean(means);
            let of = means.len();
            last.push(mean.as_ref().map_or_else(
                || "–".into(),
                |m| format!("{}, {of} of {} scenes", ratio(m), self.scenes.len()),
            ));
            last.push(String::new());
        }
        rows.push(last);
        (!others.is_empty()).then(|| Table {
            title: format!("Against {reference}"),
            note: format!(
                "Time to equal PSNR over that of {reference}, geometric mean over the values that both reach in all runs (how \
                 many of them), only of three seeds and more: above 1, {reference} is sooner. Final PSNR less that of \
                 {reference}, medians."
            ),
            columns,
            rows,
        })
    }

    fn missing(&self) -> Vec<String> {
        let some = self.scenes.iter().filter(|s| s.missing > 0);
        some.map(|s| format!("{}: {} runs are missing", s.name, s.missing))
            .collect()
    }

    /// As Markdown.
    #[must_use]
    pub fn markdown(&self) -> String {
        let mut out = format!("# {}\n\nmhsplat {}\n", self.experiment, self.version);
        for line in self.missing() {
            let _ = write!(out, "\n> {line}\n");
        }
        for (scene, c) in self.compared() {
            write_markdown(&mut out, &Self::table(scene, c), "##");
        }
        if let Some(table) = self.overview() {
            write_markdown(&mut out, &table, "##");
        }
        out
    }

    /// As a page.
    #[must_use]
    pub fn page(&self) -> String {
        let mut body = format!(
            "{}\n<h1>{}</h1><p class=sub>{} scenes · mhsplat {}</p>\n",
            compare::GENERATOR,
            escape(&self.experiment),
            self.scenes.len(),
            self.version
        );
        compare::warnings(&mut body, &self.missing());
        if let Some(table) = self.overview() {
            write_html(&mut body, &table, "h2");
        }
        for (scene, c) in self.compared() {
            let whole = Self::table(scene, c);
            let finals = Table {
                title: scene.name.clone(),
                note: whole.note,
                ..compare::finals(c)
            };
            write_html(&mut body, &finals, "h2");
            if !c.thresholds.is_empty() {
                write_html(&mut body, &compare::times(c, c.clock), "h3");
            }
            let name = escape(&scene.name);
            let _ = writeln!(
                body,
                "<p><a href=\"{name}/{PAGE}\">{name}: curves and every run</a></p>"
            );
        }
        html::page(&format!("{} · mhsplat", self.experiment), &body)
    }
}
