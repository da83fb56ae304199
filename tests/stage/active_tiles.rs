//! active_tiles: tiles of a masked photo in which any pixel counts get pairs, the others do not.

use super::*;
use mhsplat::device::{Array, CameraArg, ImageSize};
use mhsplat::pipeline::buffers::GaussianBuffers;
use mhsplat::pipeline::forward::{RenderOptions, Renderer};
use mhsplat::pipeline::stage::active_tiles::{active_tiles, mark};

/// Flags that the kernel gives the tiles of so many pixels a side of a mask of this size.
fn tiles(mask: &[u8], pixels: [usize; 2], tile: u32) -> Vec<bool> {
    let device = device();
    let n = pixels[0] * pixels[1];
    let mut photo = vec![9; 3 * n];
    photo.extend(mask);
    let photo = Array::from_slice(&device, "photo", &photo).unwrap();
    let tuning = Tuning {
        tile,
        ..Tuning::CPU
    };
    let tile = tile as usize;
    let size = ImageSize { pixels, tile };
    let kernels = Kernels::new(&device, Defines::new(tuning));
    let stage = kernels.build::<f32>("active_tiles").unwrap();
    let out = mark(&device, &stage, (&photo, &(0..size.pixels[1])), size).unwrap();
    out.to_vec().unwrap().into_iter().map(|t| t == 1).collect()
}

#[test]
fn agrees_with_the_reference() {
    for size in [[64, 48], [75, 50], [33, 17], [1, 1]] {
        let n = size[0] * size[1];
        for sparse in [2, 97, 1009] {
            let mask: Vec<u8> = (0..n).map(|i| u8::from(i * 31 % sparse == 1)).collect();
            for tile in [16, 32] {
                assert_eq!(
                    tiles(&mask, size, tile),
                    active_tiles(&mask, size, tile as usize),
                    "{size:?}, one in {sparse}, tiles of {tile}"
                );
            }
        }
    }
}

#[test]
fn one_pixel_wakes_its_tile_alone() {
    let mut mask = vec![0; 40 * 20];
    assert!(tiles(&mask, [40, 20], 16).iter().all(|t| !t));
    mask[17 * 40 + 33] = 1;
    assert_eq!(
        tiles(&mask, [40, 20], 16),
        [false, false, false, false, false, true]
    );
    assert_eq!(tiles(&mask, [40, 20], 32), [false, true]);
}

/// Pairs per tile and the image of a masked case in tiles of so many pixels a side, with those that no pixel wakes left out, or not.
fn rendered(tile: u32, active_only: bool) -> (Vec<u32>, Vec<f32>) {
    let device = device();
    let case = cases::mild("mask", 90, [170, 40], 0, 26).with_mask();
    let defines = Defines {
        alpha: case.photo.alpha,
        ..Defines::new(Tuning {
            tile,
            ..Tuning::CPU
        })
    };
    let mut renderer = Renderer::<f32>::new(&device, defines, 0, false).unwrap();
    let scene = GaussianBuffers::upload(&device, &case.splats, 0).unwrap();
    let camera = CameraArg::new(&case.camera, defines.tuning.tile);
    renderer.fit(&scene, &camera).unwrap();
    let photo = Array::from_slice(&device, "photo", &case.photo.data).unwrap();
    let stage = Kernels::new(&device, defines)
        .build::<f32>("active_tiles")
        .unwrap();
    let (size, stage) = (camera.image(), &stage);
    let marked = mark(&device, stage, (&photo, &(0..size.pixels[1])), size).unwrap();
    renderer.take_tiles(marked.into());
    let options = RenderOptions {
        active_only,
        ..RenderOptions::default()
    };
    renderer.render(&scene, &camera, &options).unwrap();
    let image = renderer.read_image().unwrap();
    (renderer.intersections_per_tile().unwrap(), image.rgb)
}

#[test]
fn tiles_that_nothing_wakes_get_no_pairs_and_the_others_the_same() {
    // The left half of 170 pixels is masked: so many tiles of a row whole.
    for (edge, across, masked) in [(16, 11, 5), (32, 6, 2)] {
        let ((all, whole), (some, part)) = (rendered(edge, false), rendered(edge, true));
        let left = |tile: usize| tile % across < masked;
        for (tile, (a, b)) in all.iter().zip(&some).enumerate() {
            assert_eq!(*b, if left(tile) { 0 } else { *a }, "tile {tile} of {edge}");
        }
        assert!(all.iter().enumerate().any(|(t, n)| left(t) && *n > 0));
        for (i, (a, b)) in whole.iter().zip(&part).enumerate() {
            assert!(
                i % 170 < masked * edge as usize || a == b,
                "pixel {i}, tiles of {edge}"
            );
        }
    }
}
