//! Anti-aliasing.

use serde::{Deserialize, Serialize};

/// Whether Gaussians are filtered as in Mip-Splatting (Yu et al., CVPR 2024): each is widened to what the training views can
/// tell apart (3D filter), and spread by the blur of a pixel without getting brighter (2D filter). Written `auto`, `on` or `off`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum AntiAliasing {
    /// On where the training views' sampling rates differ much (see [`crate::train::sampling_rates`]).
    #[default]
    Auto,
    /// Both filters.
    On,
    /// Neither.
    Off,
}
