//! bin: pairs of tiles and Gaussians.

use super::*;
use mhsplat::device::Array;
use mhsplat::device::tuning::status::{INTERSECTIONS, SLOTS};
use mhsplat::lab::verify::definition::inputs;
use mhsplat::pipeline::stage::project::project;
use mhsplat::scene::Plane;

#[test]
fn agrees_with_the_reference() {
    agrees("bin");
}

#[test]
fn a_lost_pair_is_rejected() {
    rejects("bin", "pairs emitted", |pairs| pairs[0] -= 1.0);
    rejects("sort", "tile lists", |lists| {
        // The first of each tile is left.
        lists.dedup_by(|next, kept| *kept >= 0.0 && *next >= 0.0);
    });
}

#[test]
fn emitted_pairs_are_the_counted_ones_and_no_pixel_is_missed() {
    for case in scenes() {
        let out = run(Tuning::for_device(device().info()), &case);
        let (emitted, counted) = (
            out.got("bin", "pairs emitted"),
            out.got("scan", "pairs counted"),
        );
        assert_eq!(emitted, counted, "{}", case.name);
        let lists = out.got("sort", "tile lists").split(|g| *g < 0.0);
        let tiles: Vec<&[f64]> = lists.collect();
        let (scene, camera, options) = inputs(&case);
        let tile = device().tuning().tile as i32;
        let tiles_x = camera.tiles(tile)[0];
        for i in 0..scene.len() {
            let Some(g) = project(&scene, i, &camera, &options) else {
                continue;
            };
            for y in 0..camera.size[1] {
                for x in 0..camera.size[0] {
                    // A hair above the cut, so that f32 and f64 agree on which side the pixel lies.
                    if g.log2_alpha(x, y) > case.alpha_min.log2() + 1e-4 {
                        let at = (y / tile * tiles_x + x / tile) as usize;
                        assert!(
                            tiles[at].contains(&(i as f64)),
                            "{}: Gaussian {i} at {x}, {y}",
                            case.name
                        );
                    }
                }
            }
        }
    }
}

/// Boxes of more tiles than a mask has bits are walked by a whole work-group: several in one group, some of the whole image, and groups
/// without any.
#[test]
fn large_gaussians_have_the_same_pairs_in_both_styles() {
    let mut plain = cases::mild("large", 700, [520, 300], 0, 31);
    for i in (0..300).filter(|i| i % 5 == 0) {
        let [x, y, z] = plain.splats.gather(Plane::LOG_SCALE, i);
        let wider = if i % 50 == 0 { 6.0 } else { 1.5 };
        plain
            .splats
            .scatter(Plane::LOG_SCALE, i, [x + wider, y + wider, z]);
    }
    let few = Tuning {
        radix_bits: 4,
        chunks: 3,
        ..Tuning::GPU
    };
    for case in [plain.clone(), plain.with_mask()] {
        let small = Tuning {
            tile: Tuning::GPU.tile,
            ..Tuning::CPU
        };
        let want = run(small, &case);
        let lists = want.got("sort", "tile lists");
        let pairs = lists.iter().filter(|g| **g >= 0.0).count();
        assert!(pairs > 20_000, "{pairs}");
        for tuning in [Tuning::GPU, few] {
            let got = run(tuning, &case);
            assert_eq!(got.got("sort", "tile lists"), lists, "{}", case.name);
            let counted = |out: &Outcome| out.got("scan", "pairs counted").to_vec();
            assert_eq!(counted(&got), counted(&want));
        }
    }
}

/// First pairs of tiles, some of which have none, and a work-group that is larger than any device's: fewer work-items do it.
#[test]
fn first_pairs_are_looked_up_by_as_many_work_items_as_there_is_room_for() {
    let device = device();
    let stage = Kernels::new(&device, Defines::new(Tuning::GPU));
    let stage = stage.build::<f32>("bin").unwrap();
    let keys = Array::from_slice(&device, "keys", &[0u32, 0, 2, 2, 2, 5, 9, 9]).unwrap();
    for (pairs, want) in [(6, [0, 2, 2, 5, 5, 5, 6, 6]), (0, [0; 8])] {
        let status = Array::<u32>::zeros(&device, "status", SLOTS).unwrap();
        status.write(INTERSECTIONS as usize, &[pairs]).unwrap();
        let first = Array::from_slice(&device, "first", &[77u32; 8]).unwrap();
        let launch = stage.launch("bin_ranges").array(&keys, 8);
        let launch = launch.array(&status, SLOTS).uints([7]).array(&first, 8);
        launch.run([8, 1], [1 << 20, 1]).unwrap();
        assert_eq!(first.to_vec().unwrap(), want);
    }
}
