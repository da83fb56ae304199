//! loss: L1 + SSIM.

use super::*;

#[test]
fn agrees_with_the_reference() {
    agrees("loss");
}

#[test]
fn a_wrong_gradient_is_rejected() {
    rejects("loss", |out| out.dimage.iter_mut().for_each(|d| *d *= 1.01));
}

#[test]
fn flat_images_stay_finite() {
    let device = device();
    for (level, background) in [(0u8, [0.0; 3]), (255, [1.0; 3]), (128, [0.5; 3])] {
        let mut case = cases::mild("flat", 3, [37, 21], 0, 34);
        case.splats.plane_mut(2).fill(-100.0);
        case.background = background;
        case.photo.data.fill(level);
        let out = chain::run::<f32>(&device, Tuning::CPU, &case).unwrap();
        assert!(out.dimage.iter().all(|d| d.is_finite()));
        assert!(
            out.loss[0] < 0.003 && (out.loss[1] - 1.0).abs() < 1e-3,
            "{level}: {:?}",
            out.loss
        );
    }
}
