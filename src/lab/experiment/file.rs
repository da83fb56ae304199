//! The TOML file of an experiment.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use toml::{Table, Value};

use crate::base::error::{Error, Result};
use crate::config::{TrainConfig, parse_duration};
use crate::lab::compare::thresholds;

/// A dataset, and the options that its runs have in common.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// Folder name of its runs.
    pub name: String,
    /// Dataset.
    pub path: PathBuf,
    /// PSNR values that runs are timed to, dB; empty: by the rule in `compare/thresholds.rs`.
    pub thresholds: Vec<f64>,
    options: Table,
}

/// One way to train.
#[derive(Debug, Clone, PartialEq)]
pub struct Setting {
    /// Folder name of its runs.
    pub name: String,
    options: Table,
}

/// An experiment.
#[derive(Debug, Clone, PartialEq)]
pub struct Experiment {
    /// File that it was read from.
    pub file: PathBuf,
    /// Text of the file.
    pub text: String,
    /// Folder of all runs.
    pub output: PathBuf,
    /// Seconds after which no further scene of a seed is begun.
    pub budget: Option<f64>,
    /// Seeds.
    pub seeds: Vec<u64>,
    /// Place of the setting whose final number of Gaussians is the cap of the others.
    pub cap_from: Option<usize>,
    /// Scenes.
    pub scenes: Vec<Scene>,
    /// Settings; the others are compared with the first.
    pub settings: Vec<Setting>,
    train: Table,
}

/// The file as TOML.
#[derive(Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
struct Raw {
    output: Option<PathBuf>,
    budget: Option<String>,
    seeds: Vec<u64>,
    cap_from: Option<String>,
    #[serde(default)]
    train: Table,
    scene: Vec<Table>,
    setting: Vec<Table>,
}

impl Experiment {
    /// Reads a file. Paths of scenes are relative to `data`, else to the file; the output to the working folder.
    ///
    /// # Errors
    /// A file that cannot be read, or the first invalid entry, the configurations of all runs included.
    pub fn read(file: &Path, data: Option<&Path>) -> Result<Self> {
        let text = std::fs::read_to_string(file).map_err(|e| Error::io(file, e))?;
        let wrong = |what: String| Error::input(file, what, "see data/experiments for examples");
        let raw: Raw = toml::from_str(&text).map_err(|e| wrong(one_line(&e.to_string())))?;
        let base = data.or(file.parent()).unwrap_or(Path::new(""));
        let scenes = raw.scene.into_iter().map(|t| scene(t, base));
        let scenes = scenes
            .collect::<std::result::Result<Vec<_>, _>>()
            .map_err(wrong)?;
        let settings = raw.setting.into_iter().map(setting);
        let settings = settings
            .collect::<std::result::Result<Vec<_>, _>>()
            .map_err(wrong)?;
        distinct(scenes.iter().map(|s| s.name.as_str())).map_err(wrong)?;
        distinct(settings.iter().map(|s| s.name.as_str())).map_err(wrong)?;
        let seeds: Vec<String> = raw.seeds.iter().map(u64::to_string).collect();
        distinct(seeds.iter().map(String::as_str)).map_err(wrong)?;
        if raw.seeds.is_empty() || scenes.is_empty() || settings.is_empty() {
            return Err(wrong(
                "seeds, [[scene]] and [[setting]]: one of each at least".into(),
            ));
        }
        let place = |name: &String| {
            let found = settings.iter().position(|s| s.name == *name);
            found.ok_or_else(|| wrong(format!("cap-from: no setting {name:?}")))
        };
        let stem = file.file_stem().unwrap_or_default();
        let budget = raw.budget.as_deref().map(parse_duration).transpose();
        let budget = budget.map_err(|what| format!("budget: {what}"));
        let experiment = Self {
            output: raw.output.unwrap_or_else(|| PathBuf::from(stem)),
            budget: budget.map_err(wrong)?,
            seeds: raw.seeds,
            cap_from: raw.cap_from.as_ref().map(place).transpose()?,
            train: raw.train,
            file: file.to_path_buf(),
            text,
            scenes,
            settings,
        };
        for scene in &experiment.scenes {
            for setting in &experiment.settings {
                experiment.config(scene, setting, experiment.seeds[0])?;
            }
        }
        Ok(experiment)
    }

    /// The configuration of a run, without the cap of another one: `[train]`, then the scene's options, then the setting's.
    ///
    /// # Errors
    /// Unknown options or invalid values.
    pub fn config(&self, scene: &Scene, setting: &Setting, seed: u64) -> Result<TrainConfig> {
        let mut table = self.train.clone();
        merge(&mut table, &scene.options);
        merge(&mut table, &setting.options);
        let wrong = |what: String| {
            let (scene, setting) = (&scene.name, &setting.name);
            Error::input(
                &self.file,
                format!("scene {scene}, setting {setting}: {}", one_line(&what)),
                "the names are those of `mhsplat train --config`",
            )
        };
        if table.contains_key("seed") {
            return Err(wrong("seed: give seeds for the whole file".into()));
        }
        let mut config =
            TrainConfig::deserialize(Value::Table(table)).map_err(|e| wrong(e.to_string()))?;
        config.seed = seed;
        config.validate().map_err(|e| wrong(e.to_string()))?;
        Ok(config)
    }

    /// Refuses missing datasets, before any of them is trained on.
    ///
    /// # Errors
    /// The first such scene.
    pub fn check_scenes(&self) -> Result<()> {
        match self.scenes.iter().find(|s| !s.path.is_dir()) {
            None => Ok(()),
            Some(scene) => Err(Error::input(
                &scene.path,
                format!("no such folder (scene {})", scene.name),
                "scenes are looked for beside the file, or below --data DIR",
            )),
        }
    }
}

fn one_line(text: &str) -> String {
    text.trim().replace('\n', " ")
}

fn merge(into: &mut Table, from: &Table) {
    for (key, value) in from {
        match (into.get_mut(key), value) {
            (Some(Value::Table(old)), Value::Table(new)) => merge(old, new),
            _ => {
                into.insert(key.clone(), value.clone());
            }
        }
    }
}

type Parsed<T> = std::result::Result<T, String>;

fn take_text(table: &mut Table, key: &str) -> Parsed<Option<String>> {
    match table.remove(key) {
        None => Ok(None),
        Some(Value::String(text)) => Ok(Some(text)),
        Some(other) => Err(format!("{key} = {other}; text expected")),
    }
}

/// A name that can be a folder.
fn folder(name: String) -> Parsed<String> {
    let plain = |c: char| c.is_alphanumeric() || "-_.+".contains(c);
    if name.is_empty() || name.starts_with('.') || !name.chars().all(plain) {
        return Err(format!(
            "name {name:?}; letters, digits and -_.+ expected, for it names a folder"
        ));
    }
    Ok(name)
}

fn scene(mut table: Table, base: &Path) -> Parsed<Scene> {
    let path = take_text(&mut table, "path")?.ok_or("a [[scene]] without a path")?;
    let last = Path::new(&path).file_name().unwrap_or_default();
    let name = take_text(&mut table, "name")?;
    let name = folder(name.unwrap_or_else(|| last.to_string_lossy().into_owned()))?;
    let thresholds: Vec<f64> = match table.remove("thresholds") {
        None => Vec::new(),
        Some(list) => list
            .try_into()
            .map_err(|e| format!("thresholds of {name}: {e}"))?,
    };
    thresholds::check(&thresholds).map_err(|e| format!("thresholds of {name}: {e}"))?;
    Ok(Scene {
        path: base.join(path),
        name,
        thresholds,
        options: table,
    })
}

fn setting(mut table: Table) -> Parsed<Setting> {
    let name = take_text(&mut table, "name")?.ok_or("a [[setting]] without a name")?;
    Ok(Setting {
        name: folder(name)?,
        options: table,
    })
}

fn distinct<'a>(names: impl Iterator<Item = &'a str>) -> Parsed<()> {
    let mut seen = Vec::new();
    for name in names {
        if seen.contains(&name) {
            return Err(format!("{name} is there twice"));
        }
        seen.push(name);
    }
    Ok(())
}
