//! Statistics of each Gaussian that the device gathers between two density steps.

use crate::base::error::Error;
use crate::density::state::numerics;

/// Error statistics of each Gaussian over the view subset (\[MH\] Eq. 11, 13), each slice of length N.
#[derive(Debug, Clone, Copy)]
pub struct ErrorStatistics<'a> {
    /// Sum over the seeing views of 1 − SSIM at the pixel under the projected centre.
    pub ssim: &'a [f32],
    /// Sum over the seeing views of the L1 error there.
    pub l1: &'a [f32],
    /// Number of views of the subset that see the centre.
    pub views: &'a [u32],
}

/// Gradients of the projected centre of each Gaussian since the last step (\[3DGS\] §5.2), each slice of length N.
#[derive(Debug, Clone, Copy)]
pub struct ScreenGradient<'a> {
    /// Sum over the iterations that saw it of the norm of the loss gradient of the projected centre, in normalised device
    /// coordinates.
    pub norms: &'a [f32],
    /// Number of those iterations.
    pub views: &'a [u32],
}

/// The kind of statistics that a strategy reads in a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StatisticsKind {
    /// None: it decides from the parameters alone.
    Nothing,
    /// [`ErrorStatistics`] of the last so many renders of training.
    Errors {
        /// Number of renders.
        views: usize,
    },
    /// [`ScreenGradient`] of every iteration since the last step.
    ScreenGradient,
}

impl StatisticsKind {
    /// Number of values per Gaussian that are gathered on the device.
    #[must_use]
    pub fn rows(self) -> usize {
        match self {
            Self::Nothing => 0,
            Self::Errors { .. } => 3,
            Self::ScreenGradient => 2,
        }
    }
}

/// Gathered statistics, of the kind that [`DensityControl::wanted`](crate::density::DensityControl::wanted) names.
#[derive(Debug, Clone, Copy)]
pub enum Statistics<'a> {
    /// None.
    Nothing,
    /// Errors under the projected centres.
    Errors(ErrorStatistics<'a>),
    /// Gradients of the projected centres.
    ScreenGradient(ScreenGradient<'a>),
}

/// The error of a step that got statistics of another kind than its strategy names.
pub(super) fn unexpected() -> Error {
    numerics("the statistics are of another kind than the strategy reads".into())
}
