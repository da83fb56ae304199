//! `mhsplat merge`.

use std::path::{Path, PathBuf};

use glam::DVec3;
use serde_json::json;

use crate::cli::common::{Common, Outcome};
use crate::cli::scene::{PhotoOptions, Written};
use crate::cli::{output, scene};
use mhsplat::base::error::{Error, Result};
use mhsplat::capture::split::Cells;
use mhsplat::capture::{Frame, Needed};
use mhsplat::run::RunRecord;
use mhsplat::scene::formats::{SceneFile, Sphere};
use mhsplat::train::reasons::Part;

/// Arguments of `mhsplat merge`.
#[derive(clap::Args)]
pub struct MergeArgs {
    /// Folder that split wrote.
    parts: PathBuf,
    /// File to write, whose ending says the format: .ply, .compressed.ply, .spz, .v4.spz, .splat, .glb; must not exist.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Run folders or scene files, one for each cell in their order (default: run-0, run-1 and so on in the folder of the parts).
    #[arg(long, value_name = "RUN", num_args = 1..)]
    runs: Vec<PathBuf>,
}

/// Difference of the backgrounds of two cells that nobody sees, of the full range.
const ALIKE: f32 = 0.02;

/// Decisions of a training that all scenes to be joined must share.
#[derive(PartialEq)]
struct Convention {
    sh_degree: u32,
    anti_aliased: bool,
    /// None for a scene file, which does not tell.
    exposure: Option<bool>,
}

/// Joins the Gaussians that are in their own cells, and writes them.
pub fn run(args: &MergeArgs, common: &Common) -> Result<Outcome> {
    let (parts, out) = (&args.parts, &args.output);
    let format = scene::new_file(out)?;
    let cells = Cells::read(parts)?;
    let runs = runs(args, cells.cells.len())?;
    let mut counts = Vec::with_capacity(runs.len());
    let mut whole: Option<(SceneFile, Convention)> = None;
    let (mut up, mut spheres, mut backgrounds) = (DVec3::ZERO, Vec::new(), Vec::new());
    for (i, run) in runs.iter().enumerate() {
        let (file, record) = scene::locate(run)?;
        if let Some(record) = &record {
            check_run(run, record, &Cells::part(parts, i))?;
        }
        let file = scene::read(&file, &Frame::IDENTITY)?;
        let convention = Convention {
            sh_degree: file.splats.sh_degree(),
            anti_aliased: file.anti_aliased,
            exposure: record.as_ref().map(compensated),
        };
        up += file.up.map_or(DVec3::ZERO, DVec3::from);
        spheres.extend(file.cameras);
        backgrounds.extend(file.background);
        let read = file.splats.len();
        let splats = file.splats.centered(|p| cells.owns(i, p));
        counts.push((run, read, splats.len()));
        match &mut whole {
            None => whole = Some((SceneFile { splats, ..file }, convention)),
            Some((whole, first)) => {
                check_convention(run, &convention, &runs[0], first)?;
                first.exposure = first.exposure.or(convention.exposure);
                whole.splats.append(&splats)?;
            }
        }
    }
    let Some((mut whole, convention)) = whole else {
        return Err(Error::input(parts, "no cell", "split the dataset again"));
    };
    if whole.splats.is_empty() {
        let what = "none of the runs has a Gaussian in its cell";
        let fix = "give the runs in the order of the cells, trained on the parts of this folder";
        return Err(Error::input(parts, what, fix));
    }
    for (run, ..) in counts.iter().filter(|(.., kept)| *kept == 0) {
        output::note(&format!("{}: no Gaussian lies in its cell", run.display()));
    }
    whole.up = up.try_normalize().map(|up| up.to_array());
    // Of some cells alone it would leave the others out.
    whole.cameras = around(&spheres).filter(|_| spheres.len() == runs.len());
    whole.background = mean(&backgrounds).filter(|_| backgrounds.len() == runs.len());
    let apart = |a: &[f32; 3], b: &[f32; 3]| (0..3).any(|c| (a[c] - b[c]).abs() > ALIKE);
    let differ = backgrounds.iter().any(|b| apart(b, &backgrounds[0]));
    if differ || !(backgrounds.is_empty() || backgrounds.len() == runs.len()) {
        output::note(
            "the runs were trained over different backgrounds: the sky may differ between cells (--background R,G,B gives all the same)",
        );
    }
    if convention.exposure == Some(true) {
        output::note(
            "the runs compensated exposures, each by itself: brightness may differ between cells",
        );
    }
    let Written { bytes, lost } = scene::write(out, format, &whole)?;
    let gaussians = whole.splats.len();
    if common.json {
        let of = |(run, read, kept): &(&PathBuf, usize, usize)| json!({ "run": run, "read": read, "kept": kept });
        let cells: Vec<_> = counts.iter().map(of).collect();
        output::json(&json!({
            "output": out, "cells": cells, "gaussians": gaussians, "sh_degree": convention.sh_degree,
            "anti_aliased": convention.anti_aliased, "bytes": bytes, "remarks": lost,
        }))?;
        return Ok(Outcome::Done);
    }
    for (i, (run, read, kept)) in counts.iter().enumerate() {
        let run = run.display();
        output::line(&format!(
            "cell {i}: {kept} of the {read} Gaussians of {run} stay"
        ));
    }
    output::line(&format!(
        "{}: {gaussians} Gaussians of {} cells, SH degree {}, {:.2} MB",
        out.display(),
        runs.len(),
        convention.sh_degree,
        bytes as f64 / 1e6
    ));
    Ok(Outcome::Done)
}

/// A sphere around spheres, about the mean of their centres; `None` if there are none.
fn around(spheres: &[Sphere]) -> Option<Sphere> {
    let center = spheres.iter().map(|s| s.center).sum::<DVec3>() / spheres.len().max(1) as f64;
    let reach = spheres.iter().map(|s| s.center.distance(center) + s.radius);
    let radius = reach.reduce(f64::max)?;
    Some(Sphere { center, radius })
}

/// The mean of colours; `None` if there are none.
fn mean(colors: &[[f32; 3]]) -> Option<[f32; 3]> {
    let sum = |c: usize| colors.iter().map(|color| color[c]).sum::<f32>();
    (!colors.is_empty()).then(|| [0, 1, 2].map(|c| sum(c) / colors.len() as f32))
}

/// Returns the runs of the cells.
///
/// # Errors
/// Another number than there are cells, and one that is not there.
fn runs(args: &MergeArgs, cells: usize) -> Result<Vec<PathBuf>> {
    let (parts, given) = (&args.parts, args.runs.len());
    let usual = || (0..cells).map(|i| parts.join(format!("run-{i}"))).collect();
    let runs: Vec<PathBuf> = match given {
        0 => usual(),
        n if n == cells => args.runs.clone(),
        n => {
            let what = format!("{n} given, and {} has {cells} cells", parts.display());
            return Err(Error::config("--runs", what));
        }
    };
    if let Some((i, run)) = runs.iter().enumerate().find(|(_, run)| !run.exists()) {
        let part = Cells::part(parts, i);
        let fix = format!(
            "train it (mhsplat train {} -o {}), or say with --runs where the runs are",
            part.display(),
            run.display()
        );
        return Err(Error::input(
            run,
            format!("no such run; cell {i} has none"),
            fix,
        ));
    }
    Ok(runs)
}

/// True if a run gave each photo a colour transform of its own.
fn compensated(record: &RunRecord) -> bool {
    let name = Part::Exposure.to_string();
    record.plan.kept.iter().any(|item| item.what == name)
}

/// Checks that a run is one of a part, and notes one that has not come to its end.
///
/// # Errors
/// A run that was trained on something else.
fn check_run(run: &Path, record: &RunRecord, part: &Path) -> Result<()> {
    let data = scene::dataset(part, Some(record), &PhotoOptions::of_run(), Needed::None)?;
    let known = &record.dataset.capture;
    if known
        .as_ref()
        .is_some_and(|k| *k != data.capture_fingerprint())
    {
        let (trained, part) = (&record.dataset.path, part.display());
        let what = format!("trained on {trained}, whose views are not those of {part}");
        let fix = "give the runs in the order of the cells, trained on these parts";
        return Err(Error::input(run, what, fix));
    }
    if !record.ended() {
        output::note(&format!(
            "{}: not at its end, after {} of {} iterations",
            run.display(),
            record.iterations,
            record.config.last_iterations()
        ));
    }
    Ok(())
}

/// Refuses a scene that means something else by its Gaussians than the first one.
fn check_convention(run: &Path, own: &Convention, first: &Path, of: &Convention) -> Result<()> {
    let yes_no = |yes: bool| if yes { "with" } else { "without" };
    let first = first.display();
    if own.sh_degree != of.sh_degree {
        let what = format!(
            "SH degree {}, and {first} has {}",
            own.sh_degree, of.sh_degree
        );
        let fix =
            "train all cells with the same --sh-degree, or cut one (mhsplat convert --sh-degree)";
        return Err(Error::input(run, what, fix));
    }
    let exposures = own.exposure.zip(of.exposure);
    for ((own, of), what, option) in [
        (
            (own.anti_aliased, of.anti_aliased),
            "anti-aliasing",
            "--anti-aliasing",
        ),
        (
            exposures.unwrap_or_default(),
            "exposure compensation",
            "--exposure",
        ),
    ] {
        if own != of {
            let (own, of) = (yes_no(own), yes_no(of));
            let what = format!("trained {own} {what}, and {first} {of}");
            let fix = format!("train all cells with {option} on, or all with {option} off");
            return Err(Error::input(run, what, fix));
        }
    }
    Ok(())
}
