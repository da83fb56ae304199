//! splat: compositing.

use super::*;
use mhsplat::lab::error::{Tolerance, compare};

#[test]
fn agrees_with_the_reference() {
    agrees("splat");
}

#[test]
fn a_wrong_image_is_rejected() {
    rejects("splat", "image", |image| {
        image[100..].iter_mut().for_each(|v| *v += 1e-3)
    });
    rejects("splat", "image", |image| image[7] = f64::NAN);
}

/// Image and transmittance.
fn picture(out: &Outcome) -> [Vec<f64>; 2] {
    ["image", "transmittance"].map(|name| out.got("splat", name).to_vec())
}

#[test]
fn every_block_shape_gives_the_same_bits() {
    let case = cases::mild("shapes", 300, [75, 50], 1, 31);
    let of = |block_width: u32| {
        let tuning = Tuning {
            vector_width: 16,
            block_width,
            ..Tuning::CPU
        };
        picture(&run(tuning, &case))
    };
    let square = of(4);
    for block_width in [8, 16] {
        assert!(of(block_width) == square, "block {block_width}");
    }
}

#[test]
fn every_width_tile_and_style_gives_the_same_picture() {
    let case = cases::mild("widths", 300, [75, 50], 1, 31);
    let wide = picture(&run(Tuning::CPU, &case));
    // The driver's exp and log1p may round apart for each width, and distances from the corner of a tile, no more than that.
    let rounding = Tolerance::all(SINGLE);
    let narrow = [(8, 4), (8, 8), (4, 2), (1, 1)].map(|(vector_width, block_width)| Tuning {
        vector_width,
        block_width,
        ..Tuning::CPU
    });
    let group = Tuning {
        chunks: 64,
        ..Tuning::GPU
    };
    let small = Tuning {
        tile: 16,
        ..Tuning::CPU
    };
    for tuning in narrow.into_iter().chain([small, group]) {
        let got = picture(&run(tuning, &case));
        for (got, want) in got.iter().zip(&wide) {
            let report = compare(got, want, rounding);
            assert!(report.is_ok(), "{tuning:?}: {report:?}");
        }
    }
}

#[test]
fn nothing_in_view_is_the_background() {
    let mut case = cases::mild("empty", 5, [20, 20], 0, 32);
    case.splats.plane_mut(2).fill(-100.0);
    let [image, transmittance] = picture(&run(Tuning::CPU, &case));
    let n = 400;
    for c in 0..3 {
        assert!(
            image[c * n..(c + 1) * n]
                .iter()
                .all(|v| *v == f64::from(case.background[c]))
        );
    }
    assert!(transmittance.iter().all(|t| *t == 1.0));
}
