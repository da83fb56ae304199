//! `mhsplat info`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;
use serde_json::{Value, json};

use crate::cli::common::{Common, DeviceOption, Outcome, tested};
use crate::cli::{output, scene};
use mhsplat::base::constants::LOG_SCALE;
use mhsplat::base::error::{Error, Result};
use mhsplat::base::math::{order_statistic, sigmoid, sorted};
use mhsplat::capture::{self, Alpha, Dataset, Frame, Lens, Temporary, View};
use mhsplat::config::{Preset, TrainConfig};
use mhsplat::lab::tune::SizeClass;
use mhsplat::run::{Clock, PlanRecord, RECORD_FILE, Run, RunRecord, with_points};
use mhsplat::scene::Plane;
use mhsplat::scene::formats::Sphere;
use mhsplat::train::Plan;

/// Shares at which quantiles are given.
const QUANTILES: [f64; 5] = [0.0, 0.05, 0.5, 0.95, 1.0];

/// Arguments of `mhsplat info`.
#[derive(clap::Args)]
pub struct InfoArgs {
    /// Dataset (a folder or a zip archive), run folder or scene file.
    path: PathBuf,
    /// Longest image side that training would use, pixels.
    #[arg(long, value_name = "PX", default_value_t = TrainConfig::default().max_size)]
    max_size: u32,
    /// Every n-th image by name that training would hold out.
    #[arg(long, value_name = "N", default_value_t = TrainConfig::default().test_every)]
    test_every: u32,
    /// Folder of the photos, in the dataset or elsewhere.
    #[arg(long, value_name = "DIR")]
    images: Option<PathBuf>,
    /// Take the photos' alpha for a mask.
    #[arg(long)]
    alpha_is_mask: bool,
    /// Masks are black where a photo counts.
    #[arg(long)]
    invert_masks: bool,
    /// Train for some seconds, into a folder that is then removed, and tell how long a run takes on the device.
    #[arg(long)]
    time: bool,
    #[command(flatten)]
    device: DeviceOption,
}

/// Describes a dataset, a run or a scene file; a device is needed to tell the time alone.
pub fn run(args: &InfoArgs, common: &Common) -> Result<Outcome> {
    if args.time && (args.path.join(RECORD_FILE).is_file() || is_scene(&args.path)) {
        let what = "given for a run or a scene; only a dataset's training is timed";
        return Err(Error::config("--time", what));
    }
    let (document, lines) = if args.path.join(RECORD_FILE).is_file() {
        of_run(&RunRecord::read(&args.path)?)
    } else if is_scene(&args.path) {
        of_scene(&args.path)?
    } else {
        of_dataset(args)?
    };
    match common.json {
        true => output::json(&document)?,
        false => lines.iter().for_each(|line| output::line(line)),
    }
    Ok(Outcome::Done)
}

/// Returns true for a file that is no archive.
fn is_scene(path: &Path) -> bool {
    path.is_file() && !capture::is_archive(path)
}

fn of_dataset(args: &InfoArgs) -> Result<(Value, Vec<String>)> {
    let config = TrainConfig {
        max_size: args.max_size,
        test_every: args.test_every,
        images: args.images.clone(),
        alpha_is_mask: args.alpha_is_mask,
        invert_masks: args.invert_masks,
        iterations: Preset::Standard.iterations(),
        ..TrainConfig::default()
    };
    config.validate()?;
    let data = capture::load(&args.path, &scene::load_options(&config))?;
    let data = with_points(data, &config)?;
    let plan = PlanRecord::of(&Plan::new(&data, &config)?);
    scene::note_left_out(&data);
    let sizes = counted(&data, |v| format!("{}x{}", v.camera.width, v.camera.height));
    let lenses = counted(&data, |v| lens(&v.lens).to_owned());
    let stops = brightness(&data)?;
    let (train, test) = (data.train.len(), data.test.len());
    let found = data.swept;
    let points = match found {
        Some(_) => 0,
        None => data.points.positions.len(),
    };
    let (scale, center) = (data.frame.scale, data.frame.center.to_array());
    let (layout, alpha) = (data.layout.to_string(), format!("{:?}", data.alpha()));
    let alpha = alpha.to_lowercase();
    let memory = data.photo_bytes();
    let mut document = json!({
        "path": data.path, "layout": layout, "place": data.place, "training_views": train, "held_out_views": test, "sizes": sizes, "lenses": lenses,
        "alpha": alpha, "brightness_stops": stops, "points": points, "points_found": found, "extent": scale, "center": center, "photo_bytes": memory,
        "photos_on_demand": data.photos_on_demand(), "missing": data.missing, "astray": data.outliers,
        "masked_out": data.masked_out, "remarks": data.remarks, "plan": plan,
    });
    let words = |counts: &BTreeMap<String, usize>| {
        let all = counts.iter().map(|(what, n)| format!("{n} of {what}"));
        all.collect::<Vec<_>>().join(", ")
    };
    let on_demand = match data.photos_on_demand() {
        true => ", more than there is: decoded on demand",
        false => "",
    };
    let mut lines = vec![
        format!(
            "{}: {layout} ({}), {train} training views, {test} held out",
            data.path.display(),
            data.place
        ),
        format!("sizes in training: {}", words(&sizes)),
        format!("lenses: {}", words(&lenses)),
        format!("alpha: {alpha}"),
        format!("brightness: 9 of 10 photos within {stops:.2} stops"),
        match found {
            Some(found) => format!("points: none; {found} found in the photos"),
            None => format!("points: {points}"),
        },
        format!("extent: {scale:.4} around {center:.4?}, in the dataset's units"),
        format!("memory of the photos: {} MiB{on_demand}", memory >> 20),
    ];
    lines.extend(plan.summary(true));
    if args.time {
        let (seconds, told) = expected_time(args, data, config)?;
        document["expected_seconds"] = json!(seconds);
        lines.push(told);
    }
    Ok((document, lines))
}

/// Seconds that a run of a dataset is expected to take on the device, and a sentence on them, after its first iterations.
fn expected_time(args: &InfoArgs, data: Dataset, config: TrainConfig) -> Result<(f64, String)> {
    let device = args.device.open()?;
    let device = tested(device, SizeClass::of_run(&data, &config))?;
    let place = Temporary::new()?;
    let stop = AtomicBool::new(false);
    let mut told = None;
    let clock = Clock::start();
    let mut run = Run::start(&place.folder, data, config, &device, clock)?;
    let ended = run.drive(&stop, |p| {
        if let (Some(left), Some(what)) = (p.left, &p.decided)
            && told.is_none()
        {
            told = Some((p.train_seconds + left, what.clone()));
            stop.store(true, Ordering::Relaxed);
        }
    });
    let ended = ended.map(|_| ());
    let name = &device.info().name;
    match (told, ended) {
        (Some((seconds, what)), _) => Ok((seconds, format!("time on {name}: {what}"))),
        (None, Err(error)) => Err(error),
        (None, Ok(())) => Err(Error::config(
            "--time",
            "the run was over before it could be told",
        )),
    }
}

/// Number of views by a property.
fn counted(data: &Dataset, of: impl Fn(&View) -> String) -> BTreeMap<String, usize> {
    let mut counts = BTreeMap::new();
    for view in data.views() {
        *counts.entry(of(view)).or_default() += 1;
    }
    counts
}

fn lens(lens: &Lens) -> &'static str {
    match lens {
        Lens::Pinhole => "no distortion",
        Lens::Equirectangular => "panoramas",
        Lens::Brown { fisheye: true, .. } => "fisheye",
        Lens::Perspective { .. } | Lens::Brown { .. } => "perspective distortion",
        Lens::Fov { .. } | Lens::Division { .. } | Lens::Eucm { .. } => "wide-angle distortion",
        Lens::Fisheye { .. }
        | Lens::ThinPrismFisheye { .. }
        | Lens::RadTanThinPrismFisheye { .. } => "fisheye",
    }
}

/// Binary logarithm of the mean brightness of photos at 95 % over that at 5 % of them; of what is transparent or masked nothing counts.
fn brightness(data: &Dataset) -> Result<f64> {
    let views: Vec<&View> = data.views().collect();
    let mean = |view: &&View| -> Result<f64> {
        let photo = view.photo.load()?;
        let pixels = photo.width as usize * photo.height as usize;
        let colors = photo.data.iter().take(3 * pixels);
        let sum: u64 = colors.map(|v| u64::from(*v)).sum();
        // Colours are those times the alpha.
        let alpha = photo.data[3 * pixels..].iter().map(|v| u64::from(*v)).sum();
        let counted = match photo.alpha {
            Alpha::None => pixels as f64,
            _ => u64::max(alpha, 1) as f64 / 255.0,
        };
        // A black photo is as dark as one of the darkest grey.
        Ok((sum as f64 / (3.0 * counted)).max(1.0))
    };
    let means = views.par_iter().map(mean).collect::<Result<Vec<f64>>>()?;
    let means = sorted(means.into_iter());
    let at = |share: f64| order_statistic(&means, share).unwrap_or(1.0);
    Ok((at(0.95) / at(0.05)).log2())
}

fn of_run(record: &RunRecord) -> (Value, Vec<String>) {
    let (mean, r) = (record.final_scores.as_ref().map(|f| f.mean), record);
    let document = json!({
        "version": r.version, "commit": r.commit, "dataset": r.dataset, "device": r.device, "config": r.config,
        "iterations": r.iterations, "planned_iterations": r.config.last_iterations(), "gaussians": r.gaussians,
        "train_seconds": r.train_seconds, "wall_seconds": r.wall_seconds, "cpu_seconds": r.cpu_seconds,
        "peak_rss_bytes": r.peak_rss_bytes, "scores": mean, "plan": r.plan,
    });
    let d = &r.dataset;
    let mut lines = vec![
        format!(
            "{} of {} iterations, {} Gaussians, {:.1} s ({:.1} CPU s of training)",
            r.iterations,
            r.config.last_iterations(),
            r.gaussians,
            r.wall_seconds,
            r.cpu_seconds
        ),
        format!(
            "{} ({}): {} training views, {} held out, to {}x{}",
            d.path, d.layout, d.train_views, d.test_views, d.width, d.height
        ),
        format!("device: {} ({})", r.device.name, r.device.platform),
        format!("mhsplat {} ({})", r.version, r.commit),
    ];
    let score = mean.map(|m| format!("{:.3} dB, SSIM {:.4}, held out", m.psnr, m.ssim));
    lines.extend(score);
    lines.extend(r.plan.summary(false));
    (document, lines)
}

fn of_scene(path: &Path) -> Result<(Value, Vec<String>)> {
    let file = scene::read(path, &Frame::IDENTITY)?;
    let splats = &file.splats;
    let values = |first: usize, count: usize, of: fn(f64) -> f64| -> Vec<f64> {
        let planes = splats.planes().iter().skip(first).take(count);
        let values = planes.flatten().map(|v| of(f64::from(*v)));
        let values = sorted(values);
        let at = QUANTILES.iter().map(|q| order_statistic(&values, *q));
        at.flatten().collect()
    };
    let axes: Vec<Vec<f64>> = (0..3)
        .map(|k| values(Plane::POSITION + k, 1, |v| v))
        .collect();
    let opacity = values(Plane::OPACITY, 1, sigmoid);
    let scale = values(Plane::LOG_SCALE, 3, |v| {
        v.clamp(LOG_SCALE[0], LOG_SCALE[1]).exp()
    });
    let (count, degree) = (splats.len(), splats.sh_degree());
    let sphere = |s: Sphere| json!({ "center": s.center.to_array(), "radius": s.radius });
    let cameras = file.cameras.map(sphere);
    // As short as single precision has it.
    let short = |v: f32| (f64::from(v) * 1e6).round() / 1e6;
    let background = file.background.map(|color| color.map(short));
    let document = json!({
        "path": path, "gaussians": count, "sh_degree": degree, "anti_aliased": file.anti_aliased, "up": file.up, "cameras": cameras, "background": background, "saturated": file.saturated,
        "quantiles": { "shares": QUANTILES, "x": axes[0], "y": axes[1], "z": axes[2], "opacity": opacity, "scale": scale },
    });
    let words = |values: &[f64]| {
        let all = values.iter().map(|v| format!("{v:.4}"));
        all.collect::<Vec<_>>().join("  ")
    };
    let filter = match file.anti_aliased {
        true => "anti-aliased: to be rendered with the 2D filter",
        false => "not anti-aliased",
    };
    let mut lines = vec![format!(
        "{}: {count} Gaussians, SH degree {degree}, {filter}",
        path.display()
    )];
    if let Some(Sphere { center, radius }) = file.cameras {
        lines.push(format!("cameras: within {radius:.4} of {center:.4}"));
    }
    if let Some([r, g, b]) = file.background {
        lines.push(format!(
            "background: {r}, {g}, {b}, which a shell of further Gaussians shows to other programs"
        ));
    }
    lines.push("least, 5 %, median, 95 %, largest of".to_owned());
    let rows = [("x", &axes[0]), ("y", &axes[1]), ("z", &axes[2])];
    let rows = rows
        .into_iter()
        .chain([("opacity", &opacity), ("scale", &scale)]);
    lines.extend(rows.map(|(name, values)| format!("  {name:<8} {}", words(values))));
    Ok((document, lines))
}
