//! Twin of `kernels/exposure.cl`: an affine colour transform per image.

pub use crate::exposure::IDENTITY;

/// A x + b of every pixel of a planar image \[3, pixels\]; `exposure` is row-major \[A | b\].
#[must_use]
pub fn apply(image: &[f64], exposure: &[f64; 12]) -> Vec<f64> {
    let n = image.len() / 3;
    let of = |r: usize, i: usize| -> f64 {
        let linear: f64 = (0..3).map(|c| exposure[4 * r + c] * image[c * n + i]).sum();
        linear + exposure[4 * r + 3]
    };
    (0..3 * n).map(|at| of(at / n, at % n)).collect()
}

/// dL/dx = Aᵀ dL/dx′ \[3, pixels\] and dL/d\[A | b\] of an image x \[3, pixels\] and dL/dx′.
#[must_use]
pub fn backward(image: &[f64], exposure: &[f64; 12], dimage: &[f64]) -> (Vec<f64>, [f64; 12]) {
    let n = image.len() / 3;
    let of = |c: usize, i: usize| -> f64 {
        (0..3)
            .map(|r| exposure[4 * r + c] * dimage[r * n + i])
            .sum()
    };
    let entry = |k: usize| -> f64 {
        let (r, c) = (k / 4, k % 4);
        let x = |i: usize| if c < 3 { image[c * n + i] } else { 1.0 };
        (0..n).map(|i| dimage[r * n + i] * x(i)).sum()
    };
    (
        (0..3 * n).map(|at| of(at / n, at % n)).collect(),
        std::array::from_fn(entry),
    )
}

/// Takes the mean deviation from the identity off the transforms \[views, 12\].
pub fn center(exposures: &mut [f64]) {
    let views = exposures.len() / 12;
    for (k, identity) in IDENTITY.into_iter().enumerate() {
        let sum: f64 = exposures.iter().skip(k).step_by(12).sum();
        let mean = sum / views as f64 - identity;
        exposures
            .iter_mut()
            .skip(k)
            .step_by(12)
            .for_each(|v| *v -= mean);
    }
}
