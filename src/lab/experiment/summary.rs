//! What came of an experiment: a page per scene, and all scenes as one page, as Markdown and as JSON.

use std::fmt::Write;

use serde::Serialize;

use crate::base::error::{Error, Result};
use crate::chart::text::escape;
use crate::lab::compare;
use crate::lab::compare::Paired;
use crate::lab::compare::Source;
use crate::lab::compare::{Comparison, Options};
use crate::lab::experiment::file::Experiment;
use crate::lab::experiment::overview;
use crate::lab::experiment::overview::Overview;
use crate::lab::experiment::plan::{Found, State, blocks, look};
use crate::lab::table::{Table, write_html, write_markdown};
use crate::run::report::page;

/// Name of a scene's page in its folder.
const PAGE: &str = "compare.html";

/// One scene.
#[derive(Debug, Serialize)]
pub struct SceneSummary {
    /// Its name.
    pub name: String,
    /// Runs that are missing.
    pub missing: usize,
    /// Runs that are not counted, and why: those of other options, say.
    pub refused: Vec<String>,
    /// Why its runs cannot be compared.
    pub problem: Option<String>,
    /// Its runs side by side; none without any.
    pub comparison: Option<Comparison>,
    /// The other settings against the first, seed by seed: told by the overview.
    #[serde(skip)]
    pub(super) paired: Vec<Paired>,
}

impl SceneSummary {
    /// One setting against the reference.
    pub(super) fn against(&self, reference: &str, other: &str) -> Option<&Paired> {
        let c = self.comparison.as_ref()?;
        let own = self.paired.iter().find(|p| p.label == other);
        own.filter(|_| c.reference == reference)
    }
}

/// All scenes.
#[derive(Debug, Serialize)]
pub struct Summary {
    /// Name of the experiment's file.
    pub experiment: String,
    /// Version of this package.
    pub version: &'static str,
    /// The first setting against the others; none without others.
    pub overview: Option<Overview>,
    /// The scenes.
    pub scenes: Vec<SceneSummary>,
}

/// Runs of a scene that are done, and those that are not counted.
fn sources(e: &Experiment, scene: usize) -> Result<(Vec<Source>, Vec<String>)> {
    let (mut done, mut refused) = (Vec::new(), Vec::new());
    for run in blocks(e).iter().flatten().filter(|r| r.scene == scene) {
        let setting = &e.settings[run.setting].name;
        match look(e, run)? {
            Found::Its(State::Done(_)) => done.push((
                run.setting,
                Source {
                    group: Some(setting.clone()),
                    path: run.dir.clone(),
                },
            )),
            Found::Its(_) => (),
            Found::Refused(why) => {
                refused.push(format!("{setting}, seed {}: refused: {why}", run.seed));
            }
        }
    }
    // Settings in the order of the file, whichever was trained first.
    done.sort_by_key(|(setting, _)| *setting);
    Ok((done.into_iter().map(|d| d.1).collect(), refused))
}

fn of_scene(e: &Experiment, place: usize) -> SceneSummary {
    let scene = &e.scenes[place];
    let mut summary = SceneSummary {
        name: scene.name.clone(),
        missing: e.settings.len() * e.seeds.len(),
        refused: Vec::new(),
        problem: None,
        comparison: None,
        paired: Vec::new(),
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
            false => compare::compare(&sources, &options).map(Some),
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
        summary.paired = compare::paired(c);
    }
    summary
}

/// Writes `SCENE/compare.html`, and `summary.html`, `summary.md` and `summary.json`, from the runs that are there. A scene that
/// cannot be compared says why, and the others go on.
///
/// # Errors
/// Files that cannot be written.
pub fn write(e: &Experiment) -> Result<Summary> {
    let mut scenes: Vec<SceneSummary> = (0..e.scenes.len()).map(|s| of_scene(e, s)).collect();
    for scene in &mut scenes {
        if let Some(c) = &scene.comparison {
            let file = e.output.join(&scene.name).join(PAGE);
            if let Err(error) = crate::lab::page::write_page(&file, &compare::page(c)) {
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
        crate::base::files::write_bytes(&e.output.join(name), text.as_bytes())?;
    }
    Ok(summary)
}

/// Size, views and device of a scene.
fn about(c: &Comparison) -> String {
    let d = &c.dataset;
    format!(
        "{} × {} px, {} training and {} held-out views, {}; times by {}.",
        d.width,
        d.height,
        d.train_views,
        d.test_views,
        c.device(),
        c.clock.name()
    )
}

impl SceneSummary {
    /// What every setting ends with, when it reaches each PSNR, and that over the time of the first.
    fn tables(&self, c: &Comparison) -> Vec<Table> {
        let mut finals = compare::finals(c);
        "setting".clone_into(&mut finals.columns[0]);
        finals.title.clone_from(&self.name);
        finals.note = format!("{} {}", about(c), finals.note);
        let mut all = vec![finals];
        if !c.thresholds.is_empty() {
            all.push(compare::times(c, c.clock));
            all.push(overview::ratios(self, c));
        }
        all.retain(|t| !t.rows.is_empty());
        all
    }

    /// What the reader has to know of it.
    fn remarks(&self) -> Vec<String> {
        let mut all: Vec<String> = self.problem.iter().cloned().collect();
        match &self.comparison {
            Some(c) => all.extend(c.warnings.iter().cloned()),
            None => all.extend(self.refused.iter().cloned()),
        }
        all
    }

    /// Whether there is anything to tell but that runs are missing.
    fn told(&self) -> bool {
        self.comparison.is_some() || !self.remarks().is_empty()
    }
}

impl Summary {
    fn missing(&self) -> Vec<String> {
        let some = self.scenes.iter().filter(|s| s.missing > 0);
        some.map(|s| format!("{}: {} runs are missing", s.name, s.missing))
            .collect()
    }

    fn overview_tables(&self) -> Vec<Table> {
        let compared = self.scenes.iter().any(|s| s.comparison.is_some());
        let overview = self.overview.as_ref().filter(|_| compared);
        overview.map_or_else(Vec::new, Overview::tables)
    }

    /// As Markdown.
    #[must_use]
    pub fn markdown(&self) -> String {
        let mut out = format!("# {}\n\nmhsplat {}\n", self.experiment, self.version);
        for line in self.missing() {
            let _ = write!(out, "\n> {line}\n");
        }
        for table in self.overview_tables() {
            write_markdown(&mut out, &table, "##");
        }
        for scene in self.scenes.iter().filter(|s| s.told()) {
            let tables = scene.comparison.as_ref().map(|c| scene.tables(c));
            let mut tables = tables.unwrap_or_default().into_iter();
            match tables.next() {
                Some(finals) => write_markdown(&mut out, &finals, "##"),
                None => {
                    let _ = write!(out, "\n## {}\n", scene.name);
                }
            }
            for line in scene.remarks() {
                let _ = write!(out, "\n> {}\n", line.replace('\n', " "));
            }
            tables.for_each(|table| write_markdown(&mut out, &table, "###"));
        }
        out
    }

    /// As a page.
    #[must_use]
    pub fn page(&self) -> String {
        let mut body = format!(
            "{}\n<h1>{}</h1><p class=sub>{} scenes · mhsplat {}</p>\n",
            crate::lab::page::GENERATOR,
            escape(&self.experiment),
            self.scenes.len(),
            self.version
        );
        compare::warnings(&mut body, &self.missing());
        for table in self.overview_tables() {
            write_html(&mut body, &table, "h2");
        }
        for scene in self.scenes.iter().filter(|s| s.told()) {
            scene.html(&mut body);
        }
        page::page(&format!("{} · mhsplat", self.experiment), &body)
    }
}

impl SceneSummary {
    fn html(&self, body: &mut String) {
        let name = escape(&self.name);
        let tables = self.comparison.as_ref().map(|c| self.tables(c));
        let mut tables = tables.unwrap_or_default().into_iter();
        match tables.next() {
            Some(finals) => write_html(body, &finals, "h2"),
            None => {
                let _ = write!(body, "<h2>{name}</h2>");
            }
        }
        compare::warnings(body, &self.remarks());
        tables.for_each(|table| write_html(body, &table, "h3"));
        if self.comparison.is_some() {
            let _ = writeln!(
                body,
                "<p><a href=\"{name}/{PAGE}\">{name}: curves and every run</a></p>"
            );
        }
    }
}
