//! splat_grad: derivative of the compositing.

use super::*;

#[test]
fn agrees_with_the_reference() {
    agrees("splat_grad");
}

#[test]
fn wrong_sums_are_rejected() {
    rejects("splat_grad", "sums", |sums| {
        sums.iter_mut().skip(3).step_by(9).for_each(|s| *s = -*s)
    });
    rejects("splat_grad", "sums", |sums| sums.fill(0.0));
}
