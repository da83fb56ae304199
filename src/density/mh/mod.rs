//! Metropolis–Hastings density control (\[MH\] = Kim, Jung, Park, NeurIPS 2025, §4 and Alg. 1).
//!
//! One step: dead Gaussians are relocated (Eq. 17), voxels are counted, then births are proposed and decided twice, far
//! from their sources and near (Eq. 14–16, 20). Within a phase every proposal sees the same counts, which keeps it
//! parallel; births of the coarse phase are counted before the fine phase begins.

pub mod accept;
mod births;
pub mod importance;
mod pixel;
pub mod sparsity;

use super::draw::{Categorical, birth_position, gather};
use super::relocate::Relocation;
use super::{
    Cues, DensityControl, Edit, Evidence, NoiseLaw, Outcome, SceneState, StepContext, Wanted,
    check_lengths, numerics, unexpected,
};
use crate::config::{MhConfig, ViewSubset};
use crate::error::Result;
use crate::rng::{Philox, Purpose};
use births::Births;
use rayon::prelude::*;
use sparsity::{Lattice, VoxelCounts};

/// k of the noise's gate (\[MCMC\] Eq. 8).
const NOISE_STEEPNESS: f64 = 100.0;

/// Density control by Metropolis–Hastings births and relocation.
#[derive(Debug, Clone)]
pub struct MetropolisHastings {
    config: MhConfig,
}

/// One of the two phases of a step.
struct Phase {
    proposals: usize,
    spread: f64,
    /// Streams of source, offset and acceptance.
    streams: [u64; 3],
}

/// How a birth was proposed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Pixel,
    Coarse,
    Fine,
}

/// A birth to be decided on.
struct Proposal {
    edit: Edit,
    /// D(v′).
    prior: f64,
    ln_rho: f64,
    /// Uniform in [0, 1).
    u: f64,
}

/// A decided proposal.
struct Decision {
    /// What would be written; `dst` is set once it is known who is born.
    edit: Edit,
    /// D(v′).
    prior: f64,
    accepted: bool,
    /// ln(u/ρ^{1/T}): of accepted ones uniform noise, by which those are drawn that there is room for.
    lot: f64,
}

/// What both phases of a step read.
struct Step<'a> {
    context: &'a StepContext<'a>,
    scene: &'a SceneState<'a>,
    relocation: &'a Relocation,
    /// Importance of each row.
    importance: &'a [f64],
    /// Over `relocation.alive_rows`.
    sources: Categorical,
}

impl MetropolisHastings {
    /// Density control with these settings.
    #[must_use]
    pub fn new(config: &MhConfig) -> Self {
        Self { config: *config }
    }

    fn phases(&self, context: &StepContext<'_>) -> [Phase; 2] {
        let eta = context.progress;
        let c = &self.config;
        let phase = |proposals: u32, spread: [f64; 2], streams: [Purpose; 3]| Phase {
            proposals: shrinking(proposals as usize, eta),
            spread: lerp(spread, eta),
            streams: streams.map(|s| s.stream(context.iteration)),
        };
        use Purpose::*;
        [
            phase(
                c.coarse_proposals,
                c.coarse_spread,
                [CoarseDraw, CoarseOffset, CoarseAccept],
            ),
            phase(
                c.fine_proposals,
                c.fine_spread,
                [FineDraw, FineOffset, FineAccept],
            ),
        ]
    }

    /// Decides each proposal of a phase by ρ^{1/T}.
    fn decide(&self, proposals: Vec<Proposal>, eta: f64) -> Vec<Decision> {
        let c = &self.config;
        let wanted = lerp(c.target_acceptance, eta);
        let temperature = if wanted > 0.0 {
            let ln_rhos: Vec<f64> = proposals.iter().map(|p| p.ln_rho).collect();
            accept::temperature_for(&ln_rhos, wanted)
        } else {
            lerp(c.temperature, eta)
        };
        let decided = |p: Proposal| {
            let ln_rho = p.ln_rho / temperature;
            Decision {
                edit: p.edit,
                prior: p.prior,
                accepted: accept::accepts(p.u, ln_rho),
                lot: p.u.ln() - ln_rho,
            }
        };
        proposals.into_iter().map(decided).collect()
    }

    /// Draws the proposals of a phase, each with its ratio against the counts as they are. One that would land at a
    /// non-finite position is not proposed.
    fn propose(&self, step: &Step<'_>, phase: &Phase, counts: &VoxelCounts<'_>) -> Vec<Proposal> {
        let [draw, offset, accept] = phase.streams;
        let seed = step.context.seed;
        let lambda = self.config.lambda_voxel;
        step.sources
            .draw_unique(phase.proposals, seed, draw)
            .into_par_iter()
            .filter_map(|drawn| {
                let row = *step.relocation.alive_rows.get(drawn)?;
                let i = row as usize;
                // Opacity and log-scale as relocation left them.
                let (log_scale, opacity_logit) = match step.relocation.source(row) {
                    Some(edit) => (edit.log_scale, edit.opacity_logit),
                    None => (
                        gather(&step.scene.log_scales, i)?,
                        *step.scene.opacity_logits.get(i)?,
                    ),
                };
                let [x, y, z, _] = Philox::normal(seed, offset, u64::from(row));
                let position = birth_position(step.scene, i, log_scale, phase.spread, [x, y, z])?;
                let count = counts.get(position.map(f64::from));
                let ln_rho = accept::ln_acceptance(
                    self.config.acceptance,
                    *step.importance.get(i)?,
                    lambda,
                    count,
                );
                Some(Proposal {
                    edit: Edit {
                        src: row,
                        dst: row,
                        position,
                        log_scale,
                        opacity_logit,
                        color: None,
                    },
                    prior: accept::voxel_prior(lambda, count),
                    ln_rho,
                    u: Philox::uniform(seed, accept, u64::from(row))[0],
                })
            })
            .collect()
    }

    fn check(
        &self,
        context: &StepContext<'_>,
        scene: &SceneState<'_>,
        cues: &Cues<'_>,
    ) -> Result<()> {
        self.config.validate()?;
        if !context.progress.is_finite() {
            return Err(numerics(format!(
                "progress is {}; 0 to 1 expected",
                context.progress
            )));
        }
        check_lengths(scene, [cues.ssim.len(), cues.l1.len(), cues.views.len()])
    }

    /// Voxel counts of the state that proposals are made in, the one after relocation: moved rows count where they are now.
    fn counts<'a>(
        &self,
        context: &StepContext<'a>,
        scene: &SceneState<'_>,
        relocation: &Relocation,
    ) -> VoxelCounts<'a> {
        let edge = lerp(self.config.voxel_edge, context.progress);
        let lattice = Lattice::growing(edge, self.config.voxel_growth_from, context.cameras);
        let mut counts =
            VoxelCounts::count_where(scene.positions, lattice, |i| relocation.alive[i]);
        for edit in relocation.moved_edits() {
            counts.add(edit.position.map(f64::from));
        }
        counts
    }

    /// I of every row (Eq. 13); ½ if it is switched off.
    fn importance(&self, scene: &SceneState<'_>, cues: &Cues<'_>) -> Vec<f64> {
        let c = &self.config;
        if !c.importance {
            return vec![0.5; scene.len()];
        }
        let weights = [c.weight_opacity, c.weight_ssim, c.weight_l1];
        importance::importance(scene.opacity_logits, cues, weights).values
    }
}

impl DensityControl for MetropolisHastings {
    /// The view subset of Eq. 10, or nothing where no cue of errors has a weight.
    fn wanted(&self, views: usize, progress: f64) -> Wanted {
        if !self.config.wants_errors() {
            return Wanted::Nothing;
        }
        let views = match self.config.view_subset {
            ViewSubset::Shrinking => shrinking(views, progress),
            ViewSubset::All => views,
            ViewSubset::Fixed(k) => views.min(k as usize),
        };
        Wanted::Errors { views }
    }

    fn noise(&self) -> Option<NoiseLaw> {
        (self.config.noise_rate > 0.0).then(|| NoiseLaw {
            rate: self.config.noise_rate,
            steepness: NOISE_STEEPNESS,
            opacity: self.config.dead_opacity,
        })
    }

    fn pictures(&self, _progress: f64) -> usize {
        match self.config.pixel_proposals {
            0 => 0,
            _ => self.config.pixel_views as usize,
        }
    }

    fn step(
        &mut self,
        context: &StepContext<'_>,
        scene: &SceneState<'_>,
        evidence: &Evidence<'_>,
    ) -> Result<Outcome> {
        // Without cues every Gaussian is one that no view saw.
        let unseen = (vec![0.0; scene.len()], vec![0; scene.len()]);
        let cues = match evidence {
            Evidence::Errors(cues) => *cues,
            Evidence::Nothing if !self.config.wants_errors() => Cues {
                ssim: &unseen.0,
                l1: &unseen.0,
                views: &unseen.1,
            },
            _ => return Err(unexpected()),
        };
        self.check(context, scene, &cues)?;
        let context = &StepContext {
            progress: context.progress.clamp(0.0, 1.0),
            ..*context
        };
        let (c, eta) = (&self.config, context.progress);
        let relocation = if c.relocation {
            Relocation::plan(context, scene, c.dead_opacity)
        } else {
            Relocation::none(scene, c.dead_opacity)
        };
        let mut counts = self.counts(context, scene, &relocation);
        let importance = self.importance(scene, &cues);
        let alive = relocation.alive_rows.par_iter();
        let weights: Vec<f64> = alive.map(|&r| importance[r as usize]).collect();
        let step = Step {
            context,
            scene,
            relocation: &relocation,
            importance: &importance,
            sources: Categorical::new(&weights),
        };
        let mut births = Births::new(scene.len(), context.max_gaussians);
        // Where room is short, voids come first.
        let pictured = !(context.pictures.is_empty() || births.full());
        if let (Some(&row), true) = (relocation.alive_rows.first(), pictured) {
            let proposals = pixel::propose(c, context, row, &counts);
            births.take(Kind::Pixel, &self.decide(proposals, eta), &mut counts);
        }
        for (kind, phase) in [Kind::Coarse, Kind::Fine]
            .into_iter()
            .zip(self.phases(context))
        {
            if births.full() {
                break;
            }
            let proposals = self.propose(&step, &phase, &counts);
            births.take(kind, &self.decide(proposals, eta), &mut counts);
        }
        Ok(births.finish((c.birth, c.birth_opacity), scene, relocation, &counts))
    }
}

/// max(1, ⌊count·(1−η)⌋); 0 stays 0, so that a phase can be switched off. The small allowance keeps 10·(1−0.4) at 6.
fn shrinking(count: usize, eta: f64) -> usize {
    let left = (count as f64 * (1.0 - eta.clamp(0.0, 1.0)) + 1e-9).floor() as usize;
    left.clamp(1.min(count), count)
}

/// Linear between the values at η = 0 and η = 1.
pub(crate) fn lerp([start, end]: [f64; 2], eta: f64) -> f64 {
    start + (end - start) * eta
}
