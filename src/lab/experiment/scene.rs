//! One scene of an experiment: its runs side by side.

use serde::Serialize;

use crate::base::error::Result;
use crate::lab::compare::{Comparison, Options, Source, compare, finals, relative, times};
use crate::lab::experiment::file::Experiment;
use crate::lab::experiment::plan::{Found, State, blocks, look};
use crate::lab::report::{Report, Section};

/// Name of a scene's page in its folder.
pub(super) const PAGE: &str = "compare.html";

/// One scene.
#[derive(Debug, Serialize)]
pub struct SceneSummary {
    /// Name.
    pub name: String,
    /// Number of runs that are missing.
    pub missing: usize,
    /// Runs that are not counted, with the reason: those of other options, say.
    pub refused: Vec<String>,
    /// The reason why its runs cannot be compared.
    pub problem: Option<String>,
    /// Its runs side by side; `None` without any.
    pub comparison: Option<Comparison>,
}

/// Runs of a scene that are done, and those that are not counted.
fn sources(e: &Experiment, scene: usize) -> Result<(Vec<Source>, Vec<String>)> {
    let (mut done, mut refused) = (Vec::new(), Vec::new());
    for run in blocks(e).iter().flatten().filter(|r| r.scene == scene) {
        let setting = &e.settings[run.setting].name;
        match look(e, run)? {
            Found::Matches(State::Done(_)) => done.push((
                run.setting,
                Source {
                    group: Some(setting.clone()),
                    path: run.dir.clone(),
                },
            )),
            Found::Matches(_) => (),
            Found::Refused(why) => {
                refused.push(format!("{setting}, seed {}: refused: {why}", run.seed));
            }
        }
    }
    // Settings in the order of the file, whichever was trained first.
    done.sort_by_key(|(setting, _)| *setting);
    Ok((done.into_iter().map(|d| d.1).collect(), refused))
}

impl SceneSummary {
    /// Compares the runs that are there. A scene that cannot be compared says why.
    pub(super) fn of(e: &Experiment, place: usize) -> Self {
        let scene = &e.scenes[place];
        let mut summary = Self {
            name: scene.name.clone(),
            missing: e.settings.len() * e.seeds.len(),
            refused: Vec::new(),
            problem: None,
            comparison: None,
        };
        let options = Options {
            thresholds: scene.thresholds.clone(),
            ..Options::default()
        };
        let compared = sources(e, place).and_then(|(sources, refused)| {
            summary.missing -= sources.len();
            summary.refused = refused;
            match sources.is_empty() {
                true => Ok(None),
                false => compare(&sources, &options).map(Some),
            }
        });
        match compared {
            Ok(found) => summary.comparison = found,
            Err(error) => summary.problem = Some(format!("not compared: {error}")),
        }
        if let Some(c) = &mut summary.comparison {
            let first = summary.refused.iter().cloned();
            c.warnings.splice(0..0, first);
            if summary.missing > 0 {
                let text = format!("{} runs of this scene are missing", summary.missing);
                c.warnings.insert(0, text);
            }
        }
        summary
    }

    /// Its part of the summary; `None` if there is nothing to say but that runs are missing.
    pub(super) fn part(&self) -> Option<Report> {
        let mut part = Report {
            title: self.name.clone(),
            warnings: self.problem.iter().cloned().collect(),
            ..Report::default()
        };
        let Some(c) = &self.comparison else {
            part.warnings.extend(self.refused.iter().cloned());
            return (!part.warnings.is_empty()).then_some(part);
        };
        part.warnings.extend(c.warnings.iter().cloned());
        let d = &c.dataset;
        part.subtitle = format!(
            "{} × {} px, {} training and {} held-out views, {}; times by {}.",
            d.width,
            d.height,
            d.train_views,
            d.test_views,
            c.device(),
            c.clock.name()
        );
        part.sections.push(Section::Table(finals(c)));
        if !c.thresholds.is_empty() {
            let tables = [times(c, c.clock), relative(c)];
            part.sections.extend(tables.map(Section::Table));
        }
        part.sections.push(Section::Link {
            text: format!("{}: curves and every run", self.name),
            to: format!("{}/{PAGE}", self.name),
        });
        Some(part)
    }
}
