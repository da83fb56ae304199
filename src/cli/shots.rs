//! Views that `mhsplat render` shows: those of a dataset, a circle, or a path.

use std::path::{Path, PathBuf};

use glam::{DQuat, DVec3};
use serde::Deserialize;

use crate::cli::scene::{Loaded, PhotoOptions};
use crate::cli::{output, scene};
use mhsplat::base::error::{Error, Result};
use mhsplat::base::files;
use mhsplat::capture::{Camera, Frame, Needed, PhotoSource, View, up_axis};
use mhsplat::config::from_json;
use mhsplat::run::RunRecord;
use mhsplat::scene::orbit::{fov_of, look_at};
use mhsplat::scene::{Keyframe, Ring, Trajectory};

/// Frames of a path along the dataset's cameras.
const FRAMES: u32 = 120;

/// Frames of a path or an orbit at most.
const MOST_FRAMES: u32 = 100_000;

/// Size of images that no photo suggests, pixels.
const SIZE: [u32; 2] = [640, 480];

/// Frames per second unless others are asked for.
const RATE: u32 = 30;

/// Largest side of an image, pixels.
const LARGEST: u32 = 65_536;

fn vector(text: &str) -> std::result::Result<DVec3, String> {
    let numbers: Vec<f64> = text
        .split(',')
        .map(|number| output::finite(number.trim()))
        .collect::<std::result::Result<_, _>>()
        .map_err(|_| "X,Y,Z expected, three numbers")?;
    match numbers[..] {
        [x, y, z] => Ok(DVec3::new(x, y, z)),
        _ => Err("X,Y,Z expected, three numbers".into()),
    }
}

fn degrees(text: &str) -> std::result::Result<f64, String> {
    match output::finite(text) {
        Ok(v) if (0.1..=175.0).contains(&v) => Ok(v),
        _ => Err("0.1 to 175 degrees expected".into()),
    }
}

/// Options that say which views to render.
#[derive(clap::Args)]
pub struct ShotOptions {
    /// Dataset of the scene (default: the run's). Alone it asks for its held-out views, all views if none is held out.
    #[arg(long)]
    dataset: Option<PathBuf>,
    /// Render the held-out views of the dataset, all views if none is held out.
    #[arg(long, conflicts_with_all = ["orbit", "path", "frames"])]
    held_out: bool,
    /// Render N views on a circle within the cameras of the dataset; of a PLY file alone, around the scene.
    #[arg(long, value_name = "N", conflicts_with_all = ["path", "frames"], value_parser = clap::value_parser!(u32).range(1..=i64::from(MOST_FRAMES)))]
    orbit: Option<u32>,
    /// Render a path through keyframes: position, look_at or rotation, fov, time.
    #[arg(long, value_name = "FILE.json")]
    path: Option<PathBuf>,
    /// Number of frames of the path [default: 120 along the dataset's cameras, --fps times its seconds for --path].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(MOST_FRAMES)))]
    frames: Option<u32>,
    /// Frames per second of --path and --video [default: 30]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1000))]
    fps: Option<u32>,
    /// Width of images of an orbit or a path, pixels [default: the photos']
    #[arg(long, value_name = "PX", value_parser = clap::value_parser!(u32).range(1..=i64::from(LARGEST)))]
    width: Option<u32>,
    /// Height of images of an orbit or a path, pixels [default: the photos']
    #[arg(long, value_name = "PX", value_parser = clap::value_parser!(u32).range(1..=i64::from(LARGEST)))]
    height: Option<u32>,
    /// Horizontal field of view of an orbit or a path, degrees, before that of the path's file [default: the photos']
    #[arg(long, value_name = "DEG", value_parser = degrees)]
    fov: Option<f64>,
    /// Centre of the orbit, which it looks at, in the dataset's units.
    #[arg(long, value_name = "X,Y,Z", value_parser = vector, requires = "orbit", allow_hyphen_values = true)]
    center: Option<DVec3>,
    /// Radius of the orbit, in the dataset's units.
    #[arg(long, value_name = "R", value_parser = output::depth, requires = "orbit")]
    radius: Option<f64>,
    /// Height of the orbit over its centre, in the dataset's units.
    #[arg(long, value_name = "H", value_parser = output::finite, requires = "orbit")]
    orbit_height: Option<f64>,
    /// Direction that is up for --orbit and --path, in the dataset's frame, before that of the path's file [default: that to which the cameras' x axes are most nearly
    /// perpendicular]
    #[arg(long, value_name = "X,Y,Z", value_parser = vector, allow_hyphen_values = true)]
    up: Option<DVec3>,
}

/// A view to render: its name, camera and photo.
pub type Job = (String, Camera, Option<PhotoSource>);

/// Kind of views that is asked for.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Views,
    Orbit(u32),
    Path,
}

impl ShotOptions {
    /// Frames per second.
    pub fn rate(&self) -> u32 {
        self.fps.unwrap_or(RATE)
    }

    /// Refuses a number of frames per second where nothing has seconds.
    pub fn check_rate(&self, video: bool) -> Result<()> {
        let timed = video || (self.path.is_some() && self.frames.is_none());
        match self.fps {
            Some(_) if !timed => Err(Error::config(
                "--fps",
                "images have no time; give --video, or --path without --frames, or leave it out",
            )),
            _ => Ok(()),
        }
    }

    /// Refuses options that would have no effect on views of a kind.
    fn check(&self, kind: Kind) -> Result<()> {
        let photos = kind == Kind::Views;
        let along = kind == Kind::Path && self.path.is_none();
        let refused = [
            ("--width", photos && self.width.is_some()),
            ("--height", photos && self.height.is_some()),
            ("--fov", photos && self.fov.is_some()),
            ("--up", (photos || along) && self.up.is_some()),
        ];
        let Some((name, _)) = refused.into_iter().find(|(_, refused)| *refused) else {
            return Ok(());
        };
        let what = match photos {
            true => {
                "the views of a dataset are those of its photos (--max-size: how large); give --orbit or --path, or leave it out"
            }
            false => {
                "a path along the dataset's cameras is turned as they are; give --orbit or --path, or leave it out"
            }
        };
        Err(Error::config(name, what))
    }
}

/// Views to render, as far as they are known before the scene is.
pub struct Shots<'a> {
    options: &'a ShotOptions,
    kind: Kind,
    /// Frame of the dataset; the identity without one.
    pub frame: Frame,
    cameras: Vec<Camera>,
    views: Vec<View>,
    file: Option<PathFile>,
}

/// Keyframes of a path, with the defaults for all of them.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PathFile {
    /// Direction that is up, unless the command line says another.
    up: Option<[f64; 3]>,
    /// Horizontal field of view, degrees.
    fov: Option<f64>,
    keyframes: Vec<KeyframeEntry>,
}

/// A keyframe in the dataset's frame.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct KeyframeEntry {
    /// Seconds; a second after the one before it if absent.
    time: Option<f64>,
    position: [f64; 3],
    look_at: Option<[f64; 3]>,
    /// Quaternion w, x, y, z from the dataset's frame to the camera's (x right, y down, z forward), as COLMAP has it.
    rotation: Option<[f64; 4]>,
    /// Horizontal field of view, degrees.
    fov: Option<f64>,
}

impl<'a> Shots<'a> {
    /// Finds out what is asked for, and reads the dataset or its cameras where they are needed; `photos` if each view needs its photo.
    ///
    /// # Errors
    /// Nothing that says which views; a dataset or a file that cannot be read.
    pub fn new(
        options: &'a ShotOptions,
        photos: bool,
        record: Option<&RunRecord>,
        how: &PhotoOptions,
    ) -> Result<Self> {
        let along = options.path.is_some() || options.frames.is_some();
        let kind = match options.orbit {
            Some(n) => Kind::Orbit(n),
            None if along => Kind::Path,
            None if options.held_out || photos || options.dataset.is_some() => Kind::Views,
            None => Kind::Path,
        };
        if photos && kind != Kind::Views {
            return Err(Error::config(
                "--what error",
                "a photo to compare with is needed; leave --orbit, --path and --frames out",
            ));
        }
        options.check(kind)?;
        let mut shots = Self {
            options,
            kind,
            frame: Frame::IDENTITY,
            cameras: Vec::new(),
            views: Vec::new(),
            file: options.path.as_deref().map(read_path).transpose()?,
        };
        let path = scene::dataset_path(
            options.dataset.as_deref(),
            record,
            "give --dataset with the folder of the photos, --path FILE.json, or --orbit N",
        );
        let optional = shots.file.is_some() || matches!(kind, Kind::Orbit(_));
        let path = match path {
            Err(_) if optional && options.dataset.is_none() => return Ok(shots),
            path => path?,
        };
        if kind == Kind::Views {
            let data = scene::dataset(&path, record, how, Needed::HeldOut)?;
            shots.frame = data.frame;
            shots.views = match data.test.is_empty() {
                true => data.train,
                false => data.test,
            };
        } else {
            (shots.frame, shots.cameras) = scene::cameras(&path, record, how)?;
        }
        Ok(shots)
    }

    /// The views in their order; `loaded` for a circle around a scene without cameras.
    ///
    /// # Errors
    /// Keyframes that make no path; a failing device.
    pub fn jobs(self, loaded: &Loaded) -> Result<Vec<Job>> {
        let named = |cameras: Vec<Camera>, stem: &str| {
            let each = cameras.into_iter().enumerate();
            each.map(|(k, camera)| (format!("{stem}_{k:04}"), camera, None))
                .collect()
        };
        let size = self.size()?;
        match (self.kind, &self.file) {
            (Kind::Views, _) => {
                let job = |v: View| (v.name, v.camera, Some(v.photo));
                Ok(self.views.into_iter().map(job).collect())
            }
            (Kind::Orbit(n), _) => Ok(named(self.orbit(loaded, n, size)?, "orbit")),
            (Kind::Path, Some(file)) => {
                let path = self.through(file, loaded)?;
                let frames = self.frames_of(&path)?;
                Ok(named(path.cameras(frames, size), "frame"))
            }
            (Kind::Path, None) => {
                let frames = self.options.frames.unwrap_or(FRAMES);
                let path = Trajectory::along(&self.cameras, self.fov(), frames as usize)?;
                if path.is_none() {
                    output::note(
                        "the names of the photos are in no order of capture: an orbit in the place of a path along them",
                    );
                }
                let cameras = match path {
                    Some(path) => path.cameras(frames, size),
                    None => self.orbit(loaded, frames, size)?,
                };
                Ok(named(cameras, "frame"))
            }
        }
    }

    /// Name pattern of the images as FFmpeg has it; `None` for the views of a dataset, which are no sequence.
    pub fn pattern(&self) -> Option<&'static str> {
        match self.kind {
            Kind::Views => None,
            Kind::Orbit(_) => Some("orbit_%04d.png"),
            Kind::Path => Some("frame_%04d.png"),
        }
    }

    /// Width and height of images: those given, in the shape of the first photo where one is not.
    fn size(&self) -> Result<[u32; 2]> {
        let own = self.cameras.first().map_or(SIZE, |c| [c.width, c.height]);
        let [w, h] = own.map(f64::from);
        let other = |side: f64| (side.round() as u32).clamp(1, LARGEST);
        Ok(match (self.options.width, self.options.height) {
            (None, None) => own,
            (Some(width), None) => [width, other(f64::from(width) * h / w)],
            (None, Some(height)) => [other(f64::from(height) * w / h), height],
            (Some(width), Some(height)) => [width, height],
        })
    }

    fn fov(&self) -> f64 {
        let asked = self.options.fov.map(f64::to_radians);
        asked.unwrap_or_else(|| fov_of(&self.cameras))
    }

    /// Frames of a path through keyframes: those asked for, else one for every step of its seconds.
    fn frames_of(&self, path: &Trajectory) -> Result<u32> {
        let frames = (path.duration() * f64::from(self.options.rate())).round() + 1.0;
        match self.options.frames {
            Some(frames) => Ok(frames),
            None if frames <= f64::from(MOST_FRAMES) => Ok(frames as u32),
            None => {
                let seconds = path.duration();
                let what = format!(
                    "its {seconds} s have more than {MOST_FRAMES} frames; give --frames, a smaller --fps, or a path of shorter times"
                );
                Err(Error::config("--path", what))
            }
        }
    }

    /// Unit vector that is asked for to be up.
    fn up(&self) -> Result<Option<DVec3>> {
        self.options.up.map(|up| unit("--up", up)).transpose()
    }

    /// The circle within the cameras, without them around the scene, upright as its file says if it does.
    fn ring(&self, loaded: &Loaded) -> Result<Ring> {
        if let Some(ring) = Ring::inside(&self.cameras) {
            return Ok(ring);
        }
        let [x, y, z] = [0, 1, 2].map(|k| loaded.scene.plane(k));
        let around = Ring::around([&x?, &y?, &z?]);
        Ok(Ring {
            up: loaded.up.unwrap_or(around.up),
            ..around
        })
    }

    fn orbit(&self, loaded: &Loaded, n: u32, size: [u32; 2]) -> Result<Vec<Camera>> {
        let mut ring = self.ring(loaded)?;
        let scale = self.frame.scale;
        ring.up = self.up()?.unwrap_or(ring.up);
        if let Some(center) = self.options.center {
            ring.center = self.frame.to_local(center);
            ring.target = ring.center;
        }
        ring.radius = self.options.radius.map_or(ring.radius, |r| r / scale);
        ring.height = self.options.orbit_height.map_or(ring.height, |h| h / scale);
        Ok(ring.cameras(n, size, self.fov()))
    }

    /// The path through the keyframes of a file.
    fn through(&self, file: &PathFile, loaded: &Loaded) -> Result<Trajectory> {
        let own = match self.cameras.is_empty() {
            true => self.ring(loaded)?.up,
            false => up_axis(&self.cameras),
        };
        let of_file = file.up.map(|up| unit("up", DVec3::from_array(up)));
        let up = self.up()?.or(of_file.transpose()?).unwrap_or(own);
        let mut keyframes: Vec<Keyframe> = Vec::with_capacity(file.keyframes.len());
        for (k, entry) in file.keyframes.iter().enumerate() {
            let eye = DVec3::from_array(entry.position);
            let rotation = match (entry.look_at, entry.rotation) {
                (Some(target), None) => {
                    DQuat::from_mat3(&look_at(eye, DVec3::from_array(target), up))
                }
                (None, Some([w, x, y, z])) => DQuat::from_xyzw(x, y, z, w),
                _ => {
                    let what = "one of look_at and rotation expected";
                    return Err(Error::config(format!("keyframes[{k}]"), what));
                }
            };
            let next = keyframes.last().map_or(0.0, |before| before.time + 1.0);
            let fov = self.options.fov.or(entry.fov).or(file.fov);
            keyframes.push(Keyframe {
                time: entry.time.unwrap_or(next),
                position: self.frame.to_local(eye),
                rotation,
                fov: fov.map_or_else(|| self.fov(), f64::to_radians),
            });
        }
        Trajectory::new(&keyframes)
    }
}

fn unit(name: &str, up: DVec3) -> Result<DVec3> {
    let zero = || Error::config(name, "a direction expected, not 0,0,0");
    up.try_normalize().ok_or_else(zero)
}

fn read_path(file: &Path) -> Result<PathFile> {
    let bytes = files::read_text(file)?;
    let text = String::from_utf8_lossy(&bytes);
    from_json(&text).map_err(|what| {
        let fix = "see docs/guide/viewing.md for the keys: keyframes of position, look_at or rotation, fov and time";
        Error::input(file, what, fix)
    })
}
