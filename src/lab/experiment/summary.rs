//! The summary of an experiment: a page per scene, and all scenes as one page, as Markdown and as JSON.

use std::path::Path;

use serde::Serialize;

use crate::base::error::Result;
use crate::chart::text::{fixed, href};
use crate::lab::compare;
use crate::lab::compare::{Comparison, Counts, Options, Paired, Source};
use crate::lab::experiment::file::Experiment;
use crate::lab::experiment::plan::{State, blocks, look};
use crate::lab::folder::json;
use crate::lab::report::{Report, Section};
use crate::lab::stats::{Interval, Spread, geometric_mean};
use crate::lab::table::{Table, or_dash};
use crate::run::report::page::REPORT_FILE;

/// Name of a scene's page in its folder.
const PAGE: &str = "compare.html";

/// One scene.
#[derive(Debug, Serialize)]
pub struct SceneSummary {
    /// Name.
    pub name: String,
    /// Number of runs that are missing.
    pub missing: usize,
    /// Runs that are not counted, with reason and remedy: those of other options, say.
    pub refused: Vec<String>,
    /// The reason why its runs cannot be compared.
    pub problem: Option<String>,
    /// Its runs side by side; `None` without any.
    pub comparison: Option<Comparison>,
    /// Names of its runs and links to their reports, as far as they are there.
    #[serde(skip)]
    pub reports: Vec<(String, String)>,
}

impl SceneSummary {
    /// Compares the runs that are there, and writes their page. A scene that cannot be compared says why.
    fn write(e: &Experiment, place: usize) -> Self {
        let scene = &e.scenes[place];
        let (mut done, mut refused, mut reports) = (Vec::new(), Vec::new(), Vec::new());
        for run in blocks(e).iter().flatten().filter(|r| r.scene == place) {
            let setting = e.settings[run.setting].name.clone();
            let report = run.dir.join(REPORT_FILE);
            if let Some(to) = report
                .strip_prefix(&e.output)
                .ok()
                .filter(|_| report.exists())
            {
                let name = format!("{setting}, seed {}", run.seed);
                reports.push((run.setting, (name, href(to))));
            }
            let found = look(e, run);
            match &found {
                State::Done(_) => {
                    let (group, path) = (Some(setting), run.dir.clone());
                    done.push((run.setting, Source { group, path }));
                }
                State::Refused { .. } => {
                    let (word, why) = found.words();
                    refused.push(format!("{setting}, seed {}: {word}: {why}", run.seed));
                }
                _ => (),
            }
        }
        // Settings in the order of the file, whichever was trained first.
        done.sort_by_key(|(setting, _)| *setting);
        reports.sort_by_key(|(setting, _)| *setting);
        let sources: Vec<Source> = done.into_iter().map(|d| d.1).collect();
        let options = Options {
            thresholds: scene.thresholds.clone(),
            ..Options::default()
        };
        let mut summary = Self {
            name: scene.name.clone(),
            missing: e.settings.len() * e.seeds.len() - sources.len(),
            refused,
            problem: None,
            comparison: None,
            reports: reports.into_iter().map(|r| r.1).collect(),
        };
        if sources.is_empty() {
            return summary;
        }
        match compare::compare(&sources, &options) {
            Err(error) => summary.problem = Some(format!("not compared: {error}")),
            Ok(mut c) => {
                c.warnings.splice(0..0, summary.refused.iter().cloned());
                if summary.missing > 0 {
                    let text = format!("{} runs of this scene are missing", summary.missing);
                    c.warnings.insert(0, text);
                }
                let file = e.output.join(&scene.name).join(PAGE);
                let written = compare::report(&c).write_page(&file);
                summary.problem = written.err().map(|error| error.to_string());
                summary.comparison = Some(c);
            }
        }
        summary
    }

    /// The figures of the reference against another setting; `None` if one of the two has no run.
    fn pairs(&self, reference: &str, other: &str) -> Option<&Paired> {
        let compared = self.comparison.as_ref();
        let found = compared.filter(|c| c.reference == reference)?;
        found.relative.iter().find(|p| p.label == other)
    }

    /// Its part of the summary; `None` if there is nothing to say but that runs are missing.
    fn part(&self) -> Option<Report> {
        let alone = || Report {
            warnings: self.refused.clone(),
            ..Report::default()
        };
        let compared = self.comparison.as_ref();
        let mut part = compared.map_or_else(alone, compare::brief);
        part.title.clone_from(&self.name);
        part.warnings.splice(0..0, self.problem.clone());
        let link = compared.map(|_| Section::Link {
            text: format!("{}: curves", self.name),
            to: href(&Path::new(&self.name).join(PAGE)),
        });
        part.sections.extend(link);
        let links = self.reports.clone();
        let summary = format!("{}: reports of its runs", self.name);
        let links = (!links.is_empty()).then_some(Section::Links { summary, links });
        part.sections.extend(links);
        (!part.sections.is_empty() || !part.warnings.is_empty()).then_some(part)
    }
}

/// The first setting against one other, over all scenes.
#[derive(Debug, Serialize)]
pub struct Against {
    /// The first setting.
    pub reference: String,
    /// The other setting.
    pub setting: String,
    /// Geometric mean of the scenes' means, of medians and of the ends of their ranges; its samples are the fewest of a scene.
    pub mean: Option<Spread>,
    /// Number of scenes in that mean.
    pub mean_of: usize,
    /// Thresholds of all scenes.
    pub counts: Counts,
    /// Final PSNR of the first setting less that of the other, dB, over all scenes; `None` unless every scene has three pairs.
    pub psnr: Option<Interval>,
    /// Geometric mean over scenes of the final number of Gaussians of the other over that of the first setting.
    pub gaussians: Option<f64>,
}

impl Against {
    fn new(reference: &str, setting: &str, scenes: &[SceneSummary]) -> Self {
        let pairs = || scenes.iter().filter_map(|s| s.pairs(reference, setting));
        let means: Vec<Spread> = pairs().filter_map(|p| p.mean).collect();
        let of = |pick: fn(&Spread) -> f64| {
            let figures: Vec<f64> = means.iter().map(pick).collect();
            geometric_mean(&figures)
        };
        let mean = || {
            Some(Spread {
                median: of(|s| s.median)?,
                min: of(|s| s.min)?,
                max: of(|s| s.max)?,
                samples: means.iter().map(|s| s.samples).min()?,
            })
        };
        let mut counts = Counts::default();
        pairs().for_each(|p| counts.join(&p.counts));
        let complete = pairs().count() == scenes.len();
        let changes: Vec<&[f64]> = pairs().map(|p| &p.psnr_changes[..]).collect();
        let ratios: Option<Vec<f64>> = pairs()
            .map(|p| geometric_mean(&p.gaussians_ratios))
            .collect();
        Self {
            reference: reference.to_owned(),
            setting: setting.to_owned(),
            mean: mean(),
            mean_of: means.len(),
            counts,
            psnr: Interval::of_strata(&changes).filter(|_| complete),
            gaussians: ratios.filter(|_| complete).and_then(|r| geometric_mean(&r)),
        }
    }

    /// A row per scene, and one of all.
    fn table(&self, scenes: &[SceneSummary]) -> Table {
        let (reference, other) = (&self.reference, &self.setting);
        let rows = scenes.iter();
        let rows = rows.map(|s| (s.name.clone(), s.pairs(reference, other)));
        let title = format!("{reference} against {other}");
        let mut table = compare::against(title, "scene", reference, rows);
        let mut last = vec!["–".to_owned(); table.columns.len()];
        "geometric mean".clone_into(&mut last[0]);
        last[2] = or_dash(self.mean.as_ref(), |mean| {
            let (some, all) = (self.mean_of, scenes.len());
            format!("{}, {some} of {all} scenes", compare::ratios(mean))
        });
        if let Some(cell) = last.last_mut() {
            *cell = self.counts.text(reference, other);
        }
        table.rows.push(last);
        table
    }
}

/// A row per setting: the first one against it, over all scenes.
fn pooled(overview: &[Against], scenes: usize) -> Table {
    let reference = overview.first().map_or("", |a| a.reference.as_str());
    let signed = |v: f64| format!("{}{}", if v > 0.0 { "+" } else { "" }, fixed(v, 2));
    let row = |a: &Against| {
        vec![
            a.setting.clone(),
            or_dash(a.psnr, |p| p.samples.to_string()),
            or_dash(a.psnr, |p| signed(p.mean)),
            or_dash(a.psnr, |p| {
                format!("{} to {}", signed(p.low), signed(p.high))
            }),
            or_dash(a.gaussians, |ratio| fixed(ratio, 2)),
            or_dash(a.mean.as_ref(), |m| {
                format!("{} ({} of {scenes} scenes)", compare::ratios(m), a.mean_of)
            }),
        ]
    };
    Table::new(
        "All scenes",
        format!(
            "{reference} against each other setting, by pairs of equal seeds. Δ PSNR: final PSNR of {reference} less that of the other, \
             mean over scenes of the means of their pairs; the 95 % interval is of the scatter of seeds within these scenes, and says \
             nothing of others. Gaussians: those of the other over those of {reference}, geometric mean. Time ratio: as below."
        ),
        &[
            "setting",
            "pairs",
            "Δ PSNR, dB",
            "95 % interval",
            "Gaussians",
            "time ratio",
        ],
        overview.iter().map(row),
    )
}

/// All scenes.
#[derive(Debug, Serialize)]
pub struct Summary {
    /// Name of the experiment's file.
    pub experiment: String,
    /// Version of this package.
    pub version: &'static str,
    /// The first setting against each other one.
    pub overview: Vec<Against>,
    /// The scenes.
    pub scenes: Vec<SceneSummary>,
}

/// Writes `SCENE/compare.html`, and `summary.html`, `summary.md` and `summary.json`, from the runs that are there. A scene that
/// cannot be compared says why, and the others go on.
///
/// # Errors
/// Files that cannot be written.
pub fn write(e: &Experiment) -> Result<Summary> {
    let scenes = (0..e.scenes.len()).map(|s| SceneSummary::write(e, s));
    let scenes: Vec<SceneSummary> = scenes.collect();
    let reference = &e.settings[0].name;
    let others = e.settings.iter().skip(1);
    let file = e.file.file_name().unwrap_or_default();
    let summary = Summary {
        experiment: file.to_string_lossy().into_owned(),
        version: env!("CARGO_PKG_VERSION"),
        overview: others
            .map(|s| Against::new(reference, &s.name, &scenes))
            .collect(),
        scenes,
    };
    let report = summary.report();
    let files = [
        ("summary.html", report.to_html()),
        ("summary.md", report.to_markdown()),
        ("summary.json", json("summary.json", &summary)? + "\n"),
    ];
    for (name, text) in files {
        crate::base::files::write_bytes(&e.output.join(name), text.as_bytes())?;
    }
    Ok(summary)
}

impl Summary {
    /// The summary as a report.
    #[must_use]
    pub fn report(&self) -> Report {
        let some = self.scenes.iter().filter(|s| s.missing > 0);
        let missing = some.map(|s| format!("{}: {} runs are missing", s.name, s.missing));
        let compared = self.scenes.iter().any(|s| s.comparison.is_some());
        let against = self.overview.iter().filter(|_| compared);
        let against = against.map(|a| Section::Table(a.table(&self.scenes)));
        let all = (compared && !self.overview.is_empty())
            .then(|| pooled(&self.overview, self.scenes.len()));
        let overview = all.map(Section::Table).into_iter().chain(against);
        let scenes = self.scenes.iter().filter_map(SceneSummary::part);
        Report {
            title: self.experiment.clone(),
            subtitle: format!("{} scenes · mhsplat {}", self.scenes.len(), self.version),
            warnings: missing.collect(),
            sections: overview.chain(scenes.map(Section::Part)).collect(),
            ..Report::default()
        }
    }
}
