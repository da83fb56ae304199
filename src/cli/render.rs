//! `mhsplat render`.

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use serde_json::json;

use crate::cli::common::{Common, DeviceOption, Outcome};
use crate::cli::scene::Loaded;
use crate::cli::{output, scene};
use mhsplat::base::error::{Error, Result};
use mhsplat::capture::{Camera, Dataset, Frame, PhotoSource, View};
use mhsplat::pipeline::forward::{Quantity, RenderOptions, Rendered, to_byte};
use mhsplat::run::report::gallery::error_map;
use mhsplat::scene::orbit;

/// Quantity that is written.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum What {
    /// View-dependent colour.
    Color,
    /// Mean depth, near bright.
    Depth,
    /// Opacity.
    Alpha,
    /// Difference to the photo, within its mask (needs --dataset).
    Error,
}

/// Arguments of `mhsplat render`.
#[derive(clap::Args)]
pub struct RenderArgs {
    /// Scene: a PLY file or a run folder.
    scene: PathBuf,
    /// Render the held-out views of this dataset, all views if none is held out (default: those of the run's).
    #[arg(long, conflicts_with = "orbit")]
    dataset: Option<PathBuf>,
    /// Render N views on a circle around the scene.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    orbit: Option<u32>,
    /// Folder for the PNG files; must not exist.
    #[arg(short, long)]
    output: PathBuf,
    /// Quantity to render.
    #[arg(long, value_enum, default_value = "color")]
    what: What,
    #[command(flatten)]
    photos: scene::PhotoOptions,
    /// Width of orbit images, pixels.
    #[arg(long, default_value_t = 640, value_parser = clap::value_parser!(u32).range(1..=65536))]
    width: u32,
    /// Height of orbit images, pixels.
    #[arg(long, default_value_t = 480, value_parser = clap::value_parser!(u32).range(1..=65536))]
    height: u32,
    /// black, white or R,G,B (the run's, else black).
    #[arg(long)]
    background: Option<String>,
    #[command(flatten)]
    device: DeviceOption,
}

/// A view to render: its name, camera and photo.
type Job = (String, Camera, Option<PhotoSource>);

/// Renders views to PNG files.
pub fn run(args: &RenderArgs, common: &Common) -> Result<Outcome> {
    let (ply, record) = scene::locate(&args.scene)?;
    if args.output.exists() {
        return Err(Error::input(
            &args.output,
            "exists already; nothing is overwritten",
            "choose another with -o",
        ));
    }
    let background = scene::background(args.background.as_deref(), record.as_ref())?;
    let (frame, jobs) = match args.orbit {
        None => {
            let path = scene::dataset_path(
                args.dataset.as_deref(),
                record.as_ref(),
                "give --dataset with the folder of the photos, or --orbit N",
            )?;
            let data = scene::dataset(&path, record.as_ref(), &args.photos)?;
            (data.frame, dataset_jobs(data))
        }
        Some(_) if args.what == What::Error => {
            return Err(Error::config(
                "--what error",
                "a photo to compare with is needed; give --dataset in the place of --orbit",
            ));
        }
        Some(_) => (Frame::IDENTITY, Vec::new()),
    };
    let mut loaded = scene::open(&ply, &frame, args.device.selector().as_deref())?;
    let jobs = match args.orbit {
        Some(n) => orbit_jobs(&loaded, n, args.width, args.height)?,
        None => jobs,
    };
    let written = write_all(args, &mut loaded, background, &jobs)?;
    if common.json {
        output::json(&json!({ "images": written }))?;
    } else {
        output::line(&format!(
            "{} images in {}",
            written.len(),
            args.output.display()
        ));
    }
    Ok(Outcome::Done)
}

/// Renders every job into a file of its own.
fn write_all(
    args: &RenderArgs,
    loaded: &mut Loaded,
    background: [f32; 3],
    jobs: &[Job],
) -> Result<Vec<PathBuf>> {
    std::fs::create_dir_all(&args.output).map_err(|e| Error::io(&args.output, e))?;
    let mut written = Vec::with_capacity(jobs.len());
    let mut taken = std::collections::HashSet::new();
    for (name, camera, photo) in jobs {
        let rgb = pixels(args.what, loaded, camera, background, photo.as_ref())?;
        let mut file = file_name(name);
        while !taken.insert(file.clone()) {
            // Two views whose names differ only in folder or ending.
            file = file
                .with_extension("")
                .with_extension(format!("{}.png", taken.len()));
        }
        let path = args.output.join(file);
        let (w, h) = (camera.width, camera.height);
        image::save_buffer(&path, &rgb, w, h, image::ColorType::Rgb8)
            .map_err(|e| Error::input(&path, e.to_string(), "choose another folder with -o"))?;
        written.push(path);
    }
    Ok(written)
}

fn file_name(view: &str) -> PathBuf {
    let stem = Path::new(view).with_extension("");
    let flat: String = stem
        .to_string_lossy()
        .chars()
        .map(|c| match c {
            c if c.is_alphanumeric() || "-_.".contains(c) => c,
            _ => '_',
        })
        .collect();
    PathBuf::from(format!("{}.png", flat.trim_start_matches(['.', '_'])))
}

fn dataset_jobs(data: Dataset) -> Vec<Job> {
    let views = match data.test.is_empty() {
        true => data.train,
        false => data.test,
    };
    let job = |v: View| (v.name, v.camera, Some(v.photo));
    views.into_iter().map(job).collect()
}

/// Returns views on a circle around the scene.
fn orbit_jobs(loaded: &Loaded, n: u32, width: u32, height: u32) -> Result<Vec<Job>> {
    let [x, y, z] = [0, 1, 2].map(|k| loaded.scene.plane(k));
    let cameras = orbit([&x?, &y?, &z?], n, [width, height]);
    let named = cameras.into_iter().enumerate();
    Ok(named
        .map(|(k, camera)| (format!("orbit_{k:04}"), camera, None))
        .collect())
}

fn pixels(
    what: What,
    loaded: &mut Loaded,
    camera: &Camera,
    background: [f32; 3],
    photo: Option<&PhotoSource>,
) -> Result<Vec<u8>> {
    let options = RenderOptions {
        sh_degree: loaded.scene.sh_degree,
        background,
        quantity: Quantity::Color,
        active_only: false,
    };
    let options = match what {
        What::Depth => RenderOptions {
            background: [0.0; 3],
            quantity: Quantity::Depth,
            ..options
        },
        _ => options,
    };
    let image = loaded.renderer.image(&loaded.scene, camera, &options)?;
    Ok(match (what, photo) {
        (What::Error, Some(photo)) => {
            let photo = photo.load()?;
            error_map(&photo.counted(image.rgb8()), &photo.rgb_over(background))?
        }
        (What::Error, None) => error_map(&image.rgb8(), &image.rgb8())?,
        (What::Color, _) => image.rgb8(),
        (What::Alpha, _) => grey(image.transmittance.iter().map(|t| 1.0 - t)),
        (What::Depth, _) => depth_image(&image),
    })
}

fn grey(values: impl Iterator<Item = f32>) -> Vec<u8> {
    values.flat_map(|v| [to_byte(v); 3]).collect()
}

/// Inverse mean depth scaled to its 99th percentile: near is bright, nothing is black.
fn depth_image(image: &Rendered) -> Vec<u8> {
    let pixels = image.transmittance.iter().zip(&image.rgb);
    let inverse = pixels.map(|(t, d)| match *d > 0.0 && *t < 0.5 {
        true => (1.0 - t) / d,
        false => 0.0,
    });
    let inverse: Vec<f32> = inverse.collect();
    let mut sorted = inverse.clone();
    sorted.sort_by(f32::total_cmp);
    let top = sorted.get(sorted.len() * 99 / 100).copied();
    let top = top.unwrap_or(1.0).max(f32::MIN_POSITIVE);
    grey(inverse.into_iter().map(|v| v / top))
}
