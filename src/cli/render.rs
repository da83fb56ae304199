//! `mhsplat render`.

use std::collections::{BTreeMap, HashSet};
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use clap::ValueEnum;
use image::ImageFormat;
use serde_json::json;

use crate::cli::common::{Common, DeviceOption, Outcome};
use crate::cli::scene::Loaded;
use crate::cli::shots::{Job, ShotOptions, Shots};
use crate::cli::{output, scene, signals};
use mhsplat::base::error::{Error, Result};
use mhsplat::base::files;
use mhsplat::capture::{Camera, PhotoSource};
use mhsplat::pipeline::forward::{Quantity, RenderOptions, to_byte};
use mhsplat::run::report::gallery::error_map;

/// Steps of depth in each 16-bit image.
const DEPTHS_FILE: &str = "depth.json";

/// Quantity that is written.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum What {
    /// View-dependent colour.
    Color,
    /// Mean depth along the viewing axis, 16 bits; depth.json has the units of a step of each image.
    Depth,
    /// Opacity.
    Alpha,
    /// Difference to the photo, within its mask (held-out views).
    Error,
}

/// Arguments of `mhsplat render`.
#[derive(clap::Args)]
pub struct RenderArgs {
    /// Scene: a file (PLY, compressed PLY, SPZ, SOG, .splat, .glb) or a run folder. Without --dataset, --held-out, --orbit or --path the views of a run are a smooth path along
    /// the cameras of its dataset.
    scene: PathBuf,
    /// Folder for the PNG files; must not exist.
    #[arg(short, long)]
    output: PathBuf,
    /// Quantity to render.
    #[arg(long, value_enum, default_value = "color")]
    what: What,
    #[command(flatten)]
    shots: ShotOptions,
    #[command(flatten)]
    photos: scene::PhotoOptions,
    /// Encode the images of an orbit or a path as a video, too, with the program ffmpeg; must not exist.
    #[arg(long, value_name = "FILE.mp4")]
    video: Option<PathBuf>,
    /// black, white or R,G,B (the run's, else the scene file's, else black).
    #[arg(long)]
    background: Option<String>,
    #[command(flatten)]
    device: DeviceOption,
}

/// Images written, and of depth images the depth that one step stands for, by name of the file.
#[derive(Default)]
struct Written {
    images: Vec<PathBuf>,
    steps: BTreeMap<String, f64>,
}

/// Renders views to PNG files.
pub fn run(args: &RenderArgs, common: &Common) -> Result<Outcome> {
    let (ply, record) = scene::locate(&args.scene)?;
    for path in [Some(&args.output), args.video.as_ref()]
        .into_iter()
        .flatten()
    {
        if path.exists() {
            let fix = "choose another name for it";
            return Err(Error::input(
                path,
                "exists already; nothing is overwritten",
                fix,
            ));
        }
    }
    let background = scene::background(args.background.as_deref(), record.as_ref())?;
    let compared = args.what == What::Error;
    args.shots.check_rate(args.video.is_some())?;
    let shots = Shots::new(&args.shots, compared, record.as_ref(), &args.photos)?;
    let video = match (&args.video, shots.pattern()) {
        (None, _) => None,
        (Some(file), Some(pattern)) => {
            check_encoder(args.what)?;
            Some((video_path(file, &args.output)?, pattern))
        }
        (Some(_), None) => {
            let what = "the views of a dataset are no film; render an orbit or a path";
            return Err(Error::config("--video", what));
        }
    };
    let frame = shots.frame;
    let mut loaded = scene::open(&ply, &frame, &args.device)?;
    let background = background.unwrap_or(loaded.background);
    let jobs = shots.jobs(&loaded)?;
    let written = write_all(args, &mut loaded, background, &jobs, frame.scale)?;
    if let Some((file, pattern)) = video {
        encode(&args.output, pattern, args.shots.rate(), &file)?;
    }
    if common.json {
        output::json(&json!({
            "images": written.images, "video": args.video, "depth_steps": written.steps,
        }))?;
        return Ok(Outcome::Done);
    }
    let (count, folder) = (written.images.len(), args.output.display());
    output::line(&format!("{count} images in {folder}"));
    if let Some(file) = &args.video {
        output::line(&format!("video: {}", file.display()));
    }
    Ok(Outcome::Done)
}

/// Absolute path of a video; refuses one that could not be written once the images are in their folder.
fn video_path(file: &Path, images: &Path) -> Result<PathBuf> {
    let absolute = |path: &Path| std::path::absolute(path).map_err(|e| Error::io(path, e));
    let (whole, images) = (absolute(file)?, absolute(images)?);
    let fix = "give --video a file name in a folder that is there, or make that folder";
    let refused = |what: &str| Err(Error::input(file, what, fix));
    if whole == images {
        return refused("is the folder of the images, and cannot be the video, too");
    }
    match whole.parent() {
        Some(folder) if whole.file_name().is_some() && (folder == images || folder.is_dir()) => {
            Ok(whole)
        }
        _ => refused("the folder of the video does not exist"),
    }
}

/// Refuses to begin what could not be ended.
fn check_encoder(what: What) -> Result<()> {
    if what == What::Depth {
        let what = "depth images have 16 bits, which no video has; render them without --video";
        return Err(Error::config("--video", what));
    }
    let version = Command::new("ffmpeg")
        .arg("-version")
        .stdin(Stdio::null())
        .output();
    match version {
        Ok(output) if output.status.success() => Ok(()),
        _ => Err(Error::config(
            "--video",
            "the program ffmpeg is not on the path; install it (Debian, Ubuntu: `apt-get install ffmpeg`), or leave --video out and encode the PNG files elsewhere",
        )),
    }
}

/// Encodes numbered images of a folder as H.264, or whatever the ending of the file, an absolute path, asks for; the file is there as
/// a whole or not at all.
fn encode(folder: &Path, pattern: &str, fps: u32, file: &Path) -> Result<()> {
    // FFmpeg tells the format by the ending.
    let mut name = OsString::from(format!(".{}.", std::process::id()));
    name.push(file.file_name().unwrap_or_default());
    let partial = file.with_file_name(name);
    let mut command = Command::new("ffmpeg");
    command.args(["-v", "error", "-n", "-framerate", &fps.to_string(), "-i"]);
    // From within the folder: a % in its name would be part of the pattern.
    command.arg(pattern).current_dir(folder);
    // Players want even sizes and this form of colour.
    let even = "pad=ceil(iw/2)*2:ceil(ih/2)*2,format=yuv420p";
    command.args(["-vf", even]).arg(&partial);
    command.stdin(Stdio::null()).stdout(Stdio::null());
    let child = signals::spawn(command.stderr(Stdio::piped()));
    let ended = child.and_then(Child::wait_with_output);
    let ended = ended.map_err(|e| Error::io("ffmpeg", e))?;
    if !ended.status.success() {
        let _ = std::fs::remove_file(&partial);
        let said = String::from_utf8_lossy(&ended.stderr);
        let what = format!("ffmpeg failed: {}", said.trim().replace('\n', " "));
        let fix = "the PNG files are there: encode them by hand, or give a name that ends in .mp4";
        return Err(Error::input(file, what, fix));
    }
    std::fs::rename(&partial, file).map_err(|e| Error::io(file, e))
}

/// Renders every job into a file of its own; `scale` units of the dataset are one of the local frame.
fn write_all(
    args: &RenderArgs,
    loaded: &mut Loaded,
    background: [f32; 3],
    jobs: &[Job],
    scale: f64,
) -> Result<Written> {
    std::fs::create_dir_all(&args.output).map_err(|e| Error::io(&args.output, e))?;
    let mut written = Written::default();
    let mut taken = HashSet::new();
    for (name, camera, photo) in jobs {
        let file = free_name(&mut taken, &file_stem(name));
        let path = args.output.join(&file);
        let (w, h) = (camera.width, camera.height);
        let saved = match args.what {
            What::Depth => {
                let (depths, step) = depths(loaded, camera, scale)?;
                written.steps.insert(file, step);
                let bytes: Vec<u8> = depths.iter().flat_map(|d| d.to_ne_bytes()).collect();
                image::save_buffer(&path, &bytes, w, h, image::ColorType::L16)
            }
            what => {
                let rgb = pixels(what, loaded, camera, background, photo.as_ref())?;
                image::save_buffer(&path, &rgb, w, h, image::ColorType::Rgb8)
            }
        };
        saved.map_err(|e| Error::input(&path, e.to_string(), "choose another folder with -o"))?;
        written.images.push(path);
    }
    if !written.steps.is_empty() {
        let text = serde_json::to_string_pretty(&written.steps);
        let text = text.map_err(|e| Error::numerics(DEPTHS_FILE, e))?;
        files::write_bytes(&args.output.join(DEPTHS_FILE), text.as_bytes())?;
    }
    Ok(written)
}

/// A name that no view before has, of two views whose names differ only in folder or ending.
fn free_name(taken: &mut HashSet<String>, stem: &str) -> String {
    let (mut file, mut number) = (format!("{stem}.png"), taken.len());
    while !taken.insert(file.clone()) {
        file = format!("{stem}.{number}.png");
        number += 1;
    }
    file
}

/// A view's name without the ending of an image, as part of a file's.
fn file_stem(view: &str) -> String {
    let ending = Path::new(view).extension();
    let stem = match ending.and_then(ImageFormat::from_extension) {
        Some(_) => Path::new(view).with_extension(""),
        None => PathBuf::from(view),
    };
    let flat: String = stem
        .to_string_lossy()
        .chars()
        .map(|c| match c {
            c if c.is_alphanumeric() || "-_.".contains(c) => c,
            _ => '_',
        })
        .collect();
    flat.trim_start_matches(['.', '_']).to_owned()
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
    let image = loaded.renderer.image(&loaded.scene, camera, &options)?;
    Ok(match (what, photo) {
        (What::Error, Some(photo)) => {
            let photo = photo.load()?;
            error_map(&photo.counted(image.rgb8()), &photo.rgb_over(background))?
        }
        (What::Error, None) => error_map(&image.rgb8(), &image.rgb8())?,
        (What::Alpha, _) => grey(image.transmittance.iter().map(|t| 1.0 - t)),
        (What::Color | What::Depth, _) => image.rgb8(),
    })
}

fn grey(values: impl Iterator<Item = f32>) -> Vec<u8> {
    values.flat_map(|v| [to_byte(v); 3]).collect()
}

/// Mean depth of a view along its axis in 16 bits, 0 where little is drawn, and the depth that one step stands for, in the dataset's units:
/// the largest has the highest number.
fn depths(loaded: &mut Loaded, camera: &Camera, scale: f64) -> Result<(Vec<u16>, f64)> {
    let options = RenderOptions {
        sh_degree: loaded.scene.sh_degree,
        background: [0.0; 3],
        quantity: Quantity::Depth,
        active_only: false,
    };
    let image = loaded.renderer.image(&loaded.scene, camera, &options)?;
    let depths = image.mean_depths();
    let largest = depths.iter().fold(0.0f64, |l, d| l.max(*d));
    let step = match largest * scale / f64::from(u16::MAX) {
        step if step.is_normal() => step,
        _ => 1.0,
    };
    let number = |d: f64| (d * scale / step).round() as u16;
    Ok((depths.into_iter().map(number).collect(), step))
}

#[cfg(test)]
mod tests {
    use super::{file_stem, free_name};
    use std::collections::HashSet;

    #[test]
    fn every_view_has_a_file_of_its_own() {
        let mut taken = HashSet::new();
        let views = [
            "shot.2.png",
            "shot.jpg",
            "shot.png",
            "a/r.1",
            "a/r.10",
            "a_r.1.webp",
        ];
        let files = views.map(|view| free_name(&mut taken, &file_stem(view)));
        let expected = ["shot.2", "shot", "shot.3", "a_r.1", "a_r.10", "a_r.1.5"];
        assert_eq!(files, expected.map(|stem| format!("{stem}.png")));
    }
}
