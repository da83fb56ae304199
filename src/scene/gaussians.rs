//! [`Gaussians`]: struct of arrays of raw parameters, in the very order the device keeps them.

use glam::DVec3;
use rayon::prelude::*;

use crate::base::error::{Error, Result};
use crate::base::math::sigmoid;
use crate::scene::morton;

/// Number of SH coefficients per colour channel for a degree: (d+1)².
#[must_use]
pub const fn sh_coefficients(degree: u32) -> usize {
    ((degree + 1) * (degree + 1)) as usize
}

/// Index of each parameter's plane. A plane holds one scalar parameter of every Gaussian.
///
/// SH planes follow coefficient by coefficient, the three channels of one coefficient side by side, so that the
/// planes of a lower degree are a prefix of those of a higher one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Plane;

impl Plane {
    /// Position x, y, z (3 planes), local units (the scene extent is 1).
    pub const POSITION: usize = 0;
    /// Natural logarithm of the standard deviations along the Gaussian's own axes (3 planes), local units.
    pub const LOG_SCALE: usize = 3;
    /// Rotation quaternion w, x, y, z (4 planes), of any norm.
    pub const ROTATION: usize = 6;
    /// Opacity logit (1 plane).
    pub const OPACITY: usize = 10;
    /// First SH plane; coefficient k of channel c is plane `SH + 3·k + c`.
    pub const SH: usize = 11;

    /// Number of planes for an SH degree: 11 + 3·(d+1)².
    #[must_use]
    pub const fn count(sh_degree: u32) -> usize {
        Self::SH + 3 * sh_coefficients(sh_degree)
    }
}

/// N Gaussians in raw form (see the crate documentation for the activations): `planes[p][i]` is parameter `p` (see
/// [`Plane`]) of Gaussian `i`.
#[derive(Debug, Clone, PartialEq)]
pub struct Gaussians {
    sh_degree: u32,
    planes: Vec<Vec<f32>>,
}

impl Gaussians {
    /// Gaussians from planes of equal length.
    ///
    /// # Errors
    /// A degree above 3, a wrong number of planes, unequal lengths, or a non-finite value.
    pub fn new(sh_degree: u32, planes: Vec<Vec<f32>>) -> Result<Self> {
        let bad = |what: String| Err(Error::numerics("splats", what));
        if sh_degree > 3 {
            return bad(format!("SH degree {sh_degree}; 0 to 3 expected"));
        }
        let (found, expected) = (planes.len(), Plane::count(sh_degree));
        if found != expected {
            return bad(format!(
                "{found} parameter planes; {expected} expected for SH degree {sh_degree}"
            ));
        }
        let n = planes[0].len();
        for (p, plane) in planes.iter().enumerate() {
            let found = plane.len();
            if found != n {
                return bad(format!("plane {p} holds {found} values; {n} expected"));
            }
            if let Some((i, v)) = plane.iter().enumerate().find(|(_, v)| !v.is_finite()) {
                return bad(format!("plane {p} of Gaussian {i} is {v}"));
            }
        }
        Ok(Self { sh_degree, planes })
    }

    /// `n` Gaussians with every parameter zero but the rotation, which is the identity.
    #[must_use]
    pub fn zeros(sh_degree: u32, n: usize) -> Self {
        let mut planes = vec![vec![0.0; n]; Plane::count(sh_degree.min(3))];
        planes[Plane::ROTATION] = vec![1.0; n];
        Self {
            sh_degree: sh_degree.min(3),
            planes,
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

    /// SH degree of the stored coefficients.
    #[must_use]
    pub fn sh_degree(&self) -> u32 {
        self.sh_degree
    }

    /// The same Gaussians with the SH bands of another degree: higher bands are cut off, missing ones are zero.
    ///
    /// # Errors
    /// A degree above 3.
    pub fn with_sh_degree(mut self, degree: u32) -> Result<Self> {
        let n = self.len();
        self.planes
            .resize(Plane::count(degree.min(3)), vec![0.0; n]);
        Self::new(degree, self.planes)
    }

    /// The Gaussians with centres in a box (the least coordinates, then the largest), and of at least an opacity.
    #[must_use]
    pub fn within(self, corners: Option<[f64; 6]>, opacity: Option<f64>) -> Self {
        let inside = |i: &usize| {
            let position = self.gather::<3>(Plane::POSITION, *i).map(f64::from);
            corners.is_none_or(|c| (0..3).all(|k| (c[k]..=c[3 + k]).contains(&position[k])))
        };
        let solid = |i: &usize| {
            let [logit] = self.gather(Plane::OPACITY, *i).map(f64::from);
            opacity.is_none_or(|least| sigmoid(logit) >= least)
        };
        let kept: Vec<usize> = (0..self.len()).filter(inside).filter(solid).collect();
        self.rows(&kept)
    }

    /// The Gaussians whose centres are as wanted.
    #[must_use]
    pub fn centered(self, wanted: impl Fn(DVec3) -> bool) -> Self {
        let center = |i: &usize| self.gather(Plane::POSITION, *i).map(f64::from);
        let kept = (0..self.len()).filter(|i| wanted(DVec3::from_array(center(i))));
        let kept: Vec<usize> = kept.collect();
        self.rows(&kept)
    }

    /// The Gaussians after the first `count`.
    #[must_use]
    pub fn after(mut self, count: usize) -> Self {
        self.planes.iter_mut().for_each(|plane| {
            plane.drain(..count.min(plane.len()));
        });
        self
    }

    /// The Gaussians of these numbers.
    fn rows(mut self, kept: &[usize]) -> Self {
        self.planes.par_iter_mut().for_each(|plane| {
            *plane = kept.iter().map(|&i| plane[i]).collect();
        });
        self
    }

    /// Adds Gaussians after these.
    ///
    /// # Errors
    /// Another SH degree.
    pub fn append(&mut self, other: &Self) -> Result<()> {
        let (own, degree) = (self.sh_degree, other.sh_degree);
        if own != degree {
            let what = format!("SH degree {degree} after {own}; equal ones expected");
            return Err(Error::numerics("splats", what));
        }
        let planes = self.planes.iter_mut().zip(&other.planes);
        planes.for_each(|(plane, more)| plane.extend_from_slice(more));
        Ok(())
    }

    /// The same Gaussians in Morton order, by layers where a direction is up (see [`morton::order`]).
    #[must_use]
    pub fn in_morton_order(mut self, up: [f32; 3]) -> Self {
        let axis = |k: usize| self.planes[Plane::POSITION + k].as_slice();
        let order = morton::order([axis(0), axis(1), axis(2)], up);
        self.planes.par_iter_mut().for_each(|plane| {
            *plane = order.iter().map(|&i| plane[i as usize]).collect();
        });
        self
    }

    /// All planes, in the order of [`Plane`].
    #[must_use]
    pub fn planes(&self) -> &[Vec<f32>] {
        &self.planes
    }

    /// One plane, to be changed in place.
    pub fn plane_mut(&mut self, plane: usize) -> &mut [f32] {
        &mut self.planes[plane]
    }

    /// `K` neighbouring planes of Gaussian `i`, from plane `first` on.
    #[must_use]
    pub fn gather<const K: usize>(&self, first: usize, i: usize) -> [f32; K] {
        std::array::from_fn(|k| self.planes[first + k][i])
    }

    /// Writes `K` neighbouring planes of Gaussian `i`, from plane `first` on.
    pub fn scatter<const K: usize>(&mut self, first: usize, i: usize, values: [f32; K]) {
        for (k, v) in values.into_iter().enumerate() {
            self.planes[first + k][i] = v;
        }
    }
}
