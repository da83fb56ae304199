//! Types and formulas of the definitions in f64 (`pipeline/stage`): plain Rust, slow and obvious.
//!
//! A definition uses the formula of the textbook, as far as f64 allows, where its kernel uses a stable form: two roads to one
//! number. Images are planar \[channels, height, width\] without padding. Source: 3DGS (Kerbl et al. 2023) and \[MH\]
//! Eq. 4, 11, 13.

pub use crate::base::constants::{ALPHA_MAX, COLOR_MAX, LOG_SCALE, T_MIN, blur};

use crate::capture::Camera;
use crate::scene::{Gaussians, Plane};

/// Edge of the tiles that the definitions go by where any will do, pixels.
pub const TILE: i32 = 16;

/// A camera in f64.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera64 {
    /// Rotation scene → camera, rows.
    pub w: [[f64; 3]; 3],
    /// Translation, local units.
    pub t: [f64; 3],
    /// Centre of projection, local units.
    pub center: [f64; 3],
    /// Focal lengths, pixels.
    pub focal: [f64; 2],
    /// Principal point, pixels.
    pub principal: [f64; 2],
    /// Width and height, pixels.
    pub size: [i32; 2],
    /// Near plane, local units.
    pub near: f64,
    /// Smallest and largest x/z, smallest and largest y/z of the affine approximation.
    pub limits: [[f64; 2]; 2],
}

impl Camera64 {
    /// The field of view, widened by 30 % of its half-width on each side.
    #[must_use]
    pub fn new(camera: &Camera, near: f64) -> Self {
        let focal = [camera.fx, camera.fy];
        let principal = [camera.cx, camera.cy];
        let size = [camera.width, camera.height].map(f64::from);
        let limits = std::array::from_fn(|k| {
            let margin = 0.3 * size[k] / (2.0 * focal[k]);
            [
                -principal[k] / focal[k] - margin,
                (size[k] - principal[k]) / focal[k] + margin,
            ]
        });
        Self {
            w: std::array::from_fn(|r| camera.rotation.row(r).to_array()),
            t: camera.translation.to_array(),
            center: camera.center().to_array(),
            focal,
            principal,
            size: [camera.width as i32, camera.height as i32],
            near,
            limits,
        }
    }

    /// A point of the scene in the camera frame.
    #[must_use]
    pub fn apply(&self, x: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|r| (0..3).map(|k| self.w[r][k] * x[k]).sum::<f64>() + self.t[r])
    }

    /// Tiles of so many pixels a side in x and y.
    #[must_use]
    pub fn tiles(&self, tile: i32) -> [i32; 2] {
        self.size.map(|s| (s + tile - 1) / tile)
    }

    /// Width × height.
    #[must_use]
    pub fn pixels(&self) -> usize {
        (self.size[0] * self.size[1]) as usize
    }
}

/// Raw parameters in f64: `planes[p][i]`, planes as in [`Plane`].
#[derive(Debug, Clone, PartialEq)]
pub struct Scene64 {
    /// SH degree of the stored coefficients.
    pub sh_degree: u32,
    /// Planes.
    pub planes: Vec<Vec<f64>>,
    /// Standard deviation of each Gaussian's 3D filter, local units \[N\]; `None` without anti-aliasing.
    pub filter: Option<Vec<f64>>,
}

impl Scene64 {
    /// Widens a scene.
    #[must_use]
    pub fn new(splats: &Gaussians) -> Self {
        let widen = |p: &Vec<f32>| p.iter().map(|v| f64::from(*v)).collect();
        Self {
            sh_degree: splats.sh_degree(),
            planes: splats.planes().iter().map(widen).collect(),
            filter: None,
        }
    }

    /// Number of Gaussians.
    #[must_use]
    pub fn len(&self) -> usize {
        self.planes[0].len()
    }

    /// True if there is no Gaussian.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// `K` neighbouring planes of Gaussian `i`.
    #[must_use]
    pub fn gather<const K: usize>(&self, first: usize, i: usize) -> [f64; K] {
        std::array::from_fn(|k| self.planes[first + k][i])
    }

    /// Position of Gaussian `i`.
    #[must_use]
    pub fn position(&self, i: usize) -> [f64; 3] {
        self.gather(Plane::POSITION, i)
    }

    /// Zeros of the same shape.
    #[must_use]
    pub fn zeros_like(&self) -> Self {
        Self {
            sh_degree: self.sh_degree,
            planes: vec![vec![0.0; self.len()]; self.planes.len()],
            filter: None,
        }
    }
}

/// Options of a render beside scene and camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Contributions below this alpha are dropped.
    pub alpha_min: f64,
    /// SH degree in use.
    pub sh_degree: u32,
    /// Background colour.
    pub background: [f64; 3],
}

/// Unit quaternion and norm; the zero quaternion is the identity with norm 0.
#[must_use]
pub fn unit_quaternion(q: [f64; 4]) -> ([f64; 4], f64) {
    let largest = q.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    if largest.is_nan() || largest <= 0.0 {
        return ([1.0, 0.0, 0.0, 0.0], 0.0);
    }
    let scaled = q.map(|v| v / largest);
    let norm = scaled.iter().map(|v| v * v).sum::<f64>().sqrt();
    (scaled.map(|v| v / norm), norm * largest)
}

/// Rotation matrix of a unit quaternion (w, x, y, z), rows.
#[must_use]
pub fn rotation(q: [f64; 4]) -> [[f64; 3]; 3] {
    let [w, x, y, z] = q;
    [
        [
            1.0 - 2.0 * (y * y + z * z),
            2.0 * (x * y - w * z),
            2.0 * (x * z + w * y),
        ],
        [
            2.0 * (x * y + w * z),
            1.0 - 2.0 * (x * x + z * z),
            2.0 * (y * z - w * x),
        ],
        [
            2.0 * (x * z - w * y),
            2.0 * (y * z + w * x),
            1.0 - 2.0 * (x * x + y * y),
        ],
    ]
}

/// Matrix product of an R×K and a K×C matrix.
#[must_use]
pub fn product<const A: usize, const K: usize, const C: usize>(
    a: &[[f64; K]; A],
    b: &[[f64; C]; K],
) -> [[f64; C]; A] {
    std::array::from_fn(|r| std::array::from_fn(|c| (0..K).map(|k| a[r][k] * b[k][c]).sum()))
}

/// Transpose.
#[must_use]
pub fn transpose<const A: usize, const B: usize>(m: &[[f64; B]; A]) -> [[f64; A]; B] {
    std::array::from_fn(|r| std::array::from_fn(|c| m[c][r]))
}
