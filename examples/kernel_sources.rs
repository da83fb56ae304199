//! Writes the kernels' sources as drivers of GPUs get them, a folder for the sizes of each class of GPU, in it a file for each stage and
//! variant: `cargo run --release --example kernel_sources -- FOLDER`. `.ci/gpu-check` compiles them without a GPU.

use mhsplat::capture::Alpha;
use mhsplat::device::tuning::Tuning;
use mhsplat::device::{Defines, source, stages};
use mhsplat::{Error, Result};

/// Variants of a stage: a suffix of the file's name and what differs from the default.
fn variants(stage: &str, tuning: Tuning) -> Vec<(&'static str, Defines)> {
    let base = Defines {
        sh_degree: 3,
        ..Defines::new(tuning)
    };
    let filtered = Defines {
        anti_alias: true,
        ..base
    };
    let alpha = |alpha| Defines { alpha, ..base };
    let flat = Defines {
        sh_degree: 0,
        ..base
    };
    let stepping = |defines| Defines {
        take_step: true,
        ..defines
    };
    match stage {
        "project" => vec![("-sh0", flat), ("-sh3", base), ("-sh3-aa", filtered)],
        "project_grad" => vec![
            ("-sh3", base),
            ("-step-sh0", stepping(flat)),
            ("-step-sh3", stepping(base)),
            ("-step-sh3-aa", stepping(filtered)),
        ],
        "loss" | "metrics" | "photo_error" => vec![
            ("", base),
            ("-alpha", alpha(Alpha::Transparency)),
            ("-mask", alpha(Alpha::Mask)),
        ],
        "bin" => vec![("", base), ("-mask", alpha(Alpha::Mask))],
        "active_tiles" => vec![("-mask", alpha(Alpha::Mask))],
        "filter" => vec![("", filtered)],
        _ => vec![("", base)],
    }
}

fn main() -> Result<()> {
    let folder = std::env::args().nth(1);
    let folder = folder.ok_or_else(|| Error::config("FOLDER", "missing: where to write to"))?;
    for (class, tuning) in [("gpu", Tuning::GPU), ("gpu-wide", Tuning::GPU_WIDE)] {
        let folder = std::path::Path::new(&folder).join(class);
        std::fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, e))?;
        for stage in stages() {
            for (variant, defines) in variants(stage, tuning) {
                let file = folder.join(format!("{stage}{variant}.cl"));
                let text = source(stage, &defines, false);
                std::fs::write(&file, text).map_err(|e| Error::io(&file, e))?;
            }
        }
    }
    Ok(())
}
