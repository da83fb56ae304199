//! Births before they are decided on, and after.

use crate::base::error::Result;
use crate::density::mh::accept;
use crate::density::relocate::Relocation;
use crate::density::{Edit, Trial, numerics, relocation};

/// How a birth was proposed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Pixel,
    Coarse,
    Fine,
}

/// A birth to be decided on.
pub(super) struct Proposal {
    pub(super) edit: Edit,
    /// The part of ln ρ that stands for the change of the loss.
    pub(super) ln_gain: f64,
    /// Uniform in [0, 1).
    pub(super) u: f64,
}

/// A decided proposal.
pub(super) struct Decision {
    /// What would be written; `dst` is set once it is known who is born.
    pub(super) edit: Edit,
    /// D(v′).
    pub(super) prior: f64,
    pub(super) accepted: bool,
    /// ln(u/ρ^{1/T}): of accepted ones uniform noise, by which those are drawn that there is room for.
    pub(super) lot: f64,
}

/// What a step knows before it decides: a function of its arguments, so that what is tried is what is decided on.
pub(super) struct Draft {
    pub(super) relocation: Relocation,
    /// The dead, if this step removes them.
    pub(super) removed: Vec<u32>,
    /// In image space, coarse, fine: the order of decision. Where room is short, what errs comes first, wherever it is.
    pub(super) proposals: [(Kind, Vec<Proposal>); 3],
}

impl Proposal {
    /// The birth as it would be if it were its source's only one in the step.
    pub(super) fn trial(&self, shares: bool) -> Trial {
        let mut birth = self.edit;
        if !shares {
            return Trial {
                birth,
                source_change: None,
            };
        }
        let own = f64::from(birth.opacity_logit);
        let part = relocation::split(own, 2);
        let widened = part.log_scale_offset;
        birth.log_scale = birth.log_scale.map(|s| (f64::from(s) + widened) as f32);
        birth.opacity_logit = part.opacity_logit as f32;
        Trial {
            birth,
            source_change: Some([part.opacity_logit - own, widened, widened, widened]),
        }
    }
}

impl Draft {
    /// Puts computed changes of the loss, one per proposal, in the place of the importance.
    pub(super) fn weigh(&mut self, changes: &[f64]) -> Result<()> {
        let proposals = self.proposals.iter_mut().flat_map(|(_, all)| all);
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
