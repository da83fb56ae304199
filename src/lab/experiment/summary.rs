//! The summary of an experiment: a page per scene, and all scenes as one page, as Markdown and as JSON.

use serde::Serialize;

use crate::base::error::Result;
use crate::lab::compare;
use crate::lab::experiment::file::Experiment;
use crate::lab::experiment::overview::Overview;
use crate::lab::experiment::scene::{PAGE, SceneSummary};
use crate::lab::folder::json;
use crate::lab::report::{Report, Section};

/// All scenes.
#[derive(Debug, Serialize)]
pub struct Summary {
    /// Name of the experiment's file.
    pub experiment: String,
    /// Version of this package.
    pub version: &'static str,
    /// The first setting against the others; `None` without others.
    pub overview: Option<Overview>,
    /// The scenes.
    pub scenes: Vec<SceneSummary>,
}

/// Writes `SCENE/compare.html`, and `summary.html`, `summary.md` and `summary.json`, from the runs that are there. A scene that
/// cannot be compared says why, and the others go on.
///
/// # Errors
/// Files that cannot be written.
pub fn write(e: &Experiment) -> Result<Summary> {
    let scenes = (0..e.scenes.len()).map(|s| SceneSummary::of(e, s));
    let mut scenes: Vec<SceneSummary> = scenes.collect();
    for scene in &mut scenes {
        if let Some(c) = &scene.comparison {
            let file = e.output.join(&scene.name).join(PAGE);
            if let Err(error) = compare::report(c).write_page(&file) {
                scene.problem = Some(error.to_string());
            }
        }
    }
    let file = e.file.file_name().unwrap_or_default();
    let summary = Summary {
        experiment: file.to_string_lossy().into_owned(),
        version: env!("CARGO_PKG_VERSION"),
        overview: Overview::of(e, &scenes),
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
        let overview = self.overview.iter().filter(|_| compared);
        let overview = overview.flat_map(Overview::tables).map(Section::Table);
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
