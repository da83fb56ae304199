//! Options that are one of a few names. The documentation of a [`ValueEnum`]'s variants is also what `--help` says about them.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};

use crate::config::values::NumberOrText;

/// Use of Mip-Splatting's filters (Yu et al., CVPR 2024): each Gaussian is widened to the finest detail that the training views
/// resolve (3D filter), and blurred by a pixel without getting brighter (2D filter).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default, ValueEnum)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum AntiAliasing {
    /// On if the training views' sampling rates differ much.
    #[default]
    Auto,
    /// Mip-Splatting's 2D and 3D filters.
    On,
    /// Neither filter.
    Off,
}

/// Use of an affine colour transform for every training photo (\[3DGS\], later versions).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default, ValueEnum)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum ExposureChoice {
    /// On if photos differ in brightness by more than their content explains.
    #[default]
    Auto,
    /// A colour transform for every training photo.
    On,
    /// No colour transform.
    Off,
}

/// Size of the photos that a run trains on, over the size asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
pub enum TrainingSize {
    /// All of it.
    #[default]
    #[serde(rename = "full")]
    Full,
    /// Three quarters of each side.
    #[serde(rename = "3/4")]
    ThreeQuarters,
    /// Three quarters of three quarters.
    #[serde(rename = "9/16")]
    NineSixteenths,
}

impl TrainingSize {
    /// All of them, the largest first.
    pub const ALL: [Self; 3] = [Self::Full, Self::ThreeQuarters, Self::NineSixteenths];

    /// Returns numerator and denominator of the fraction of a side.
    #[must_use]
    pub fn fraction(self) -> [u32; 2] {
        match self {
            Self::Full => [1, 1],
            Self::ThreeQuarters => [3, 4],
            Self::NineSixteenths => [9, 16],
        }
    }

    /// Returns the fraction of the pixels.
    #[must_use]
    pub fn area(self) -> f64 {
        let [num, den] = self.fraction().map(f64::from);
        (num / den).powi(2)
    }

    /// Returns true for all of the size.
    #[must_use]
    pub fn is_full(&self) -> bool {
        *self == Self::Full
    }
}

/// Length of a run in a word: its time depends on photos, scene and device, and is told after the first iterations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Preset {
    /// 1500 iterations: is the capture any good?
    Draft,
    /// 7000 iterations.
    Standard,
    /// 30,000 iterations, those of the papers.
    Best,
}

impl Preset {
    /// All of them, the shortest first.
    pub const ALL: [Self; 3] = [Self::Draft, Self::Standard, Self::Best];

    /// Returns the iterations of the run.
    #[must_use]
    pub fn iterations(self) -> u32 {
        match self {
            Self::Draft => 1500,
            Self::Standard => 7000,
            Self::Best => 30_000,
        }
    }

    /// Returns its name on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Draft => "draft",
            Self::Standard => "standard",
            Self::Best => "best",
        }
    }
}

/// Format of a scene file; `scene.ply` is written anyway.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum SceneFormat {
    /// Inria's PLY.
    #[value(skip)]
    #[serde(skip)]
    Ply,
    /// PlayCanvas' compressed PLY, a quarter of the size.
    CompressedPly,
    /// Niantic's SPZ, about a tenth of the size.
    Spz,
    /// SPZ of version 4.
    SpzV4,
    /// antimatter15's .splat, without view-dependent colour.
    Splat,
    /// Binary glTF with KHR_gaussian_splatting, of the PLY's size.
    Glb,
}

/// Measure of a birth's effect on the loss in the acceptance ratio ρ. The importance is that of \[MH\] Eq. 18–20; the first-order
/// estimate is not in \[MH\]: σ(I) of Eq. 20 becomes σ(−ΔL/s), s being the mean |ΔL| over the step's proposals. Sources are drawn
/// by importance with either. Births are faint with the estimate unless `mh.birth` says otherwise.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default, ValueEnum)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Surrogate {
    /// The importance of its source.
    #[default]
    Importance,
    /// The first-order estimate of the birth, computed over a few views.
    Probe,
}

/// Form of the acceptance ratio ρ; D = 1/(1 + λ_v·c) is the voxel prior's factor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Acceptance {
    /// ρ = σ(I)·D (\[MH\] Eq. 20).
    #[default]
    Eq20,
    /// ρ = I·D (\[MH\] Alg. 1).
    Alg1,
    /// ρ = σ(I − ½)·D (the released implementation).
    Centred,
    /// ρ = exp(−λ_v·[ln(2+c) − ln(1+c)]): the ratio of the priors before and after the birth by Eq. 7, neither approximated
    /// nor weighted, of a birth whose source stays in its voxel. I then decides which sources are drawn, and nothing else.
    ExactPrior,
}

/// Opacity and scale of a birth and of its source.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Birth {
    /// The source keeps its own and the birth has the same (\[MH\] §4.3: other parameters are copied).
    Copy,
    /// Birth and source are two parts of what the source was, apart from each other along one of its axes, that have its mean and covariance together and
    /// paint as much at right angles to the axis (Richardson and Green 1997, the split move).
    Split,
    /// The source keeps its own; the birth has `birth-scale` times its scale, and the lesser of its opacity and `birth-opacity`.
    Faint,
}

/// Number of views that a step's error maps are of (\[MH\] Eq. 10); written `"shrinking"`, `"all"` or a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(try_from = "NumberOrText<u32>", into = "NumberOrText<u32>")]
#[non_exhaustive]
pub enum ViewSubset {
    /// k = max(1, ⌊views·(1−η)⌋) (Eq. 10).
    #[default]
    Shrinking,
    /// Every view.
    All,
    /// This number of views, or all if there are fewer.
    Fixed(u32),
}

impl TryFrom<NumberOrText<u32>> for ViewSubset {
    type Error = &'static str;
    fn try_from(value: NumberOrText<u32>) -> Result<Self, Self::Error> {
        match value {
            NumberOrText::Number(k) if k > 0 => Ok(Self::Fixed(k)),
            NumberOrText::Text(word) if word == "shrinking" => Ok(Self::Shrinking),
            NumberOrText::Text(word) if word == "all" => Ok(Self::All),
            _ => Err("\"shrinking\", \"all\" or a number of at least 1 expected"),
        }
    }
}

impl From<ViewSubset> for NumberOrText<u32> {
    fn from(value: ViewSubset) -> Self {
        match value {
            ViewSubset::Shrinking => Self::Text("shrinking".into()),
            ViewSubset::All => Self::Text("all".into()),
            ViewSubset::Fixed(k) => Self::Number(k),
        }
    }
}
