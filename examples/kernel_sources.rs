//! Writes the kernels' sources as drivers of GPUs get them, a folder for the sizes of each class of GPU, in it a file for each stage and
//! variant, and for each stage that another size would change when a device is tuned:
//! `cargo run --release --example kernel_sources -- FOLDER`. `.ci/gpu-check` compiles them without a GPU.

use std::collections::BTreeMap;

use mhsplat::capture::Alpha;
use mhsplat::device::tuning::Tuning;
use mhsplat::device::{Defines, source, stages};
use mhsplat::lab::tune::alternatives;
use mhsplat::{Error, Result};

/// Variants of a stage: a suffix of the file's name and what differs from the default.
fn variants(stage: &str, tuning: Tuning) -> Vec<(String, Defines)> {
    let base = Defines {
        sh_degree: 3,
        ..Defines::new(tuning)
    };
    let alpha = |alpha| Defines { alpha, ..base };
    // Every degree, without and with the 3D filter.
    let shaded = |suffix: &str, base: Defines| {
        let each = (0..=3).flat_map(|sh_degree| [(sh_degree, false), (sh_degree, true)]);
        let variant = |(sh_degree, anti_alias): (u32, bool)| {
            let filtered = if anti_alias { "-aa" } else { "" };
            let defines = Defines {
                sh_degree,
                anti_alias,
                ..base
            };
            (format!("{suffix}-sh{sh_degree}{filtered}"), defines)
        };
        each.map(variant).collect::<Vec<_>>()
    };
    let stepping = Defines {
        take_step: true,
        ..base
    };
    let plain = || ("".to_owned(), base);
    let clear = || ("-alpha".to_owned(), alpha(Alpha::Transparency));
    let masked = || ("-mask".to_owned(), alpha(Alpha::Mask));
    match stage {
        "project" => shaded("", base),
        "project_grad" => [shaded("", base), shaded("-step", stepping)].concat(),
        "loss" | "metrics" | "photo_error" => vec![plain(), clear(), masked()],
        "bin" => vec![plain(), masked()],
        "active_tiles" => vec![clear(), masked()],
        "filter" => {
            let filtered = Defines {
                anti_alias: true,
                ..base
            };
            vec![("".to_owned(), filtered)]
        }
        _ => vec![plain()],
    }
}

/// Sizes in which a tuning differs from another: a suffix of the file's name.
fn changes(own: Tuning, other: Tuning) -> String {
    let sizes = |tuning| match serde_json::to_value(tuning) {
        Ok(serde_json::Value::Object(sizes)) => sizes,
        _ => serde_json::Map::new(),
    };
    let own = sizes(own);
    let changed = sizes(other).into_iter();
    let changed = changed.filter(|(name, value)| own.get(name) != Some(value));
    changed
        .map(|(name, value)| format!(".{name}-{value}"))
        .collect()
}

/// Sources by the names of their files without the ending, for GPUs with these sizes by default.
pub fn sources(own: Tuning) -> BTreeMap<String, String> {
    let mut sources = BTreeMap::new();
    for stage in stages() {
        for (variant, defines) in variants(stage, own) {
            sources.insert(format!("{stage}{variant}"), source(stage, &defines, false));
        }
    }
    for other in alternatives(own) {
        for stage in stages() {
            // The variants of a stage are alike in what depends on sizes.
            let plain = variants(stage, own).into_iter().next();
            let Some((variant, defines)) = plain else {
                continue;
            };
            let text = |tuning| source(stage, &Defines { tuning, ..defines }, false);
            if text(other) != text(own) {
                let name = format!("{stage}{variant}{}", changes(own, other));
                sources.insert(name, text(other));
            }
        }
    }
    sources
}

/// Folders of the classes of GPUs, and the sizes that each has by default.
pub const CLASSES: [(&str, Tuning); 2] = [("gpu", Tuning::GPU), ("gpu-wide", Tuning::GPU_WIDE)];

/// Writes the sources into the folder given.
fn main() -> Result<()> {
    let folder = std::env::args().nth(1);
    let folder = folder.ok_or_else(|| Error::config("FOLDER", "missing: where to write to"))?;
    for (class, tuning) in CLASSES {
        let folder = std::path::Path::new(&folder).join(class);
        std::fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, e))?;
        for (name, text) in sources(tuning) {
            let file = folder.join(format!("{name}.cl"));
            std::fs::write(&file, text).map_err(|e| Error::io(&file, e))?;
        }
    }
    Ok(())
}
