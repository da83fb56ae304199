//! splat_grad: derivative of the compositing.

use super::*;

#[test]
fn agrees_with_the_reference() {
    agrees("splat_grad");
}

#[test]
fn wrong_sums_are_rejected() {
    rejects("splat_grad", |out| {
        out.sums.iter_mut().for_each(|s| s[3] = -s[3])
    });
    rejects("splat_grad", |out| {
        out.sums.iter_mut().for_each(|s| *s = [0.0; 9])
    });
}
