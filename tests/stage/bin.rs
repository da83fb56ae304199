//! bin: pairs of tiles and Gaussians.

use super::*;
use mhsplat::lab::verify::twin::inputs;
use mhsplat::pipeline::stage::project::project;

#[test]
fn agrees_with_the_reference() {
    agrees("bin");
}

#[test]
fn a_lost_pair_is_rejected() {
    rejects("bin", |out| {
        for list in &mut out.tiles {
            list.truncate(1);
        }
    });
}

#[test]
fn emitted_pairs_are_the_counted_ones_and_no_pixel_is_missed() {
    let device = device();
    for (case, _) in scenes() {
        let out = chain::run::<f32>(&device, Tuning::for_device(device.info()), &case).unwrap();
        let emitted: usize = out.tiles.iter().map(Vec::len).sum();
        assert_eq!(emitted, out.counted, "{}", case.name);
        let (scene, camera, options) = inputs(&case);
        let tiles_x = camera.tiles()[0];
        for i in 0..scene.len() {
            let Some(g) = project(&scene, i, &camera, &options) else {
                continue;
            };
            for y in 0..camera.size[1] {
                for x in 0..camera.size[0] {
                    // A hair above the cut, so that f32 and f64 agree on which side the pixel lies.
                    if g.log2_alpha(x, y) > case.alpha_min.log2() + 1e-4 {
                        let tile = (y / 16 * tiles_x + x / 16) as usize;
                        assert!(
                            out.tiles[tile].contains(&(i as u32)),
                            "{}: Gaussian {i} at {x}, {y}",
                            case.name
                        );
                    }
                }
            }
        }
    }
}
