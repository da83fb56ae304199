//! `mhsplat convert`.

use std::path::PathBuf;

use serde_json::json;

use crate::cli::common::{Common, Outcome};
use crate::cli::scene::Written;
use crate::cli::{output, scene};
use mhsplat::base::error::{Error, Result};
use mhsplat::capture::Frame;
use mhsplat::scene::formats::SceneFile;

/// Arguments of `mhsplat convert`.
#[derive(clap::Args)]
pub struct ConvertArgs {
    /// Scene: a file (PLY, compressed PLY, SPZ, SOG, .splat, .glb) or a run folder.
    input: PathBuf,
    /// File to write, whose ending says the format: .ply, .compressed.ply, .spz, .v4.spz, .splat, .glb; must not exist.
    output: PathBuf,
    /// Keep the Gaussians whose centres lie in this box, in the scene's units: two opposite corners.
    #[arg(long, value_name = "X0,Y0,Z0,X1,Y1,Z1", value_parser = corners, allow_hyphen_values = true)]
    crop: Option<[f64; 6]>,
    /// Keep the Gaussians of at least this opacity, 0 to 1.
    #[arg(long, value_name = "V", value_parser = opacity)]
    min_opacity: Option<f64>,
    /// Keep the spherical harmonics of this degree and below, 0 to 3.
    #[arg(long, value_name = "D", value_parser = clap::value_parser!(u32).range(..=3))]
    sh_degree: Option<u32>,
    /// Leave out the shell of Gaussians that shows the scene's background to other programs.
    #[arg(long)]
    no_background: bool,
}

/// Parses two opposite corners of a box: the least of each axis, then the largest.
fn corners(text: &str) -> std::result::Result<[f64; 6], String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|v| v.trim().parse().ok()).collect();
    let numbers = numbers.and_then(|n| <[f64; 6]>::try_from(n).ok());
    let [a, b, c, d, e, f] = numbers
        .filter(|n| n.iter().all(|v| !v.is_nan()))
        .ok_or("six numbers X0,Y0,Z0,X1,Y1,Z1 expected")?;
    Ok([a.min(d), b.min(e), c.min(f), a.max(d), b.max(e), c.max(f)])
}

/// Parses an opacity.
fn opacity(text: &str) -> std::result::Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if (0.0..=1.0).contains(&v) => Ok(v),
        _ => Err("a number from 0 to 1 expected".into()),
    }
}

/// Reads a scene, leaves out what is not wanted, and writes it.
pub fn run(args: &ConvertArgs, common: &Common) -> Result<Outcome> {
    let out = &args.output;
    let format = scene::new_file(out)?;
    let (input, _) = scene::locate(&args.input)?;
    let file = scene::read(&input, &Frame::IDENTITY)?;
    let found = file.splats.len();
    let mut splats = file.splats.within(args.crop, args.min_opacity);
    if let Some(degree) = args.sh_degree {
        let degree = degree.min(splats.sh_degree());
        splats = splats.with_sh_degree(degree)?;
    }
    let kept = splats.len();
    let degree = match format {
        mhsplat::config::SceneFormat::Splat => 0,
        _ => splats.sh_degree(),
    };
    if kept == 0 && found > 0 {
        let what = format!("none of its {found} Gaussians is left");
        let fix =
            "look at --crop (the scene's own units; `mhsplat info` tells them) and --min-opacity";
        return Err(Error::input(&input, what, fix));
    }
    // About a part alone nothing is to be seen.
    let whole = args.crop.is_none() && !args.no_background;
    let background = file.background.filter(|_| whole);
    let file = SceneFile {
        splats,
        background,
        ..file
    };
    let Written { bytes, lost } = scene::write(out, format, &file)?;
    if common.json {
        let remarks = [file.changes(), lost].concat();
        output::json(&json!({
            "input": input, "output": out, "read": found, "gaussians": kept, "sh_degree": degree,
            "anti_aliased": file.anti_aliased, "bytes": bytes, "remarks": remarks,
        }))?;
        return Ok(Outcome::Done);
    }
    let of = match kept == found {
        true => String::new(),
        false => format!(" of {found}"),
    };
    let size = bytes as f64 / 1e6;
    output::line(&format!(
        "{}: {kept}{of} Gaussians, SH degree {degree}, {size:.2} MB",
        out.display()
    ));
    Ok(Outcome::Done)
}
