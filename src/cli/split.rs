//! `mhsplat split`.

use std::path::PathBuf;

use serde_json::json;

use crate::cli::common::{Common, Outcome};
use crate::cli::output;
use mhsplat::base::error::Result;
use mhsplat::capture::split::{Cells, SplitOptions, split};
use mhsplat::lab::folder::check_folder;

/// Arguments of `mhsplat split`.
#[derive(clap::Args)]
pub struct SplitArgs {
    /// Folder with photos and their cameras, as for train.
    dataset: PathBuf,
    /// Number of cells.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    cells: u32,
    /// Folder of the parts; must not exist or be empty.
    #[arg(short, long, value_name = "PARTS")]
    output: PathBuf,
    /// Margin around a cell whose photos and points its part has as well, a share of its length.
    #[arg(long, value_name = "SHARE", default_value_t = 0.2, value_parser = share)]
    overlap: f64,
    /// Photos from elsewhere of which a cell covers more than this are in its part as well, a share of the image.
    #[arg(long, value_name = "SHARE", default_value_t = 0.25, value_parser = share)]
    visibility: f64,
    /// Every n-th image by name is held out, in every part that has it; 0 for none.
    #[arg(long, value_name = "N", default_value_t = 8)]
    test_every: u32,
    /// Folder of the photos, in the dataset or elsewhere (default: where the dataset says).
    #[arg(long, value_name = "DIR")]
    images: Option<PathBuf>,
}

/// Parses a share.
fn share(text: &str) -> std::result::Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if (0.0..=1.0).contains(&v) => Ok(v),
        _ => Err("a number from 0 to 1 expected".into()),
    }
}

/// Writes the parts, and says how large they are.
pub fn run(args: &SplitArgs, common: &Common) -> Result<Outcome> {
    let parts = &args.output;
    check_folder(parts)?;
    let options = SplitOptions {
        cells: args.cells as usize,
        overlap: args.overlap,
        visibility: args.visibility,
        test_every: args.test_every,
        images: args.images.clone(),
    };
    let cells = split(&args.dataset, parts, &options)?;
    cells.remarks.iter().for_each(|remark| output::note(remark));
    if common.json {
        output::json(&json!({ "output": parts, "cells": cells }))?;
        return Ok(Outcome::Done);
    }
    for (i, c) in cells.cells.iter().enumerate() {
        let photos = c.train + c.held_out;
        output::line(&format!(
            "{}: {} photos to train on and {} held out ({} in the cell, {} in its margin, {} that show it); {} points, {} of them in the cell",
            Cells::part(parts, i).display(),
            c.train,
            c.held_out,
            c.own,
            photos - c.own - c.seeing,
            c.seeing,
            c.points,
            c.own_points
        ));
    }
    let [part, run] = ["cell-0", "run-0"].map(|name| parts.join(name));
    output::line(&format!(
        "next, for each: mhsplat train {} -o {}; then: mhsplat merge {} -o scene.ply",
        part.display(),
        run.display(),
        parts.display()
    ));
    Ok(Outcome::Done)
}
