//! Composites a small scene with the sizes of a class of GPUs (`gpu`, or `gpu-wide`), forward and backward, and prints how many pairs it has:
//! `cargo run --release --example splat_pairs -- CLASS`. `.ci/gpu-check` counts within it how these kernels use local memory.

use std::io::Write;

use mhsplat::device::tuning::Tuning;
use mhsplat::device::{Array, CameraArg, Defines, Device};
use mhsplat::lab::verify::cases::mild;
use mhsplat::pipeline::backward::Backward;
use mhsplat::pipeline::buffers::GaussianBuffers;
use mhsplat::pipeline::forward::{RenderOptions, Renderer};
use mhsplat::{Error, Result};

fn main() -> Result<()> {
    let case = mild("200 Gaussians, 48x32, SH 0", 200, [48, 32], 0, 5);
    let class = std::env::args().nth(1);
    let sizes = match class.as_deref() {
        Some("gpu") => Tuning::GPU,
        Some("gpu-wide") => Tuning::GPU_WIDE,
        _ => return Err(Error::config("CLASS", "missing: gpu or gpu-wide")),
    };
    // An interpreter of kernels takes its time: few chunks, most of which would be empty.
    let tuning = Tuning { chunks: 2, ..sizes };
    let defines = Defines::new(tuning);
    let device = Device::open(None)?;
    let scene = GaussianBuffers::<f32>::upload(&device, &case.splats, 0)?;
    let camera = CameraArg::new(&case.camera, tuning.tile);
    let mut renderer = Renderer::new(&device, defines, case.sh_degree, true)?;
    renderer.render(&scene, &camera, &RenderOptions::default())?;
    let dimage = Array::from_slice(&device, "dimage", &vec![1.0; 3 * camera.image().plane()])?;
    Backward::new::<f32>(&device, defines)?.splats(&renderer, &dimage)?;
    device.finish()?;
    let pairs = renderer.intersections_per_tile()?;
    let pairs: u32 = pairs.iter().sum();
    writeln!(std::io::stdout(), "{pairs}").map_err(|e| Error::io("standard output", e))
}
