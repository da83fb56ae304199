//! Births before they are decided on, and after.

use crate::base::error::Result;
use crate::density::mh::accept;
use crate::density::outcome::BirthKind;
use crate::density::relocation::Relocation;
use crate::density::state::numerics;
use crate::scene::Edit;

/// A birth to be decided on.
pub(super) struct Proposal {
    /// The Gaussian to be written; `dst` is set once it is known which births are accepted.
    pub(super) edit: Edit,
    /// The edit of its source if that splits.
    pub(super) source_edit: Option<Edit>,
    /// Importance I of the source or pixel.
    pub(super) importance: f64,
    /// First-order change of the loss; `None` before an estimate.
    pub(super) change: Option<f64>,
    /// The part of ln ρ that stands for the change of the loss.
    pub(super) ln_gain: f64,
    /// Uniform random number in [0, 1).
    pub(super) u: f64,
}

/// A decided proposal.
pub(super) struct Decision<'a> {
    /// The proposal.
    pub(super) proposal: &'a Proposal,
    /// Gaussians in its voxel.
    pub(super) voxel_count: u32,
    /// D(v′).
    pub(super) prior: f64,
    /// ln ρ^{1/T}.
    pub(super) ln_ratio: f64,
}

impl Decision<'_> {
    /// True if ln u < ln ρ^{1/T}.
    pub(super) fn accepted(&self) -> bool {
        accept::accepts(self.proposal.u, self.ln_ratio)
    }

    /// ln(u/ρ^{1/T}): uniform noise among the accepted, which decides if there is not room for all.
    pub(super) fn tie_break(&self) -> f64 {
        self.proposal.u.ln() - self.ln_ratio
    }
}

/// The state of a step before the births are decided on.
pub(super) struct Proposals {
    /// Alive and dead rows, and the relocation of the dead.
    pub(super) relocation: Relocation,
    /// Rows of the dead if this step removes them; else empty.
    pub(super) removed: Vec<u32>,
    /// Births in image space, coarse, fine, in the order of decision.
    pub(super) phases: [(BirthKind, Vec<Proposal>); 3],
    /// Importance of each row.
    pub(super) importance: Vec<f64>,
}

impl Proposals {
    /// Replaces the importance by computed changes of the loss, one per proposal.
    ///
    /// # Errors
    /// Another number of changes.
    pub(super) fn weigh(&mut self, changes: &[f64]) -> Result<()> {
        let proposals = self.phases.iter_mut().flat_map(|(_, all)| all);
        let mut proposals: Vec<&mut Proposal> = proposals.collect();
        if proposals.len() != changes.len() {
            return Err(numerics(format!(
                "{} changes of the loss; {} expected",
                changes.len(),
                proposals.len()
            )));
        }
        let gains = accept::ln_gains(changes);
        for ((proposal, gain), change) in proposals.iter_mut().zip(gains).zip(changes) {
            proposal.ln_gain = gain;
            proposal.change = Some(*change);
        }
        Ok(())
    }
}
