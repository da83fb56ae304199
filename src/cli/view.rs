//! `mhsplat view`, and the door of `train --view`.

use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::Duration;

use serde_json::json;

use crate::cli::common::{Common, DeviceOption, Outcome};
use crate::cli::scene::{Loaded, PhotoOptions};
use crate::cli::signals::stop_flag;
use crate::cli::{output, scene};
use mhsplat::base::error::Result;
use mhsplat::capture::photo::Photo;
use mhsplat::capture::{Camera, Dataset, Frame, Needed, PhotoSource};
use mhsplat::pipeline::forward::{Quantity, RenderOptions, Rendered};
use mhsplat::run::RunRecord;
use mhsplat::run::live::{Door, LivePage, Scenery, Server};
use mhsplat::run::viewer::{SceneView, scene_views};
use mhsplat::scene::Ring;
use mhsplat::scene::orbit::usual_fov;

/// Cameras around a scene without a dataset.
const AROUND: u32 = 8;

/// Size of the images of those, pixels.
const SIZE: [u32; 2] = [960, 720];

/// Largest side of a picture, pixels.
const LARGEST: u32 = 4096;

/// Tile intersections that a picture may have at most: some 30 bytes each, for room is made for more.
const INTERSECTIONS: u64 = 1 << 28;

/// Bytes of the device's memory for each of them: they may take a quarter of it.
const MEMORY: u64 = 120;

/// Longest time between two looks at signals.
const GLANCE: Duration = Duration::from_millis(200);

/// Arguments of `mhsplat view`.
#[derive(clap::Args)]
pub struct ViewArgs {
    /// Scene: a file (PLY, compressed PLY, SPZ, SOG, .splat, .glb) or a run folder.
    scene: PathBuf,
    /// Port on this machine, 0 for any that is free [default: 7878, or any that is free].
    #[arg(long)]
    port: Option<u16>,
    /// Dataset of the scene, for its cameras and photos (default: the run's).
    #[arg(long)]
    dataset: Option<PathBuf>,
    #[command(flatten)]
    photos: PhotoOptions,
    /// black, white or R,G,B (the run's, else the scene file's, else black).
    #[arg(long)]
    background: Option<String>,
    #[command(flatten)]
    device: DeviceOption,
}

/// A scene, and the photos of its views.
struct Stage {
    loaded: Loaded,
    background: [f32; 3],
    reach: f64,
    /// Cameras and photos in the order of the page.
    photos: Vec<(Camera, PhotoSource)>,
}

impl Scenery for Stage {
    fn render(&mut self, camera: &Camera, quantity: Quantity) -> Result<Rendered> {
        let options = RenderOptions {
            sh_degree: self.loaded.scene.sh_degree,
            background: match quantity {
                Quantity::Color => self.background,
                Quantity::Depth => [0.0; 3],
            },
            quantity,
            active_only: false,
        };
        let Loaded {
            scene,
            renderer,
            device,
            ..
        } = &mut self.loaded;
        let most = INTERSECTIONS.min(device.info().global_memory / MEMORY);
        renderer.image_within(scene, camera, &options, most as usize)
    }

    fn photo(&mut self, view: usize) -> Result<Option<(Camera, Photo)>> {
        let Some((camera, source)) = self.photos.get(view) else {
            return Ok(None);
        };
        Ok(Some((*camera, (*source.load()?).clone())))
    }

    fn background(&self) -> [f32; 3] {
        self.background
    }

    fn reach(&self) -> f64 {
        self.reach
    }
}

/// Shows a scene in a browser until Ctrl-C.
pub fn run(args: &ViewArgs, common: &Common) -> Result<Outcome> {
    let stop = stop_flag();
    let (file, record) = scene::locate(&args.scene)?;
    let background = scene::background(args.background.as_deref(), record.as_ref())?;
    let door = Door::open("--port", args.port)?;
    let data = dataset(args, record.as_ref())?;
    let frame = data.as_ref().map_or(Frame::IDENTITY, |data| data.frame);
    let loaded = scene::open(&file, &frame, &args.device)?;
    let background = background.unwrap_or(loaded.background);
    let (mut views, photos, reach) = match &data {
        Some(data) => {
            let (views, remark) = scene_views(data);
            remark.iter().for_each(|remark| output::note(remark));
            let photos = photos(data, &views);
            (views, photos, 1.0)
        }
        None => {
            let ring = ring(&loaded)?;
            (around(&ring), Vec::new(), ring.radius)
        }
    };
    let scores = record.as_ref().and_then(|r| r.final_scores.as_ref());
    mhsplat::run::viewer::add_scores(&mut views, scores);
    let page = LivePage {
        title: args.scene.display().to_string(),
        views,
        photos: data.is_some(),
        training: false,
        largest: LARGEST,
        gaussians: loaded.scene.count,
        reach,
    };
    announce(&door, common)?;
    let server = Server::start(door, &page)?;
    let mut stage = Stage {
        loaded,
        background,
        reach,
        photos,
    };
    while !stop.load(Ordering::Relaxed) {
        server.attend(&mut stage, GLANCE);
    }
    Ok(Outcome::Done)
}

/// The dataset that is asked for, else the run's, if it is there; photos are read when they are looked at.
fn dataset(args: &ViewArgs, record: Option<&RunRecord>) -> Result<Option<Dataset>> {
    let path = match scene::dataset_path(args.dataset.as_deref(), record, "give --dataset") {
        Err(error) if args.dataset.is_none() => {
            if record.is_some() {
                output::note(&format!(
                    "without photos and cameras: {error} with --dataset"
                ));
            }
            return Ok(None);
        }
        path => path?,
    };
    scene::dataset(&path, record, &args.photos, Needed::None).map(Some)
}

/// Photos of the views that a page lists, in their order.
fn photos(data: &Dataset, views: &[SceneView]) -> Vec<(Camera, PhotoSource)> {
    let mut all = data.test.iter().chain(&data.train);
    let of = |view: &SceneView| {
        let found = all.find(|v| v.name == view.name)?;
        Some((found.camera, found.photo.clone()))
    };
    views.iter().map_while(of).collect()
}

/// A circle around a scene, upright as its file says.
fn ring(loaded: &Loaded) -> Result<Ring> {
    let [x, y, z] = [0, 1, 2].map(|k| loaded.scene.plane(k));
    let around = Ring::around([&x?, &y?, &z?]);
    Ok(Ring {
        up: loaded.up.unwrap_or(around.up),
        ..around
    })
}

/// Cameras around a scene.
fn around(ring: &Ring) -> Vec<SceneView> {
    let cameras = ring.cameras(AROUND, SIZE, usual_fov());
    let view = |(k, camera)| SceneView {
        name: format!("around {}", k + 1),
        camera,
        held_out: false,
        scores: None,
        photo: None,
    };
    cameras.into_iter().enumerate().map(view).collect()
}

/// Parses the port of `train --view`.
pub fn port(text: &str) -> std::result::Result<u16, String> {
    let what = "a port of 0 to 65535 expected; where none is meant, put --view last";
    text.parse().map_err(|_| what.to_owned())
}

/// Name of this machine for others, if it is known.
fn host() -> String {
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname");
    let name = name.unwrap_or_default().trim().to_owned();
    if name.is_empty() { "HOST".into() } else { name }
}

/// Lines that say where the page is.
pub fn lines(door: &Door) -> [String; 2] {
    let (port, host) = (door.port(), host());
    [
        format!("view: {}", door.url()),
        format!("from another machine, first: ssh -L {port}:127.0.0.1:{port} {host}"),
    ]
}

fn announce(door: &Door, common: &Common) -> Result<()> {
    if common.json {
        return output::json(&json!({"url": door.url(), "port": door.port()}));
    }
    lines(door).iter().for_each(|line| output::line(line));
    output::line("Ctrl-C ends it");
    Ok(())
}
