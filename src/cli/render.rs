//! `mhsplat render`.

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use glam::{DMat3, DVec3};
use mhsplat::dataset::{Camera, Dataset, Frame, PhotoSource};
use mhsplat::error::{Error, Result};
use mhsplat::render::{Quantity, RenderOptions, Rendered, Renderer, to_byte};
use mhsplat::report::error_map;
use serde_json::json;

use super::scene::Loaded;
use super::{Common, Outcome, output, scene};

/// What is written.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum What {
    /// View-dependent colour.
    Color,
    /// Mean depth, near bright.
    Depth,
    /// Opacity.
    Alpha,
    /// Difference to the photo (needs --dataset).
    Error,
}

/// Arguments.
#[derive(clap::Args)]
pub struct RenderArgs {
    /// Scene: a PLY file or a run folder.
    scene: PathBuf,
    /// Render the dataset's held-out views (all views where none is held out).
    #[arg(long, required_unless_present = "orbit", conflicts_with = "orbit")]
    dataset: Option<PathBuf>,
    /// Render N views on a circle around the scene.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    orbit: Option<u32>,
    /// Folder for the PNG files; must not exist.
    #[arg(short, long)]
    output: PathBuf,
    /// What to render.
    #[arg(long, value_enum, default_value = "color")]
    what: What,
    /// Longest image side, pixels (the run's, else 1600).
    #[arg(long)]
    max_size: Option<u32>,
    /// Width of orbit images, pixels.
    #[arg(long, default_value_t = 640, value_parser = clap::value_parser!(u32).range(1..=65536))]
    width: u32,
    /// Height of orbit images, pixels.
    #[arg(long, default_value_t = 480, value_parser = clap::value_parser!(u32).range(1..=65536))]
    height: u32,
    /// black, white or R,G,B (the run's, else black).
    #[arg(long)]
    background: Option<String>,
}

/// A view to render: name, camera, and its photo.
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
    let (frame, jobs) = match &args.dataset {
        Some(path) => {
            let data = scene::dataset(path, record.as_ref(), args.max_size, None)?;
            (data.frame, dataset_jobs(data))
        }
        None if args.what == What::Error => {
            return Err(Error::config(
                "--what error",
                "a photo to compare with is needed; give --dataset",
            ));
        }
        None => (Frame::IDENTITY, Vec::new()),
    };
    let mut loaded = scene::open(&ply, &frame, common.device.as_deref())?;
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
            // Two views whose names differ in folder or ending alone.
            file = file
                .with_extension("")
                .with_extension(format!("{}.png", taken.len()));
        }
        let path = args.output.join(file);
        image::save_buffer(
            &path,
            &rgb,
            camera.width,
            camera.height,
            image::ColorType::Rgb8,
        )
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
        .map(|c| {
            if c.is_alphanumeric() || "-_.".contains(c) {
                c
            } else {
                '_'
            }
        })
        .collect();
    PathBuf::from(format!("{}.png", flat.trim_start_matches(['.', '_'])))
}

fn dataset_jobs(data: Dataset) -> Vec<Job> {
    let views = if data.test.is_empty() {
        data.train
    } else {
        data.test
    };
    views
        .into_iter()
        .map(|v| (v.name, v.camera, Some(v.photo)))
        .collect()
}

/// A circle around the median of the Gaussians, in the plane in which they extend most, at 2.5 times their spread.
fn orbit_jobs(loaded: &Loaded, n: u32, width: u32, height: u32) -> Result<Vec<Job>> {
    let axes: Vec<Vec<f32>> = (0..3)
        .map(|k| loaded.scene.plane(k))
        .collect::<Result<_>>()?;
    let quantile = |k: usize, q: f64| {
        let mut v = axes[k].clone();
        v.sort_by(f32::total_cmp);
        f64::from(
            v.get(((v.len().max(1) - 1) as f64 * q) as usize)
                .copied()
                .unwrap_or(0.0),
        )
    };
    let center = DVec3::new(quantile(0, 0.5), quantile(1, 0.5), quantile(2, 0.5));
    let spread = DVec3::from_array(std::array::from_fn(|k| quantile(k, 0.9) - quantile(k, 0.1)));
    let up_axis = (0..3)
        .min_by(|a, b| spread[*a].total_cmp(&spread[*b]))
        .unwrap_or(1);
    let radius = 1.25 * spread.max_element().max(1e-6);
    // Captures are upright far more often than not; y points down in COLMAP's frames, z up in Blender's.
    let up = if up_axis == 1 {
        -DVec3::Y
    } else {
        DVec3::AXES[up_axis]
    };
    let (u, v) = up.any_orthonormal_pair();
    let focal = f64::from(width) * 0.9;
    Ok((0..n)
        .map(|k| {
            let a = std::f64::consts::TAU * f64::from(k) / f64::from(n.max(1));
            let eye = center + (u * a.cos() + v * a.sin() + up * 0.35) * radius;
            let z = (center - eye).normalize();
            let x = z.cross(up).normalize();
            let rotation = DMat3::from_cols(x, z.cross(x), z).transpose();
            let camera = Camera {
                rotation,
                translation: -(rotation * eye),
                fx: focal,
                fy: focal,
                cx: f64::from(width) / 2.0,
                cy: f64::from(height) / 2.0,
                width,
                height,
            };
            (format!("orbit_{k:04}"), camera, None)
        })
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
    };
    let renderer: &mut Renderer = &mut loaded.renderer;
    match what {
        What::Color => Ok(renderer.image(&loaded.scene, camera, &options)?.rgb8()),
        What::Error => {
            let render = renderer.image(&loaded.scene, camera, &options)?.rgb8();
            match photo {
                Some(photo) => error_map(&render, &photo.load()?.rgb_over(background)),
                None => error_map(&render, &render),
            }
        }
        What::Alpha => {
            let image = renderer.image(&loaded.scene, camera, &options)?;
            Ok(grey(image.transmittance.iter().map(|t| 1.0 - t)))
        }
        What::Depth => {
            let options = RenderOptions {
                background: [0.0; 3],
                quantity: Quantity::Depth,
                ..options
            };
            Ok(depth_image(&renderer.image(
                &loaded.scene,
                camera,
                &options,
            )?))
        }
    }
}

fn grey(values: impl Iterator<Item = f32>) -> Vec<u8> {
    values.flat_map(|v| [to_byte(v); 3]).collect()
}

/// Inverse mean depth scaled to its 99th percentile: near is bright, nothing is black.
fn depth_image(image: &Rendered) -> Vec<u8> {
    let inverse: Vec<f32> = image
        .transmittance
        .iter()
        .zip(&image.rgb)
        .map(|(t, d)| {
            if *d > 0.0 && *t < 0.5 {
                (1.0 - t) / d
            } else {
                0.0
            }
        })
        .collect();
    let mut sorted = inverse.clone();
    sorted.sort_by(f32::total_cmp);
    let top = sorted
        .get(sorted.len() * 99 / 100)
        .copied()
        .unwrap_or(1.0)
        .max(f32::MIN_POSITIVE);
    grey(inverse.into_iter().map(|v| v / top))
}
