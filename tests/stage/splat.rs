//! splat: compositing.

use super::*;

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
fn every_vector_width_gives_the_same_bits() {
    let device = device();
    let case = cases::mild("widths", 300, [75, 50], 1, 31);
    let run = |tuning: Tuning| chain::run::<f32>(&device, tuning, &case).unwrap();
    let wide = run(Tuning::CPU);
    let shapes = [(16, 16), (16, 8), (8, 4), (8, 8), (4, 2), (1, 1)];
    for (vector_width, block_width) in shapes {
        let out = run(Tuning {
            vector_width,
            block_width,
            ..Tuning::CPU
        });
        assert!(
            out.image == wide.image,
            "width {vector_width}, block {block_width}"
        );
        assert!(
            out.transmittance == wide.transmittance,
            "width {vector_width}, block {block_width}"
        );
    }
    let group = run(Tuning {
        chunks: 64,
        ..Tuning::GPU
    });
    assert!(group.image == wide.image, "a work-group per tile");
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
