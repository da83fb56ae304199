//! `mhsplat bench --scene`: a scene trained with anti-aliasing is rendered with both filters, the 3D one by the bench's own views.

use mhsplat::capture::Frame;
use mhsplat::device::{CameraArg, Defines, Device};
use mhsplat::lab::bench;
use mhsplat::lab::bench::work::TileWork;
use mhsplat::lab::bench::{Options, scene};
use mhsplat::pipeline::buffers::GaussianBuffers;
use mhsplat::pipeline::forward::{RenderOptions, Renderer};
use mhsplat::scene::{Gaussians, Plane, orbit, ply};

/// The mean number of pairs over the circle of views around a scene, rendered with the 2D filter or without.
fn pairs_of(splats: &Gaussians, anti_alias: bool) -> f64 {
    let device = Device::open(None).unwrap();
    let defines = Defines {
        anti_alias,
        ..Defines::new(device.tuning())
    };
    let mut renderer = Renderer::new(&device, defines, 0, false).unwrap();
    let mut scene = GaussianBuffers::upload(&device, splats, 0).unwrap();
    if anti_alias {
        scene = scene.with_filter(&device).unwrap();
    }
    let [x, y, z] = [0, 1, 2].map(|k| splats.planes()[k].as_slice());
    let cameras = orbit([x, y, z], scene::VIEWS, [800; 2]);
    let pairs = cameras.iter().map(|camera| {
        let camera = CameraArg::<f32>::new(camera, device.tuning().tile);
        renderer
            .render(&scene, &camera, &RenderOptions::default())
            .unwrap();
        TileWork::read(&renderer).unwrap().pairs as f64
    });
    pairs.sum::<f64>() / f64::from(scene::VIEWS)
}

#[test]
fn a_scene_with_anti_aliasing_is_measured_with_it() {
    let dir = tempfile::tempdir().unwrap();
    // Thinner than a pixel, so that the 2D filter dims them and few pixels are left to each.
    let mut splats = scene::cloud(400).with_sh_degree(0).unwrap();
    for plane in Plane::LOG_SCALE..Plane::ROTATION {
        splats.plane_mut(plane).fill((0.9e-3f32).ln());
    }
    splats.plane_mut(Plane::OPACITY).fill(-5.1);
    let measured = |name: &str, filter: &[f32]| {
        let file = dir.path().join(name);
        ply::write_filtered(&file, &splats, filter, &Frame::IDENTITY).unwrap();
        let options = Options {
            scene: Some(file),
            precision: None,
            ..Options::brief(Vec::new())
        };
        let device = Device::open(None).unwrap();
        let record = bench::run(&device, &options, &mut |_| ()).unwrap();
        (record.cases[0].scene.clone(), record.cases[0].pairs as f64)
    };
    let (plain, marked) = (measured("plain.ply", &[]), measured("aa.ply", &[1e-4; 400]));
    let wanted = [pairs_of(&splats, false), pairs_of(&splats, true)];
    println!("pairs {plain:?} and {marked:?}, rendered {wanted:?}");
    assert_eq!(
        (plain.0.as_str(), marked.0.as_str()),
        ("plain.ply", "aa.ply with anti-aliasing")
    );
    assert!((plain.1 - wanted[0]).abs() < 0.01 * wanted[0]);
    assert!((marked.1 - wanted[1]).abs() < 0.1 * wanted[1]);
    assert!((wanted[0] - wanted[1]).abs() > 0.2 * wanted[0]);
}
