//! Real spherical harmonics, degrees 0 to 3, in 3DGS's sign convention.

/// Value of the constant basis function, √(1/4π): a colour c alike from everywhere is stored as (c − ½) over this.
pub(crate) const C0: f64 = 0.282_094_791_773_878_14;
/// Normalisation constants of the degrees 1, √(3/4π), 2 and 3.
pub(crate) const C1: f64 = 0.488_602_511_902_919_9;
pub(crate) const C2: [f64; 3] = [
    1.092_548_430_592_079_2,
    0.315_391_565_252_520_05,
    0.546_274_215_296_039_6,
];
pub(crate) const C3: [f64; 5] = [
    0.590_043_589_926_643_5,
    2.890_611_442_640_554,
    0.457_045_799_464_465_8,
    0.373_176_332_590_115_4,
    1.445_305_721_320_277,
];

/// Values of the 16 basis functions at a unit vector.
#[must_use]
pub fn basis([x, y, z]: [f64; 3]) -> [f64; 16] {
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        C0,
        -C1 * y,
        C1 * z,
        -C1 * x,
        C2[0] * x * y,
        -C2[0] * y * z,
        C2[1] * (2.0 * zz - xx - yy),
        -C2[0] * x * z,
        C2[2] * (xx - yy),
        -C3[0] * y * (3.0 * xx - yy),
        C3[1] * x * y * z,
        -C3[2] * y * (4.0 * zz - xx - yy),
        C3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -C3[2] * x * (4.0 * zz - xx - yy),
        C3[4] * z * (xx - yy),
        -C3[0] * x * (xx - 3.0 * yy),
    ]
}

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
