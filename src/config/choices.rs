//! Choices by name among the settings of Metropolis–Hastings density control, each with its equation in \[MH\].

use serde::{Deserialize, Serialize};

use crate::base::error::{Error, Result};

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
    /// ρ = exp(−λ_v·[ln(2+c) − ln(1+c)]): the ratio of the priors before and after the birth as Eq. 7 has it, neither
    /// approximated nor weighted. I decides then which sources are drawn, and no more.
    ExactPrior,
}

/// What a birth takes of its source's opacity and scale.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Birth {
    /// The source keeps its own and the birth has the same (\[MH\] §4.3: other parameters are copied).
    Copy,
    /// Source and births share the source's opacity and scale, as relocation does (\[MCMC\] Eq. 9), so that a birth adds
    /// no opacity to the scene.
    Split,
    /// The source keeps its own; the birth has its scale, and its opacity or `birth-opacity`, whichever is less. A birth lands
    /// up to several scales from its source, where it mostly spoils the picture at first: a faint one spoils little.
    #[default]
    Faint,
}

/// What stands for the loss change of a birth in ρ.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Surrogate {
    /// The importance I of its source (\[MH\] Eq. 18–20).
    #[default]
    Importance,
    /// Its first-order change ΔL of the loss over a few views, computed for all proposals of a step at once; not in \[MH\].
    /// σ(I) of Eq. 20 becomes σ(−ΔL/s), s being the mean |ΔL| over the step's proposals. Which sources are drawn is
    /// still up to I.
    Probe,
}

/// How many views a step judges by (Eq. 10); written `"shrinking"`, `"all"` or a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(try_from = "WordOrNumber", into = "WordOrNumber")]
#[non_exhaustive]
pub enum ViewSubset {
    /// k = max(1, ⌊views·(1−η)⌋) (Eq. 10).
    #[default]
    Shrinking,
    /// Every view.
    All,
    /// So many, or all if there are fewer.
    Fixed(u32),
}

#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum WordOrNumber {
    Number(u32),
    Word(String),
}

impl TryFrom<WordOrNumber> for ViewSubset {
    type Error = Error;
    fn try_from(value: WordOrNumber) -> Result<Self> {
        match value {
            WordOrNumber::Number(k) if k > 0 => Ok(Self::Fixed(k)),
            WordOrNumber::Word(word) if word == "shrinking" => Ok(Self::Shrinking),
            WordOrNumber::Word(word) if word == "all" => Ok(Self::All),
            _ => Err(Error::config(
                "mh.view-subset",
                "\"shrinking\", \"all\" or a number of at least 1 expected",
            )),
        }
    }
}

impl From<ViewSubset> for WordOrNumber {
    fn from(value: ViewSubset) -> Self {
        match value {
            ViewSubset::Shrinking => Self::Word("shrinking".into()),
            ViewSubset::All => Self::Word("all".into()),
            ViewSubset::Fixed(k) => Self::Number(k),
        }
    }
}
