//! Real spherical harmonics with their gradient. Their values are the host's own (`model::sh`): what is checked against them are
//! the kernels, which have the polynomials in `common.clh`.

pub use crate::model::sh::basis;
use crate::model::sh::{C1, C2, C3};

/// Gradient of each basis polynomial with respect to x, y, z.
#[must_use]
pub fn gradient([x, y, z]: [f64; 3]) -> [[f64; 3]; 16] {
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let scale = |c: f64, v: [f64; 3]| v.map(|e| c * e);
    [
        [0.0; 3],
        [0.0, -C1, 0.0],
        [0.0, 0.0, C1],
        [-C1, 0.0, 0.0],
        scale(C2[0], [y, x, 0.0]),
        scale(-C2[0], [0.0, z, y]),
        scale(C2[1], [-2.0 * x, -2.0 * y, 4.0 * z]),
        scale(-C2[0], [z, 0.0, x]),
        scale(C2[2], [2.0 * x, -2.0 * y, 0.0]),
        scale(-C3[0], [6.0 * x * y, 3.0 * xx - 3.0 * yy, 0.0]),
        scale(C3[1], [y * z, x * z, x * y]),
        scale(
            -C3[2],
            [-2.0 * x * y, 4.0 * zz - xx - 3.0 * yy, 8.0 * y * z],
        ),
        scale(
            C3[3],
            [-6.0 * x * z, -6.0 * y * z, 6.0 * zz - 3.0 * xx - 3.0 * yy],
        ),
        scale(
            -C3[2],
            [4.0 * zz - 3.0 * xx - yy, -2.0 * x * y, 8.0 * x * z],
        ),
        scale(C3[4], [2.0 * x * z, -2.0 * y * z, xx - yy]),
        scale(-C3[0], [3.0 * xx - 3.0 * yy, -6.0 * x * y, 0.0]),
    ]
}
