//! Metropolis–Hastings density control (\[MH\] = Kim, Jung, Park, NeurIPS 2025, §4 and Alg. 1).
//!
//! One step: dead Gaussians are relocated (Eq. 17), voxels are counted, then births are proposed and decided twice, far
//! from their sources and near (Eq. 14–16, 20). Within a phase every proposal sees the same counts, which keeps it
//! parallel; births of the coarse phase are counted before the fine phase begins.

pub mod accept;
pub mod importance;
pub mod sparsity;

use super::draw::{Categorical, birth_position, gather};
use super::relocate::{self, Relocation};
use super::{
    Cues, DensityControl, DensityStats, Edit, Evidence, Outcome, SceneState, StepContext, Wanted,
    check_lengths, numerics, unexpected,
};
use crate::config::{Birth, MhConfig};
use crate::error::{Error, Result};
use crate::rng::{Philox, Purpose};
use rayon::prelude::*;
use rustc_hash::FxHashSet;
use sparsity::VoxelCounts;

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

/// A decided proposal.
struct Decision {
    /// What would be written; `dst` is set once it is known who is born.
    edit: Edit,
    /// D(v′).
    prior: f64,
    accepted: bool,
}

/// What both phases of a step read.
struct Step<'a> {
    context: &'a StepContext,
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

    fn phases(&self, context: &StepContext) -> [Phase; 2] {
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

    /// Draws the proposals of a phase and decides each against the counts as they are. One that would land at a
    /// non-finite position is not proposed.
    fn decide(&self, step: &Step<'_>, phase: &Phase, counts: &VoxelCounts) -> Vec<Decision> {
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
                let u = Philox::uniform(seed, accept, u64::from(row))[0];
                Some(Decision {
                    edit: Edit {
                        src: row,
                        dst: row,
                        position,
                        log_scale,
                        opacity_logit,
                    },
                    prior: accept::voxel_prior(lambda, count),
                    accepted: accept::accepts(u, ln_rho),
                })
            })
            .collect()
    }

    fn check(&self, context: &StepContext, scene: &SceneState<'_>, cues: &Cues<'_>) -> Result<()> {
        let c = &self.config;
        let edge = lerp(c.voxel_edge, context.progress.clamp(0.0, 1.0));
        if !(edge > 0.0 && edge.is_finite()) {
            return Err(Error::config(
                "mh.voxel-edge",
                format!("{edge}; a length above 0 expected"),
            ));
        }
        if !(c.lambda_voxel >= 0.0 && c.lambda_voxel.is_finite()) {
            return Err(Error::config(
                "mh.lambda-voxel",
                format!("{}; 0 or more expected", c.lambda_voxel),
            ));
        }
        if !context.progress.is_finite() {
            return Err(numerics(format!(
                "progress is {}; 0 to 1 expected",
                context.progress
            )));
        }
        check_lengths(scene, [cues.ssim.len(), cues.l1.len(), cues.views.len()])
    }
}

impl DensityControl for MetropolisHastings {
    /// k = max(1, ⌊views·(1−η)⌋) (Eq. 10).
    fn wanted(&self, views: usize, progress: f64) -> Wanted {
        Wanted::Errors {
            views: shrinking(views, progress),
        }
    }

    fn step(
        &mut self,
        context: &StepContext,
        scene: &SceneState<'_>,
        evidence: &Evidence<'_>,
    ) -> Result<Outcome> {
        let Evidence::Errors(cues) = evidence else {
            return Err(unexpected());
        };
        self.check(context, scene, cues)?;
        let context = &StepContext {
            progress: context.progress.clamp(0.0, 1.0),
            ..*context
        };
        let c = &self.config;
        let relocation = Relocation::plan(context, scene, c.dead_opacity);
        // The state proposals are made in is the one after relocation: moved rows count where they are now.
        let edge = lerp(c.voxel_edge, context.progress);
        let mut counts = VoxelCounts::count_where(scene.positions, edge, |i| relocation.alive[i]);
        for edit in relocation.moved_edits() {
            counts.add(edit.position.map(f64::from));
        }
        let weights = [c.weight_opacity, c.weight_ssim, c.weight_l1];
        let importance = importance::importance(scene.opacity_logits, cues, weights).values;
        let alive: Vec<f64> = relocation
            .alive_rows
            .par_iter()
            .map(|&r| importance[r as usize])
            .collect();
        let step = Step {
            context,
            scene,
            relocation: &relocation,
            importance: &importance,
            sources: Categorical::new(&alive),
        };
        let mut births = Births::new(scene.len(), context.max_gaussians);
        for (k, phase) in self.phases(context).iter().enumerate() {
            let decisions = self.decide(&step, phase, &counts);
            births.take(k, &decisions, &mut counts);
        }
        Ok(births.finish(c.birth, scene, relocation, &counts))
    }
}

/// The births of a step, in the order of decision.
struct Births {
    edits: Vec<Edit>,
    len: usize,
    limit: usize,
    stats: DensityStats,
    prior_sum: f64,
}

impl Births {
    fn new(len: usize, max_gaussians: Option<usize>) -> Self {
        Self {
            edits: Vec::new(),
            len,
            // Rows are named by 32 bits.
            limit: max_gaussians.unwrap_or(usize::MAX).min(u32::MAX as usize),
            stats: DensityStats::default(),
            prior_sum: 0.0,
        }
    }

    /// Appends the accepted births of phase `k` (0 coarse, 1 fine) in row order of their sources, until the limit; the
    /// rest is dropped and does not count as accepted.
    fn take(&mut self, k: usize, decisions: &[Decision], counts: &mut VoxelCounts) {
        let before = self.edits.len();
        for decision in decisions {
            self.prior_sum += decision.prior;
            let free = u32::try_from(self.len)
                .ok()
                .filter(|_| self.len < self.limit);
            if let (true, Some(dst)) = (decision.accepted, free) {
                self.edits.push(Edit {
                    dst,
                    ..decision.edit
                });
                self.len += 1;
                counts.add(decision.edit.position.map(f64::from));
            }
        }
        let tally = [decisions.len() as u64, (self.edits.len() - before) as u64];
        match k {
            0 => self.stats.coarse = tally,
            _ => self.stats.fine = tally,
        }
    }

    fn finish(
        mut self,
        form: Birth,
        scene: &SceneState<'_>,
        relocation: Relocation,
        counts: &VoxelCounts,
    ) -> Outcome {
        let stats = &mut self.stats;
        stats.proposed = stats.coarse[0] + stats.fine[0];
        stats.accepted = stats.coarse[1] + stats.fine[1];
        stats.relocated = relocation.moved as u64;
        stats.occupied_voxels = counts.occupied() as u64;
        if stats.proposed > 0 {
            stats.mean_prior = self.prior_sum / stats.proposed as f64;
        }
        if form == Birth::Split {
            let sources = relocate::share(&mut self.edits, scene);
            self.edits.extend(sources);
        }
        // What birth made of a source replaces what relocation had made of it.
        let split: FxHashSet<u32> = self
            .edits
            .iter()
            .filter(|e| e.src == e.dst)
            .map(|e| e.dst)
            .collect();
        let mut edits = relocation.edits;
        edits.retain(|e| !split.contains(&e.dst));
        edits.append(&mut self.edits);
        Outcome {
            edits,
            rows: self.len,
            stats: self.stats,
            ..Outcome::default()
        }
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
