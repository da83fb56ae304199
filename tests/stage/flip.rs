//! flip: differences of two pictures as the eye sees them; against the authors' program in the tests of flip.

use super::*;

#[test]
fn agrees_with_the_reference() {
    agrees("flip");
}

#[test]
fn a_wrong_error_is_rejected() {
    rejects("flip", "errors of the rows", |rows| rows[3] *= 1.001);
}
