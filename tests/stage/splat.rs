//! splat: compositing.

use super::*;
use mhsplat::lab::error::{Tolerance, compare};

#[test]
fn agrees_with_the_reference() {
    agrees("splat");
}

#[test]
fn a_wrong_image_is_rejected() {
    rejects("splat", |out| {
        out.image[100..].iter_mut().for_each(|v| *v += 1e-3)
    });
    rejects("splat", |out| out.image[7] = f64::NAN);
}

#[test]
fn every_block_shape_gives_the_same_bits() {
    let device = device();
    let case = cases::mild("shapes", 300, [75, 50], 1, 31);
    let run = |block_width: u32| {
        let tuning = Tuning {
            vector_width: 16,
            block_width,
            ..Tuning::CPU
        };
        chain::run::<f32>(&device, tuning, &case).unwrap()
    };
    let square = run(4);
    for block_width in [8, 16] {
        let out = run(block_width);
        assert!(out.image == square.image, "block {block_width}");
        assert!(
            out.transmittance == square.transmittance,
            "block {block_width}"
        );
    }
}

#[test]
fn every_vector_width_and_style_gives_the_same_picture() {
    let device = device();
    let case = cases::mild("widths", 300, [75, 50], 1, 31);
    let run = |tuning: Tuning| chain::run::<f32>(&device, tuning, &case).unwrap();
    let wide = run(Tuning::CPU);
    // The driver's exp and log1p may round apart for each width, no more than that.
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
    for tuning in narrow.into_iter().chain([group]) {
        let out = run(tuning);
        for (got, want) in [
            (&out.image, &wide.image),
            (&out.transmittance, &wide.transmittance),
        ] {
            let report = compare(got, want, rounding);
            assert!(report.is_ok(), "{tuning:?}: {report:?}");
        }
    }
}

#[test]
fn nothing_in_view_is_the_background() {
    let device = device();
    let mut case = cases::mild("empty", 5, [20, 20], 0, 32);
    case.splats.plane_mut(2).fill(-100.0);
    let out = chain::run::<f32>(&device, Tuning::CPU, &case).unwrap();
    let n = 400;
    for c in 0..3 {
        assert!(
            out.image[c * n..(c + 1) * n]
                .iter()
                .all(|v| *v == f64::from(case.background[c]))
        );
    }
    assert!(out.transmittance.iter().all(|t| *t == 1.0));
}
