//! Results of a density step: edits, removals and counters.

use crate::scene::Edit;

/// Counters of one density step, or their sums over a run; in the order of the columns of `density.csv`.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct DensityStats {
    /// Number of proposed births.
    pub proposed: u64,
    /// Number of accepted births.
    pub accepted: u64,
    /// Number of dead Gaussians that were relocated.
    pub relocated: u64,
    /// Number of Gaussians removed.
    pub pruned: u64,
    /// Births of the coarse phase: proposed, accepted.
    pub coarse: [u64; 2],
    /// Births of the fine phase: proposed, accepted.
    pub fine: [u64; 2],
    /// Number of occupied voxels at the end of the (last) step.
    pub occupied_voxels: u64,
    /// Mean of D(v′) over the proposals of the (last) step.
    pub mean_prior: f64,
    /// Number of clones: births that copy their source (adc).
    #[serde(default)]
    pub cloned: u64,
    /// Number of splits: births that share the room of their source (adc).
    #[serde(default)]
    pub split: u64,
    /// Number of opacity resets (adc).
    #[serde(default)]
    pub opacity_resets: u64,
    /// Births in image space (mh): proposed, accepted.
    #[serde(default)]
    pub pixel: [u64; 2],
}

impl DensityStats {
    /// Adds a later step: counters are summed, the two gauges (`occupied_voxels`, `mean_prior`) take its values. A step
    /// that proposed nothing leaves `mean_prior` as it was, for it has none.
    pub fn add(&mut self, step: &Self) {
        self.proposed += step.proposed;
        self.accepted += step.accepted;
        self.relocated += step.relocated;
        self.pruned += step.pruned;
        self.cloned += step.cloned;
        self.split += step.split;
        self.opacity_resets += step.opacity_resets;
        for k in 0..2 {
            self.coarse[k] += step.coarse[k];
            self.fine[k] += step.fine[k];
            self.pixel[k] += step.pixel[k];
        }
        self.occupied_voxels = step.occupied_voxels;
        if step.proposed > 0 {
            self.mean_prior = step.mean_prior;
        }
    }
}

/// The way in which a birth was proposed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BirthKind {
    /// In image space.
    Pixel,
    /// About its source, in the coarse phase.
    Coarse,
    /// About its source, in the fine phase.
    Fine,
}

/// The circumstances of an accepted birth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BirthRecord {
    /// Row of the birth.
    pub dst: u32,
    /// Row of its source; `None` for a birth in image space.
    pub source: Option<u32>,
    /// Way in which it was proposed.
    pub kind: BirthKind,
    /// Importance I of the source or pixel.
    pub importance: f64,
    /// First-order estimate: the change of the loss; `None` if births are not estimated.
    pub change: Option<f64>,
    /// ln ρ^{1/T}.
    pub ln_ratio: f64,
    /// Gaussians in its voxel before it.
    pub voxel_count: u32,
}

/// The outcome of a density step: edits, then an opacity reset, then removals.
#[derive(Debug, Clone, Default)]
pub struct Outcome {
    /// Rows to write; appended rows are N, N+1, … without a gap.
    pub edits: Vec<Edit>,
    /// Number of rows after the edits.
    pub rows: usize,
    /// Upper limit that every opacity logit is lowered to, all moments of opacities being zeroed; `None` without a reset.
    pub logit_limit: Option<f32>,
    /// Rows to remove, rising; never all of them.
    pub removed: Vec<u32>,
    /// Accepted births with what decided on them (mh), in the order of their rows.
    pub births: Vec<BirthRecord>,
    /// Importance I of each row after the edits, that of its source where it was written (mh) \[rows\]; empty otherwise.
    pub importance: Vec<f64>,
    /// Counters of this step.
    pub stats: DensityStats,
}

impl Outcome {
    /// The outcome that leaves all `rows` rows unchanged.
    #[must_use]
    pub fn unchanged(rows: usize) -> Self {
        Self {
            rows,
            ..Self::default()
        }
    }

    /// Number of Gaussians afterwards.
    #[must_use]
    pub fn gaussians(&self) -> usize {
        self.rows - self.removed.len()
    }
}
