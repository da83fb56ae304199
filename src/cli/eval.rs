//! `mhsplat eval`.

use std::path::{Path, PathBuf};

use serde_json::json;

use crate::cli::common::{Common, DeviceOption, Outcome};
use crate::cli::{output, scene};
use mhsplat::base::error::{Error, Result};
use mhsplat::capture::Needed;
use mhsplat::device::Defines;
use mhsplat::evaluate::Evaluator;
use mhsplat::pipeline::buffers::ViewSet;
use mhsplat::pipeline::photos::Photos;
use mhsplat::run::FinalRecord;

/// Arguments of `mhsplat eval`.
#[derive(clap::Args)]
pub struct EvalArgs {
    /// Scene: a file (PLY, compressed PLY, SPZ, SOG, .splat, .glb) or a run folder.
    scene: PathBuf,
    /// Dataset with the photos to compare with (default: the run's).
    dataset: Option<PathBuf>,
    #[command(flatten)]
    photos: scene::PhotoOptions,
    /// black, white or R,G,B (the run's, else the scene file's, else black).
    #[arg(long)]
    background: Option<String>,
    /// Score the training views instead of the held-out ones.
    #[arg(long)]
    training_views: bool,
    /// Draw nothing nearer to a camera than this, in the dataset's units: what a viewer with this near plane shows (default: that of
    /// training, 0.004 scene extents).
    #[arg(long, value_name = "DEPTH", value_parser = output::depth)]
    near: Option<f64>,
    /// Also score after an affine fit of each render's colours to its photo (gsplat's cc_psnr).
    #[arg(long)]
    color_corrected: bool,
    /// Exit with 1 unless the mean PSNR reaches this, dB.
    #[arg(long, value_name = "DB", value_parser = output::finite)]
    require_psnr: Option<f64>,
    #[command(flatten)]
    device: DeviceOption,
}

/// Scores the held-out views.
pub fn run(args: &EvalArgs, common: &Common) -> Result<Outcome> {
    let (ply, record) = scene::locate(&args.scene)?;
    let dataset = scene::dataset_path(
        args.dataset.as_deref(),
        record.as_ref(),
        "give the folder of the photos after it",
    )?;
    let needed = match args.training_views {
        true => Needed::Training,
        false => Needed::HeldOut,
    };
    let mut data = scene::dataset(&dataset, record.as_ref(), &args.photos, needed)?;
    if args.training_views {
        data.test = std::mem::take(&mut data.train);
    }
    if data.test.is_empty() {
        return Err(nothing_held_out(&dataset));
    }
    let mut loaded = scene::open(&ply, &data.frame, &args.device)?;
    let photos = Photos::new(&loaded.device, data.image_budget);
    let mut views = ViewSet::new(&photos, data.test)?;
    if let Some(near) = args.near {
        let near = (near / data.frame.scale) as f32;
        views.cameras.iter_mut().for_each(|c| c.near = near);
    }
    let defines = Defines::new(loaded.device.tuning());
    let evaluator = Evaluator::new(&loaded.device, defines, views)?;
    let background = scene::background(args.background.as_deref(), record.as_ref())?;
    let background = background.unwrap_or(loaded.background);
    let scene = &mut (&loaded.scene, &mut loaded.renderer);
    let mut scores = evaluator.score_all(scene, background, true)?;
    if args.color_corrected {
        evaluator.add_color_corrected(&mut scores, scene, background)?;
    }
    let scores = FinalRecord::of(scores).ok_or_else(|| nothing_held_out(&dataset))?;
    let mean = &scores.mean;
    let (psnr, ssim, flip) = (mean.psnr, mean.ssim, mean.flip.unwrap_or(1.0));
    let size = evaluator.views().cameras.first().map_or([0, 0], |c| c.size);
    if common.json {
        output::json(&json!({
            "scene": ply, "gaussians": loaded.scene.count, "width": size[0], "height": size[1],
            "psnr": psnr, "ssim": ssim, "flip": flip, "per_view": scores.per_view,
            "cc_psnr": mean.cc_psnr, "cc_ssim": mean.cc_ssim,
        }))?;
        return Ok(Outcome::of(args.require_psnr, Some(psnr)));
    }
    for s in &scores.per_view {
        let (view, flip) = (&s.view, s.scores.flip.unwrap_or(1.0));
        output::line(&format!(
            "{:>7.3} dB  SSIM {:.4}  FLIP {flip:.4}  {view}",
            s.scores.psnr, s.scores.ssim
        ));
    }
    output::line(&format!(
        "{psnr:>7.3} dB  SSIM {ssim:.4}  FLIP {flip:.4}  mean of {} {} views at {}x{}, {} Gaussians",
        scores.per_view.len(),
        if args.training_views {
            "training"
        } else {
            "held-out"
        },
        size[0],
        size[1],
        loaded.scene.count
    ));
    if let Some((psnr, ssim)) = mean.cc_psnr.zip(mean.cc_ssim) {
        output::line(&format!(
            "{psnr:>7.3} dB  SSIM {ssim:.4}  mean after fitting colours to the photos"
        ));
    }
    Ok(Outcome::of(args.require_psnr, Some(psnr)))
}

fn nothing_held_out(dataset: &Path) -> Error {
    Error::input(
        dataset,
        "no held-out view",
        "hold some out with --test-every; photos that are masked out completely do not count",
    )
}
