//! metrics: squared error after clamping.

use super::*;
use mhsplat::evaluate::{MAX_PSNR, psnr};

#[test]
fn agrees_with_the_reference() {
    agrees("metrics");
}

#[test]
fn a_wrong_error_is_rejected() {
    rejects("metrics", "squared error", |error| error[0] *= 1.001);
}

#[test]
fn a_wrong_ssim_is_rejected() {
    rejects("metrics", "1 - SSIM", |sum| sum[0] *= 1.001);
}

#[test]
fn psnr_of_known_errors() {
    assert!((psnr(0.01) - 20.0).abs() < 1e-12);
    assert!((psnr(1.0)).abs() < 1e-12);
    assert_eq!(psnr(0.0), MAX_PSNR);
}
