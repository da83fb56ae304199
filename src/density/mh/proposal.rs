//! Births before they are decided on, and after.

use crate::base::error::Result;
use crate::density::control::Trial;
use crate::density::mh::accept;
use crate::density::relocation::{Relocation, split};
use crate::density::state::numerics;
use crate::scene::Edit;

/// The phase that proposed a birth.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// Births in image space.
    Pixel,
    /// Births far from their sources.
    Coarse,
    /// Births near their sources.
    Fine,
}

/// A birth to be decided on.
pub(super) struct Proposal {
    /// The Gaussian to be written; `dst` is set once it is known which births are accepted.
    pub(super) edit: Edit,
    /// The part of ln ρ that stands for the change of the loss.
    pub(super) ln_gain: f64,
    /// Uniform random number in [0, 1).
    pub(super) u: f64,
}

/// A decided proposal.
pub(super) struct Decision {
    /// That of the proposal.
    pub(super) edit: Edit,
    /// D(v′).
    pub(super) prior: f64,
    /// True if ln u < ln ρ^{1/T}.
    pub(super) accepted: bool,
    /// ln(u/ρ^{1/T}): uniform noise among the accepted, which decides if there is not room for all.
    pub(super) tie_break: f64,
}

/// The state of a step before the births are decided on.
pub(super) struct Proposals {
    /// Alive and dead rows, and the relocation of the dead.
    pub(super) relocation: Relocation,
    /// Rows of the dead if this step removes them; else empty.
    pub(super) removed: Vec<u32>,
    /// Births in image space, coarse, fine, in the order of decision: if room is short, pixels with large errors come first.
    pub(super) phases: [(Kind, Vec<Proposal>); 3],
}

impl Proposal {
    /// The birth to be probed: the one that would be written if it were its source's only one in the step.
    pub(super) fn trial(&self, shares: bool) -> Trial {
        let mut birth = self.edit;
        if !shares {
            return Trial {
                birth,
                source_change: None,
            };
        }
        let own = f64::from(birth.opacity_logit);
        let part = split(own, 2);
        let widened = part.log_scale_offset;
        birth.log_scale = birth.log_scale.map(|s| (f64::from(s) + widened) as f32);
        birth.opacity_logit = part.opacity_logit as f32;
        Trial {
            birth,
            source_change: Some([part.opacity_logit - own, widened, widened, widened]),
        }
    }
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
        for (proposal, gain) in proposals.iter_mut().zip(accept::ln_gains(changes)) {
            proposal.ln_gain = gain;
        }
        Ok(())
    }
}
