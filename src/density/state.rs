//! The set of Gaussians as density control sees it.

use crate::base::error::{Error, Result};

/// Raw parameters of N Gaussians, struct of arrays, each slice of length N.
#[derive(Debug, Clone, Copy)]
pub struct SceneState<'a> {
    /// Positions x, y, z, local units.
    pub positions: [&'a [f32]; 3],
    /// Natural log of the scales, local units.
    pub log_scales: [&'a [f32]; 3],
    /// Rotation quaternions w, x, y, z, of any norm.
    pub rotations: [&'a [f32]; 4],
    /// Opacity logits; −∞ for what stands in the free space about a camera (`TrainConfig::clearance`), which is to go as what is transparent.
    pub opacity_logits: &'a [f32],
}

impl SceneState<'_> {
    /// Number of Gaussians.
    #[must_use]
    pub fn len(&self) -> usize {
        self.opacity_logits.len()
    }

    /// True if there is no Gaussian.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.opacity_logits.is_empty()
    }

    /// Checks that all planes, and other slices (`lengths`), are of one length, and that 32 bits can number the rows.
    ///
    /// # Errors
    /// [`Error::Numerics`] with the length that differs.
    pub(super) fn check_lengths(&self, lengths: impl IntoIterator<Item = usize>) -> Result<()> {
        let n = self.len();
        if u32::try_from(n).is_err() {
            return Err(numerics(format!("{n} Gaussians; fewer than 2^32 expected")));
        }
        let planes = self.planes().map(<[f32]>::len);
        match planes.chain(lengths).find(|l| *l != n) {
            Some(l) => Err(numerics(format!(
                "a parameter or statistic has {l} values; {n} expected"
            ))),
            None => Ok(()),
        }
    }

    /// All planes but that of opacity.
    pub(super) fn planes(&self) -> impl Iterator<Item = &[f32]> {
        let planes = self.positions.iter().chain(&self.log_scales);
        planes.chain(&self.rotations).copied()
    }

    /// True if all parameters of a row are finite.
    pub(super) fn is_finite(&self, row: usize) -> bool {
        fn all<const K: usize>(planes: &[&[f32]; K], row: usize) -> bool {
            gather(planes, row).is_some_and(|values| values.iter().all(|v| v.is_finite()))
        }
        all(&[self.opacity_logits], row)
            && all(&self.positions, row)
            && all(&self.log_scales, row)
            && all(&self.rotations, row)
    }
}

/// One value of each plane at a row; `None` if a plane has no such row.
pub(super) fn gather<const K: usize>(planes: &[&[f32]; K], row: usize) -> Option<[f32; K]> {
    let mut values = [0.0; K];
    for (value, plane) in values.iter_mut().zip(planes) {
        *value = *plane.get(row)?;
    }
    Some(values)
}

/// The error of a density step on input that it cannot work with.
pub(super) fn numerics(what: String) -> Error {
    Error::numerics("density control", what)
}
