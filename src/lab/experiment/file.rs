//! The TOML file of an experiment.

use std::path::{Path, PathBuf};

use serde::de::Error as _;
use serde::{Deserialize, Deserializer};
use toml::{Table, Value};

use crate::base::error::{Error, Result};
use crate::capture::is_archive;
use crate::config::{TrainConfig, deserialize, parse_duration};
use crate::lab::compare::thresholds;
use crate::lab::experiment::shard::Shard;

/// A dataset, and the options that its runs have in common.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default)]
pub struct Scene {
    /// Folder name of its runs; in the file, that of the dataset unless given.
    pub name: String,
    /// Dataset.
    pub path: PathBuf,
    /// PSNR values that runs are timed to, dB; empty: by the rule in `compare/thresholds.rs`.
    pub thresholds: Vec<f64>,
    #[serde(flatten)]
    options: Table,
}

/// One way to train.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Setting {
    /// Folder name of its runs.
    pub name: String,
    #[serde(flatten)]
    options: Table,
}

/// An experiment.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Experiment {
    /// File that it was read from.
    #[serde(skip)]
    pub file: PathBuf,
    /// Text of the file.
    #[serde(skip)]
    pub text: String,
    /// Folder of all runs; in the file, its own name unless given.
    #[serde(default)]
    pub output: PathBuf,
    /// Seconds after which no further scene of a seed is begun.
    #[serde(default, deserialize_with = "duration")]
    pub budget: Option<f64>,
    /// The part of the runs that this session trains; `None` for all.
    #[serde(skip)]
    pub shard: Option<Shard>,
    /// Seeds.
    pub seeds: Vec<u64>,
    /// Setting whose final number of Gaussians is the cap of the others.
    pub cap_from: Option<String>,
    #[serde(default)]
    train: Table,
    /// Scenes.
    #[serde(rename = "scene")]
    pub scenes: Vec<Scene>,
    /// Settings; the others are compared with the first.
    #[serde(rename = "setting")]
    pub settings: Vec<Setting>,
}

fn duration<'de, D: Deserializer<'de>>(d: D) -> std::result::Result<Option<f64>, D::Error> {
    let text = Option::<String>::deserialize(d)?;
    let seconds = text.as_deref().map(parse_duration).transpose();
    seconds.map_err(|what| D::Error::custom(format!("budget: {what}")))
}

impl Experiment {
    /// Reads a file. Paths of scenes are relative to `data`, else to the file; the output to the working folder.
    ///
    /// # Errors
    /// A file that cannot be read, or the first invalid entry, the configurations of all runs included.
    pub fn read(file: &Path, data: Option<&Path>) -> Result<Self> {
        let text = std::fs::read_to_string(file).map_err(|e| Error::io(file, e))?;
        let wrong =
            |what: String| Error::input(file, one_line(&what), "see data/experiments for examples");
        let mut e: Self = toml::from_str(&text).map_err(|e| wrong(e.to_string()))?;
        e.file = file.to_path_buf();
        e.text = text;
        if e.output.as_os_str().is_empty() {
            e.output = file.file_stem().unwrap_or_default().into();
        }
        let base = data.or(file.parent()).unwrap_or(Path::new(""));
        e.complete(base).map_err(wrong)?;
        for scene in &e.scenes {
            for setting in &e.settings {
                e.config(scene, setting, e.seeds[0])?;
            }
        }
        Ok(e)
    }

    /// Checks the entries, and places the scenes below `base`.
    fn complete(&mut self, base: &Path) -> Parsed<()> {
        for scene in &mut self.scenes {
            if scene.path.as_os_str().is_empty() {
                return Err("a [[scene]] without a path".into());
            }
            if scene.name.is_empty() {
                let last = scene.path.file_name().unwrap_or_default();
                scene.name = last.to_string_lossy().into_owned();
            }
            scene.path = base.join(&scene.path);
            thresholds::check(&scene.thresholds)
                .map_err(|e| format!("thresholds of {}: {e}", scene.name))?;
        }
        let scenes = || self.scenes.iter().map(|s| &s.name);
        let settings = || self.settings.iter().map(|s| &s.name);
        scenes().chain(settings()).try_for_each(|n| folder(n))?;
        distinct(scenes())?;
        distinct(settings())?;
        distinct(self.seeds.iter())?;
        if self.seeds.is_empty() || self.scenes.is_empty() || self.settings.is_empty() {
            return Err("seeds, [[scene]] and [[setting]]: one of each at least".into());
        }
        match &self.cap_from {
            Some(name) if settings().all(|s| s != name) => {
                Err(format!("cap-from: no setting {name:?}"))
            }
            _ => Ok(()),
        }
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
        let mut config: TrainConfig = deserialize(Value::Table(table)).map_err(wrong)?;
        config.seed = seed;
        config.validate().map_err(|e| wrong(e.to_string()))?;
        Ok(config)
    }

    /// Refuses missing datasets, before any of them is trained on.
    ///
    /// # Errors
    /// The first such scene.
    pub fn check_scenes(&self) -> Result<()> {
        match self
            .scenes
            .iter()
            .find(|s| !(s.path.is_dir() || is_archive(&s.path)))
        {
            None => Ok(()),
            Some(scene) => Err(Error::input(
                &scene.path,
                format!("no such folder or zip archive (scene {})", scene.name),
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

/// Refuses a name that cannot be a folder.
fn folder(name: &str) -> Parsed<()> {
    let plain = |c: char| c.is_alphanumeric() || "-_.+".contains(c);
    if name.is_empty() || name.starts_with('.') || !name.chars().all(plain) {
        return Err(format!(
            "name {name:?}; letters, digits and -_.+ expected, for it names a folder"
        ));
    }
    if ["html", "json", "md", "toml"]
        .iter()
        .any(|ending| name.ends_with(&format!(".{ending}")))
    {
        return Err(format!(
            "name {name:?}; files with such an ending are written beside its folder"
        ));
    }
    Ok(())
}

fn distinct<T: PartialEq + std::fmt::Display>(names: impl Iterator<Item = T>) -> Parsed<()> {
    let mut seen = Vec::new();
    for name in names {
        if seen.contains(&name) {
            return Err(format!("{name} is there twice"));
        }
        seen.push(name);
    }
    Ok(())
}
