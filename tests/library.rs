//! The library's examples, as users of the crate would write them.

#[allow(dead_code)]
#[path = "../examples/own_density_control.rs"]
mod own_density_control;
#[allow(dead_code)]
#[path = "../examples/render_path.rs"]
mod render_path;
#[allow(dead_code)]
#[path = "../examples/train_and_render.rs"]
mod train_and_render;

use std::path::Path;

const ROOM: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/data/room-tiny");

/// Checks that a picture has this size and is not the same everywhere.
fn shows_something(picture: &Path, size: (u32, u32)) {
    let image = image::open(picture).unwrap().to_rgb8();
    assert_eq!(image.dimensions(), size);
    let [low, high] =
        [u8::min as fn(u8, u8) -> u8, u8::max].map(|f| image.iter().copied().reduce(f).unwrap());
    assert!(high > low + 60, "{low} to {high}");
}

#[test]
fn an_example_trains_and_leaves_a_picture() {
    let folder = tempfile::tempdir().unwrap();
    let picture = folder.path().join("view.png");
    train_and_render::train_and_render(ROOM, 30, picture.to_str().unwrap()).unwrap();
    shows_something(&picture, (256, 192));
}

#[test]
fn an_example_has_its_own_density_control_and_one_renders_what_it_trained() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let scene = place("scene.ply");
    let [before, after] = own_density_control::train(ROOM, 300, &scene).unwrap();
    // Twelve steps that copy a twentieth each; the default strategy has none of these numbers.
    assert!(after > before + before / 4, "{before} to {after}");
    let frames = place("frames");
    render_path::render_path(&scene, &frames, 3).unwrap();
    for k in 0..3 {
        shows_something(
            &Path::new(&frames).join(format!("frame-{k:04}.png")),
            (640, 480),
        );
    }
}
