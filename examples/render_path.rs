//! Renders a scene along a path to numbered PNG files: `cargo run --release --example render_path -- run/scene.ply frames 48`

use std::path::Path;

use mhsplat::device::Defines;
use mhsplat::pipeline::buffers::GaussianBuffers;
use mhsplat::pipeline::forward::RenderOptions;
use mhsplat::scene::orbit::usual_fov;
use mhsplat::scene::{Keyframe, Plane, Ring, Trajectory, formats};
use mhsplat::{Camera, Device, Renderer, capture::Frame};

type Outcome = Result<(), Box<dyn std::error::Error>>;

/// Cameras on an arc around the middle of the scene, which comes nearer.
const KEYS: u32 = 5;

/// A path through the first half of a circle, from twice the distance to the circle itself.
fn path(around: &Ring, size: [u32; 2]) -> mhsplat::Result<Trajectory> {
    let cameras = around.cameras(2 * KEYS, size, usual_fov());
    let keyframe = |(k, camera): (usize, &Camera)| {
        let nearer = 2.0 - k as f64 / f64::from(KEYS - 1);
        Keyframe {
            time: k as f64,
            position: around.target + nearer * (camera.center() - around.target),
            rotation: glam::DQuat::from_mat3(&camera.rotation),
            fov: usual_fov(),
        }
    };
    let keys: Vec<Keyframe> = cameras[..KEYS as usize]
        .iter()
        .enumerate()
        .map(keyframe)
        .collect();
    Trajectory::new(&keys)
}

/// Writes `frames` pictures of a scene file of any format to a new folder.
pub fn render_path(scene: &str, folder: &str, frames: u32) -> Outcome {
    let file = formats::read(scene.as_ref(), &Frame::IDENTITY)?;
    let splats = &file.splats;
    let size = [640, 480];
    let axes = [0, 1, 2].map(|k| &splats.planes()[Plane::POSITION + k][..]);
    let path = path(&Ring::around(axes), size)?;

    let device = Device::open(None)?;
    let defines = Defines {
        anti_alias: file.anti_aliased,
        ..Defines::new(device.tuning())
    };
    let mut renderer: Renderer = Renderer::new(&device, defines, splats.sh_degree(), false)?;
    let mut gaussians = GaussianBuffers::upload(&device, splats, 0)?;
    if file.anti_aliased {
        gaussians = gaussians.with_filter(&device)?;
    }
    let options = RenderOptions {
        sh_degree: splats.sh_degree(),
        ..RenderOptions::default()
    };
    std::fs::create_dir(folder)?;
    for (k, camera) in path.cameras(frames, size).iter().enumerate() {
        let picture = renderer.image(&gaussians, camera, &options)?;
        let rgb = image::RgbImage::from_raw(size[0], size[1], picture.rgb8()).ok_or("no pixels")?;
        rgb.save(Path::new(folder).join(format!("frame-{k:04}.png")))?;
    }
    Ok(())
}

fn main() -> Outcome {
    let args: Vec<String> = std::env::args().collect();
    match &args[1..] {
        [scene, folder, frames] => render_path(scene, folder, frames.parse()?),
        _ => Err("give SCENE FOLDER FRAMES".into()),
    }
}
