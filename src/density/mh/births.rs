//! Accepted proposals of a step, and the outcome made of them.

use rustc_hash::FxHashSet;

use crate::density::mh::proposal::Decision;
use crate::density::mh::sparsity::VoxelCounts;
use crate::density::outcome::{BirthKind, BirthRecord, DensityStats, Outcome};
use crate::density::relocation::Relocation;
use crate::density::state::{SceneState, gather};
use crate::scene::Edit;

/// The births of a step, in the order of decision.
pub(super) struct Births {
    /// Births about their sources.
    edits: Vec<Edit>,
    /// Edits of the sources that split.
    sources: Vec<Edit>,
    /// Births with parameters of their own.
    fresh: Vec<Edit>,
    /// Number of rows so far.
    len: usize,
    /// Upper limit of `len`.
    limit: usize,
    /// Rows to remove, which are still among `len`.
    removed: Vec<u32>,
    records: Vec<BirthRecord>,
    stats: DensityStats,
    /// Sum of D(v′) over the proposals so far.
    prior_sum: f64,
}

impl Births {
    /// No births yet, for a scene of `len` rows of which `removed` will go.
    pub(super) fn new(len: usize, max_gaussians: Option<usize>, removed: Vec<u32>) -> Self {
        let max = max_gaussians.map_or(usize::MAX, |max| max.saturating_add(removed.len()));
        Self {
            edits: Vec::new(),
            sources: Vec::new(),
            fresh: Vec::new(),
            len,
            // Rows are named by 32 bits.
            limit: max.min(u32::MAX as usize),
            removed,
            records: Vec::new(),
            stats: DensityStats::default(),
            prior_sum: 0.0,
        }
    }

    /// Number of births that there is room for.
    pub(super) fn room(&self) -> usize {
        self.limit.saturating_sub(self.len)
    }

    /// Appends the accepted births of a kind. If there is not room for all, as many as there is room for are drawn at random: in
    /// the order of rows they would be those of one corner of the scene. The rest does not count as accepted.
    pub(super) fn take(
        &mut self,
        kind: BirthKind,
        decisions: &[Decision<'_>],
        scene: &SceneState<'_>,
        counts: &mut VoxelCounts<'_>,
    ) {
        self.prior_sum += decisions.iter().map(|d| d.prior).sum::<f64>();
        let accepted = decisions.iter().enumerate().filter(|(_, d)| d.accepted());
        let mut born: Vec<(usize, &Decision<'_>)> = accepted.collect();
        let room = self.room();
        if born.len() > room {
            born.sort_by(|a, b| a.1.tie_break().total_cmp(&b.1.tie_break()));
            born.truncate(room);
            born.sort_by_key(|(at, _)| *at);
        }
        let tally = [decisions.len() as u64, born.len() as u64];
        let (births, counter) = match kind {
            BirthKind::Pixel => (&mut self.fresh, &mut self.stats.pixel),
            BirthKind::Coarse => (&mut self.edits, &mut self.stats.coarse),
            BirthKind::Fine => (&mut self.edits, &mut self.stats.fine),
        };
        *counter = tally;
        // The limit is a number of 32 bits.
        for (dst, (_, decision)) in (self.len as u32..).zip(born) {
            let proposal = decision.proposal;
            births.push(Edit {
                dst,
                ..proposal.edit
            });
            if let Some(part) = proposal.source_edit {
                if let Some(left) = gather(&scene.positions, part.dst as usize) {
                    counts.remove(left.map(f64::from));
                }
                counts.add(part.position.map(f64::from));
                self.sources.push(part);
            }
            counts.add(proposal.edit.position.map(f64::from));
            self.records.push(BirthRecord {
                dst,
                source: (kind != BirthKind::Pixel).then_some(proposal.edit.src),
                kind,
                importance: proposal.importance,
                change: proposal.change,
                ln_ratio: decision.ln_ratio,
                voxel_count: decision.voxel_count,
            });
        }
        self.len += tally[1] as usize;
    }

    /// The outcome of the step: the edits of relocation and births, rows to remove, counters.
    pub(super) fn finish(
        mut self,
        relocation: Relocation,
        mut importance: Vec<f64>,
        counts: &VoxelCounts<'_>,
    ) -> Outcome {
        let stats = &mut self.stats;
        let sum = |k: usize| stats.coarse[k] + stats.fine[k] + stats.pixel[k];
        (stats.proposed, stats.accepted) = (sum(0), sum(1));
        stats.relocated = relocation.moved as u64;
        stats.pruned = self.removed.len() as u64;
        stats.occupied_voxels = counts.occupied() as u64;
        if stats.proposed > 0 {
            stats.mean_prior = self.prior_sum / stats.proposed as f64;
        }
        // Births start from the result of relocation, and their edit of a source replaces that of relocation.
        let split: FxHashSet<u32> = self.sources.iter().map(|e| e.dst).collect();
        for moved in relocation.moved_edits() {
            importance[moved.dst as usize] = importance[moved.src as usize];
        }
        importance.extend(self.records.iter().map(|birth| birth.importance));
        let mut edits = relocation.edits;
        edits.retain(|e| !split.contains(&e.dst));
        edits.append(&mut self.fresh);
        edits.append(&mut self.edits);
        edits.append(&mut self.sources);
        Outcome {
            edits,
            rows: self.len,
            removed: self.removed,
            births: self.records,
            importance,
            stats: self.stats,
            ..Outcome::default()
        }
    }
}
