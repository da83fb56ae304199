//! Least-squares refit of colours to fewer bands of spherical harmonics.

use rayon::prelude::*;

use crate::base::error::Result;
use crate::scene::gaussians::{Plane, Splats, sh_coefficients};
use crate::scene::sh;

/// Regularisation per direction on the diagonal of the normal matrix: keeps coefficients that few directions determine.
const RIDGE: f64 = 1e-6;

/// Coefficients of degree 2, the highest degree of a refit.
const MAX_LOW: usize = sh_coefficients(2);

/// Coefficients of degree 3, the highest there is.
const MAX_HIGH: usize = sh_coefficients(3);

/// A pinhole camera with its centre as the device has it.
#[derive(Debug, Clone, Copy)]
pub struct Sight {
    /// Rotation scene → camera, rows.
    pub rotation: [[f64; 3]; 3],
    /// Centre, local units.
    pub center: [f64; 3],
    /// fx, fy, cx, cy in pixels.
    pub intrinsics: [f64; 4],
    /// Width and height, pixels.
    pub size: [f64; 2],
}

impl Sight {
    /// Direction from this camera to a position; `None` if it is behind the camera or outside of the image.
    fn direction(&self, x: [f64; 3]) -> Option<[f64; 3]> {
        let d: [f64; 3] = std::array::from_fn(|k| x[k] - self.center[k]);
        let dot = |r: [f64; 3]| r[0] * d[0] + r[1] * d[1] + r[2] * d[2];
        let t = self.rotation.map(dot);
        let [fx, fy, cx, cy] = self.intrinsics;
        let (u, v) = (fx * t[0] / t[2] + cx, fy * t[1] / t[2] + cy);
        let inside = (0.0..self.size[0]).contains(&u) && (0.0..self.size[1]).contains(&v);
        let norm = d.iter().map(|c| c * c).sum::<f64>().sqrt();
        (t[2] > 0.0 && inside && norm > 0.0).then(|| d.map(|c| c / norm))
    }
}

/// The same Gaussians with the bands of a lower degree, refitted by least squares to the colours that all bands gave in the
/// directions from which the cameras see them. A Gaussian that no camera sees keeps its lower bands as they are.
///
/// # Errors
/// Those of [`Splats::with_sh_degree`].
pub fn with_fewer_bands(splats: &Splats, degree: u32, sights: &[Sight]) -> Result<Splats> {
    let changes = match degree {
        0 => changes::<1>(splats, sights),
        1 => changes::<4>(splats, sights),
        _ => changes::<MAX_LOW>(splats, sights),
    };
    let low = sh_coefficients(degree).min(MAX_LOW);
    let mut fewer = splats.clone().with_sh_degree(degree)?;
    for k in 0..low {
        for c in 0..3 {
            let plane = fewer.plane_mut(Plane::SH + 3 * k + c);
            for (v, change) in plane.iter_mut().zip(&changes) {
                let new = (f64::from(*v) + change[k][c]) as f32;
                if new.is_finite() {
                    *v = new;
                }
            }
        }
    }
    Ok(fewer)
}

/// Changes of the `LOW` lower coefficients of each Gaussian, as rows of [`MAX_LOW`].
fn changes<const LOW: usize>(splats: &Splats, sights: &[Sight]) -> Vec<[[f64; 3]; MAX_LOW]> {
    let of = |i| {
        let mut all = [[0.0; 3]; MAX_LOW];
        all[..LOW].copy_from_slice(&change::<LOW>(splats, i, sights));
        all
    };
    (0..splats.len()).into_par_iter().map(of).collect()
}

/// Change of the `LOW` lower coefficients of Gaussian `i`.
fn change<const LOW: usize>(splats: &Splats, i: usize, sights: &[Sight]) -> [[f64; 3]; LOW] {
    let x = splats.gather::<3>(Plane::POSITION, i).map(f64::from);
    let high = sh_coefficients(splats.sh_degree());
    let mut higher = [[0.0; 3]; MAX_HIGH];
    for (k, of) in higher.iter_mut().enumerate().take(high).skip(LOW) {
        *of = splats.gather::<3>(Plane::SH + 3 * k, i).map(f64::from);
    }
    let mut normal = [[0.0; LOW]; LOW];
    let mut right = [[0.0; 3]; LOW];
    let mut seen = 0;
    for direction in sights.iter().filter_map(|s| s.direction(x)) {
        let basis = sh::basis(direction);
        let mut color = [0.0; 3];
        for (value, of) in basis.iter().zip(&higher) {
            for (sum, c) in color.iter_mut().zip(of) {
                *sum += value * c;
            }
        }
        for (a, (row, right)) in normal.iter_mut().zip(&mut right).enumerate() {
            // The upper half: it is symmetric.
            for (sum, value) in row.iter_mut().zip(&basis).skip(a) {
                *sum += basis[a] * value;
            }
            for (sum, c) in right.iter_mut().zip(color) {
                *sum += basis[a] * c;
            }
        }
        seen += 1;
    }
    if seen == 0 {
        return right;
    }
    let upper = normal;
    for (a, row) in normal.iter_mut().enumerate() {
        for (v, other) in row.iter_mut().zip(&upper).take(a) {
            *v = other[a];
        }
        row[a] += RIDGE * f64::from(seen);
    }
    solve(normal, right)
}

/// Solves a symmetric positive definite system by elimination.
fn solve<const N: usize>(mut a: [[f64; N]; N], mut b: [[f64; 3]; N]) -> [[f64; 3]; N] {
    for k in 0..N {
        let (pivot, right) = (a[k], b[k]);
        for row in k + 1..N {
            let factor = a[row][k] / pivot[k];
            let (left, other) = (&mut a[row], &mut b[row]);
            left.iter_mut()
                .zip(pivot)
                .for_each(|(v, p)| *v -= factor * p);
            other
                .iter_mut()
                .zip(right)
                .for_each(|(v, p)| *v -= factor * p);
        }
    }
    let mut out = [[0.0; 3]; N];
    for k in (0..N).rev() {
        let rest = |c: usize| -> f64 { (k + 1..N).map(|j| a[k][j] * out[j][c]).sum() };
        out[k] = std::array::from_fn(|c| (b[k][c] - rest(c)) / a[k][k]);
    }
    out
}
