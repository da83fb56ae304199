//! [`SceneFile`], and the steps that several formats share: frames, axes, rotations, opacities, rounding.

use std::path::Path;

use glam::DVec3;

use crate::base::error::{Error, Result};
use crate::base::math::logit;
use crate::capture::{Frame, Points};
use crate::scene::gaussians::{Gaussians, Plane};

/// Opacity logit in the place of an infinite one, which formats of 8 bits have for opacities of 0 and 1: an opacity that no kernel
/// tells from these.
pub(super) const SATURATED: f64 = 15.0;

/// A sphere in the frame of the scene that it belongs to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sphere {
    /// Its centre.
    pub center: DVec3,
    /// Its radius, > 0.
    pub radius: f64,
}

impl Sphere {
    /// The sphere in the dataset's frame, of one in the local frame.
    pub(super) fn in_dataset(self, frame: &Frame) -> Self {
        Self {
            center: frame.to_dataset(self.center),
            radius: self.radius * frame.scale,
        }
    }

    /// The sphere in the local frame, of one in the dataset's.
    pub(super) fn in_local(self, frame: &Frame) -> Self {
        Self {
            center: frame.to_local(self.center),
            radius: self.radius / frame.scale,
        }
    }
}

/// A scene as its file holds it, in the local frame.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneFile {
    /// The Gaussians.
    pub splats: Gaussians,
    /// True if they were trained with anti-aliasing and are to be rendered with the 2D filter; their scales and opacities
    /// then include the 3D filter.
    pub anti_aliased: bool,
    /// Direction away from the ground, if the file or the capture tells.
    pub up: Option<[f64; 3]>,
    /// A sphere that holds the cameras of its capture, if the file or the capture tells. Gaussians may lie hundreds of radii away.
    pub cameras: Option<Sphere>,
    /// Colour that the scene was trained over and that is to be seen behind it, RGB in \[0, 1\], if the file or the training tells. Written as a
    /// shell of Gaussians about the others, which none of these are: other programs know of no background.
    pub background: Option<[f32; 3]>,
    /// Number of opacities of exactly 0 or 1 (infinite logits), which are read as nearly that; where the format knows logits.
    pub saturated: usize,
    /// Things that a reader left out or changed beside those.
    pub remarks: Vec<String>,
}

impl SceneFile {
    /// A scene without marks.
    #[must_use]
    pub fn new(splats: Gaussians) -> Self {
        Self {
            splats,
            anti_aliased: false,
            up: None,
            cameras: None,
            background: None,
            saturated: 0,
            remarks: Vec::new(),
        }
    }

    /// A scene as training leaves it: with each Gaussian's 3D filter (standard deviations `filter` \[N\], local units) merged into its
    /// scales and opacity, and marked for the 2D filter, unless `filter` is empty.
    ///
    /// # Errors
    /// [`Error::Numerics`] for a filter of another length.
    pub fn trained(splats: &Gaussians, filter: &[f32]) -> Result<Self> {
        let anti_aliased = !filter.is_empty();
        let splats = match anti_aliased {
            true => splats.filtered(filter)?,
            false => splats.clone(),
        };
        Ok(Self {
            anti_aliased,
            ..Self::new(splats)
        })
    }

    /// Sentences on what the reader changed.
    #[must_use]
    pub fn changes(&self) -> Vec<String> {
        let mut changes = self.remarks.clone();
        if self.saturated > 0 {
            changes.push(format!(
                "{} opacities are exactly 0 or 1 and are taken for nearly that (the scene comes from a format of 8 bits)",
                self.saturated
            ));
        }
        changes
    }
}

/// Contents of a scene file or point cloud, in the local frame.
#[derive(Debug, Clone)]
pub enum Contents {
    /// Gaussians.
    Scene(SceneFile),
    /// A plain point cloud: no 3DGS properties.
    Points(Points),
}

/// Gaussians of a file in the dataset's frame, moved to the local one.
///
/// # Errors
/// [`Error::Input`] for a value that is not finite or beyond single precision.
pub(super) fn localized(
    path: &Path,
    sh_degree: u32,
    mut planes: Vec<Vec<f32>>,
    frame: &Frame,
) -> Result<Gaussians> {
    let stretch = frame.scale.ln();
    for (k, center) in frame.center.to_array().into_iter().enumerate() {
        for v in &mut planes[Plane::POSITION + k] {
            *v = ((f64::from(*v) - center) / frame.scale) as f32;
        }
        for v in &mut planes[Plane::LOG_SCALE + k] {
            *v = (f64::from(*v) - stretch) as f32;
        }
    }
    let bad = |plane: &Vec<f32>| plane.iter().position(|v| !v.is_finite());
    if let Some(i) = planes.iter().find_map(bad) {
        let what = format!("a parameter of Gaussian {i} is beyond single precision");
        return Err(Error::input(path, what, "remove the Gaussian"));
    }
    Gaussians::new(sh_degree, planes)
}

/// Gaussians of the local frame, moved to the dataset's in f64 and rounded to f32.
///
/// # Errors
/// [`Error::Numerics`] for a parameter that is then not finite.
pub(super) fn in_dataset(splats: &Gaussians, frame: &Frame) -> Result<Gaussians> {
    let mut moved = splats.clone();
    let stretch = frame.scale.ln();
    for i in 0..splats.len() {
        let position: [f32; 3] = splats.gather(Plane::POSITION, i);
        let position = frame.to_dataset(DVec3::from_array(position.map(f64::from)));
        moved.scatter(Plane::POSITION, i, position.as_vec3().to_array());
        let scales: [f32; 3] = splats.gather(Plane::LOG_SCALE, i);
        let scales = scales.map(|s| (f64::from(s) + stretch) as f32);
        moved.scatter(Plane::LOG_SCALE, i, scales);
    }
    // Checked as a whole, with the plane named.
    let (degree, planes) = (moved.sh_degree(), moved.planes().to_vec());
    Gaussians::new(degree, planes)
}

/// Half a turn from the axes right, down, front, which PLY files mostly have, to others, and back.
#[derive(Clone, Copy)]
pub(super) enum HalfTurn {
    /// About x, to right, up, back of SPZ.
    X,
    /// About z, to left, up, front of glTF.
    Z,
}

impl HalfTurn {
    /// Axes that change sign, and coefficients of spherical harmonics that do.
    fn signs(self) -> ([usize; 2], [usize; 8]) {
        match self {
            Self::X => ([1, 2], [1, 2, 4, 7, 9, 11, 12, 14]),
            Self::Z => ([0, 1], [1, 3, 5, 7, 9, 11, 13, 15]),
        }
    }

    /// Turns Gaussians.
    pub(super) fn turn(self, splats: &mut Gaussians) {
        let (axes, odd) = self.signs();
        let bands = odd
            .into_iter()
            .flat_map(|k| (0..3).map(move |c| Plane::SH + 3 * k + c));
        let moved = axes.map(|k| Plane::POSITION + k).into_iter();
        let turned = axes.map(|k| Plane::ROTATION + 1 + k);
        let count = splats.planes().len();
        for plane in moved.chain(turned).chain(bands).filter(|p| *p < count) {
            splats.plane_mut(plane).iter_mut().for_each(|v| *v = -*v);
        }
    }
}

/// The rotation of a Gaussian as a unit quaternion w, x, y, z; the identity for one without a direction.
pub(super) fn unit(quaternion: [f32; 4]) -> [f64; 4] {
    let q = quaternion.map(f64::from);
    let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    match norm > 0.0 {
        true => q.map(|v| v / norm),
        false => [1.0, 0.0, 0.0, 0.0],
    }
}

/// Index of the largest component of a unit quaternion and the three others, in their order, of the sign for which that is positive.
pub(super) fn smallest_three(q: [f64; 4]) -> (usize, [f64; 3]) {
    let larger = |best: usize, k: usize| if q[k].abs() > q[best].abs() { k } else { best };
    let largest = (1..4).fold(0, larger);
    let sign = 1.0_f64.copysign(q[largest]);
    let others: Vec<f64> = (0..4)
        .filter(|k| *k != largest)
        .map(|k| sign * q[k])
        .collect();
    (largest, [others[0], others[1], others[2]])
}

/// The quaternion that [`smallest_three`] takes apart.
pub(super) fn from_smallest_three(largest: usize, [a, b, c]: [f64; 3]) -> [f64; 4] {
    let rest = (1.0 - a * a - b * b - c * c).max(0.0).sqrt();
    match largest {
        0 => [rest, a, b, c],
        1 => [a, rest, b, c],
        2 => [a, b, rest, c],
        _ => [a, b, c, rest],
    }
}

/// The logit of an opacity, limited where it is infinite.
pub(super) fn limited_logit(opacity: f64) -> f32 {
    logit(opacity).clamp(-SATURATED, SATURATED) as f32
}

/// Rounds to whole numbers within a range, and counts what lies outside of it.
#[derive(Default)]
pub(super) struct Rounding {
    /// Values that were moved by more than a rounding.
    pub(super) clamped: usize,
}

impl Rounding {
    /// The nearest whole number of at least 0 and at most `most`.
    pub(super) fn round(&mut self, value: f64, most: u32) -> u32 {
        let most = f64::from(most);
        if !(value >= -0.5 && value <= most + 0.5) {
            self.clamped += 1;
        }
        value.round().clamp(0.0, most) as u32
    }

    /// The nearest whole number of 8 bits.
    pub(super) fn byte(&mut self, value: f64) -> u8 {
        self.round(value, 255) as u8
    }

    /// A sentence on what was clamped, if anything.
    pub(super) fn remark(&self, what: &str, range: &str) -> Option<String> {
        let n = self.clamped;
        (n > 0).then(|| format!("{n} {what} outside of the format's range ({range}) were clamped"))
    }
}
