//! The library's example, as a user of the crate would write it.

#[allow(dead_code)]
#[path = "../examples/train_and_render.rs"]
mod example;

#[test]
fn the_example_trains_and_leaves_a_picture() {
    let folder = tempfile::tempdir().unwrap();
    let picture = folder.path().join("view.png");
    let room = concat!(env!("CARGO_MANIFEST_DIR"), "/data/room-tiny");
    example::train_and_render(room, 30, picture.to_str().unwrap()).unwrap();
    let image = image::open(&picture).unwrap().to_rgb8();
    assert_eq!(image.dimensions(), (256, 192));
    // Something is to be seen, and not the same everywhere.
    let [low, high] =
        [u8::min as fn(u8, u8) -> u8, u8::max].map(|f| image.iter().copied().reduce(f).unwrap());
    assert!(high > low + 60, "{low} to {high}");
}
