//! What becomes of accepted proposals.

use super::super::relocate::{self, Relocation};
use super::sparsity::VoxelCounts;
use super::{Decision, Kind};
use crate::config::Birth;
use crate::density::{DensityStats, Edit, Outcome, SceneState};
use rustc_hash::FxHashSet;

/// The births of a step, in the order of decision.
pub(super) struct Births {
    /// Copies, which may share with their sources.
    edits: Vec<Edit>,
    /// Births with parameters of their own.
    fresh: Vec<Edit>,
    len: usize,
    limit: usize,
    stats: DensityStats,
    prior_sum: f64,
}

impl Births {
    pub(super) fn new(len: usize, max_gaussians: Option<usize>) -> Self {
        Self {
            edits: Vec::new(),
            fresh: Vec::new(),
            len,
            // Rows are named by 32 bits.
            limit: max_gaussians.unwrap_or(usize::MAX).min(u32::MAX as usize),
            stats: DensityStats::default(),
            prior_sum: 0.0,
        }
    }

    /// Appends the accepted births of a kind in the order of decision, until the limit; the
    /// rest is dropped and does not count as accepted.
    pub(super) fn take(
        &mut self,
        kind: Kind,
        decisions: &[Decision],
        counts: &mut VoxelCounts<'_>,
    ) {
        let before = self.len;
        for decision in decisions {
            self.prior_sum += decision.prior;
            let free = u32::try_from(self.len)
                .ok()
                .filter(|_| self.len < self.limit);
            if let (true, Some(dst)) = (decision.accepted, free) {
                let births = match kind {
                    Kind::Pixel => &mut self.fresh,
                    Kind::Coarse | Kind::Fine => &mut self.edits,
                };
                births.push(Edit {
                    dst,
                    ..decision.edit
                });
                self.len += 1;
                counts.add(decision.edit.position.map(f64::from));
            }
        }
        let tally = [decisions.len() as u64, (self.len - before) as u64];
        match kind {
            Kind::Pixel => self.stats.pixel = tally,
            Kind::Coarse => self.stats.coarse = tally,
            Kind::Fine => self.stats.fine = tally,
        }
    }

    pub(super) fn finish(
        mut self,
        form: Birth,
        scene: &SceneState<'_>,
        relocation: Relocation,
        counts: &VoxelCounts<'_>,
    ) -> Outcome {
        let stats = &mut self.stats;
        let sum = |k: usize| stats.coarse[k] + stats.fine[k] + stats.pixel[k];
        (stats.proposed, stats.accepted) = (sum(0), sum(1));
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
        edits.append(&mut self.fresh);
        edits.append(&mut self.edits);
        Outcome {
            edits,
            rows: self.len,
            stats: self.stats,
            ..Outcome::default()
        }
    }
}
