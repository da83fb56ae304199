//! `mhsplat synth`.

use std::path::PathBuf;

use crate::cli::common::{Common, Outcome};
use crate::cli::output;
use mhsplat::base::error::{Error, Result};
use mhsplat::lab::synth::{SynthLayout, SynthOptions, generate};

/// Arguments of `mhsplat synth`.
#[derive(clap::Args)]
pub struct SynthArgs {
    /// Scene: room or object.
    name: String,
    /// Folder to write; must not exist or be empty.
    dir: PathBuf,
    /// Layout of the files [default: colmap for room, transforms for object]
    #[arg(long, value_enum)]
    layout: Option<SynthLayout>,
    /// Views, held-out ones included [default: 64]
    #[arg(long)]
    views: Option<u32>,
    /// Image size, WIDTHxHEIGHT pixels [default: 480x360 for room, 400x400 for object]
    #[arg(long, value_name = "WxH")]
    size: Option<String>,
    /// Sparse points [default: 10000]
    #[arg(long)]
    points: Option<u32>,
    /// Seed of textures, sub-pixel positions and points [default: 0]
    #[arg(long)]
    seed: Option<u64>,
    /// Rays per pixel, rounded up to a square number [default: 16]
    #[arg(long)]
    samples: Option<u32>,
}

/// Writes the dataset and reports it.
pub fn run(args: &SynthArgs, common: &Common) -> Result<Outcome> {
    let mut options = SynthOptions::for_scene(&args.name);
    options.layout = args.layout.unwrap_or(options.layout);
    if let Some(size) = &args.size {
        let wrong = || {
            Error::config(
                "--size",
                format!("{size:?}; WIDTHxHEIGHT expected, like 256x192"),
            )
        };
        let (w, h) = size.split_once('x').ok_or_else(wrong)?;
        options.width = w.parse().map_err(|_| wrong())?;
        options.height = h.parse().map_err(|_| wrong())?;
    }
    options.views = args.views.unwrap_or(options.views);
    options.points = args.points.unwrap_or(options.points);
    options.seed = args.seed.unwrap_or(options.seed);
    options.samples = args.samples.unwrap_or(options.samples);
    let report = generate(&args.name, &args.dir, &options)?;
    if common.json {
        output::json(&report)?;
    } else {
        output::line(&format!("{} written to {}", args.name, args.dir.display()));
    }
    Ok(Outcome::Done)
}
