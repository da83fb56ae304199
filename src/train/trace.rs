//! [`DensityTrace`]: every birth, relocation and death of a run, and what became of it.

use serde::{Deserialize, Serialize};

use crate::base::math::sigmoid;
use crate::density::{BirthKind, BirthRecord, Outcome};

/// Opacity above which a Gaussian counts as in use at the end.
pub const IN_USE: f32 = 0.05;

/// Mark of a Gaussian that training began with: no move made it.
const GIVEN: u32 = u32::MAX;

/// Kind of a move of density control.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MoveKind {
    /// Birth in image space (mh).
    PixelBirth,
    /// Birth of the coarse phase (mh).
    CoarseBirth,
    /// Birth of the fine phase (mh).
    FineBirth,
    /// Birth by another strategy.
    Birth,
    /// Row of a dead Gaussian given to a copy of an alive one.
    Relocation,
    /// Removal of a dead Gaussian.
    Death,
    /// Removal at the end of a Gaussian that no training view shows.
    Unseen,
}

impl std::fmt::Display for MoveKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::PixelBirth => "births in image space",
            Self::CoarseBirth => "births about Gaussians, coarse phase",
            Self::FineBirth => "births about Gaussians, fine phase",
            Self::Birth => "births",
            Self::Relocation => "relocations",
            Self::Death => "deaths",
            Self::Unseen => "unseen",
        })
    }
}

impl MoveKind {
    /// The kinds that make a Gaussian.
    pub const MAKING: [Self; 5] = [
        Self::PixelBirth,
        Self::CoarseBirth,
        Self::FineBirth,
        Self::Birth,
        Self::Relocation,
    ];
}

/// One move. Gaussians are numbered in the order in which they came to be; those that training began with come first.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Move {
    /// Iteration of the density step.
    pub iteration: u32,
    /// Kind.
    pub kind: MoveKind,
    /// Number of the Gaussian that was made or removed.
    pub gaussian: u32,
    /// Number of the Gaussian that it was made from.
    pub source: Option<u32>,
    /// Importance I of the source or pixel.
    pub importance: Option<f64>,
    /// First-order change of the loss.
    pub change: Option<f64>,
    /// ln ρ^{1/T}.
    pub ln_ratio: Option<f64>,
    /// Gaussians in its voxel before it.
    pub voxel_count: Option<u32>,
    /// Opacity at the next density step.
    pub opacity_next: Option<f32>,
    /// Iteration at which it was removed or relocated.
    pub ended: Option<u32>,
    /// Opacity at the end.
    pub opacity_end: Option<f32>,
    /// Blending weight α·T at the end, summed over the pixels of all training views.
    pub contribution: Option<f32>,
}

impl Move {
    fn new(iteration: u32, kind: MoveKind, gaussian: u32) -> Self {
        Self {
            iteration,
            kind,
            gaussian,
            source: None,
            importance: None,
            change: None,
            ln_ratio: None,
            voxel_count: None,
            opacity_next: None,
            ended: None,
            opacity_end: None,
            contribution: None,
        }
    }

    fn born(iteration: u32, gaussian: u32, birth: &BirthRecord) -> Self {
        let kind = match birth.kind {
            BirthKind::Pixel => MoveKind::PixelBirth,
            BirthKind::Coarse => MoveKind::CoarseBirth,
            BirthKind::Fine => MoveKind::FineBirth,
        };
        Self {
            importance: Some(birth.importance),
            change: birth.change.filter(|c| c.is_finite()),
            ln_ratio: Some(birth.ln_ratio).filter(|l| l.is_finite()),
            voxel_count: Some(birth.voxel_count),
            ..Self::new(iteration, kind, gaussian)
        }
    }
}

/// Follows every Gaussian of a run through births, relocations, removals and changes of order.
#[derive(Debug, Clone, Default)]
pub struct DensityTrace {
    moves: Vec<Move>,
    /// Number of the Gaussian in each row.
    rows: Vec<u32>,
    /// Move that made each Gaussian, by its number; [`GIVEN`] if none did.
    made_by: Vec<u32>,
    /// Blending weight of all Gaussians at the end.
    contribution: f64,
}

impl DensityTrace {
    /// A trace of a run that begins with `count` Gaussians.
    #[must_use]
    pub fn new(count: usize) -> Self {
        Self {
            moves: Vec::new(),
            rows: (0..count as u32).collect(),
            made_by: vec![GIVEN; count],
            contribution: 0.0,
        }
    }

    /// The moves so far, in order.
    #[must_use]
    pub fn moves(&self) -> &[Move] {
        &self.moves
    }

    /// Blending weight of all Gaussians at the end, pixels.
    #[must_use]
    pub fn contribution(&self) -> f64 {
        self.contribution
    }

    /// Number of Gaussians now.
    #[must_use]
    pub fn gaussians(&self) -> usize {
        self.rows.len()
    }

    /// Records a density step: the opacity logits before it, its outcome, and the order of rows after its edits (as it is if
    /// there is none).
    pub fn step(
        &mut self,
        iteration: u32,
        logits: &[f32],
        outcome: &Outcome,
        order: Option<&[u32]>,
    ) {
        self.look(logits, |made, opacity| {
            made.opacity_next.get_or_insert(opacity);
        });
        let before = self.rows.len();
        for &row in &outcome.removed {
            self.end(iteration, row, MoveKind::Death);
        }
        let rows = self.rows.clone();
        self.rows.resize(outcome.rows, GIVEN);
        let births: &[BirthRecord] = &outcome.births;
        for edit in outcome
            .edits
            .iter()
            .filter(|e| e.src != e.dst || e.dst as usize >= before)
        {
            let dst = edit.dst as usize;
            let source = rows.get(edit.src as usize).copied();
            let number = self.made_by.len() as u32;
            let new = if dst < before {
                self.close(iteration, dst as u32);
                Move {
                    source,
                    ..Move::new(iteration, MoveKind::Relocation, number)
                }
            } else {
                // Births take the rows from the first new one on, in their order.
                match births.get(dst - before) {
                    Some(birth) => Move {
                        source: birth.source.and(source),
                        ..Move::born(iteration, number, birth)
                    },
                    None => Move {
                        source,
                        ..Move::new(iteration, MoveKind::Birth, number)
                    },
                }
            };
            if let Some(row) = self.rows.get_mut(dst) {
                *row = number;
            }
            self.made_by.push(self.moves.len() as u32);
            self.moves.push(new);
        }
        if let Some(order) = order {
            self.reorder(order);
        }
    }

    /// Records the removal of the rows that are not in `kept`.
    pub fn remove_unseen(&mut self, iteration: u32, kept: &[u32]) {
        let mut stays = vec![false; self.rows.len()];
        for &row in kept {
            if let Some(stays) = stays.get_mut(row as usize) {
                *stays = true;
            }
        }
        for row in (0..self.rows.len()).filter(|row| !stays[*row]) {
            self.end(iteration, row as u32, MoveKind::Unseen);
        }
        self.reorder(kept);
    }

    /// Records the end of the run: opacity logits and summed blending weights of the rows that are left.
    pub fn finish(&mut self, logits: &[f32], contributions: &[f32]) {
        // The last births have no step after them but the end.
        self.look(logits, |made, opacity| {
            made.opacity_next.get_or_insert(opacity);
            made.opacity_end = Some(opacity);
        });
        let finite = contributions.iter().filter(|c| c.is_finite());
        self.contribution = finite.map(|c| f64::from(*c)).sum();
        for (row, contribution) in contributions.iter().enumerate() {
            if let Some(made) = self.maker(row) {
                made.contribution = contribution.is_finite().then_some(*contribution);
            }
        }
    }

    /// The move that made the Gaussian in a row; `None` if training began with it, and for a row that nothing has written.
    fn maker(&mut self, row: usize) -> Option<&mut Move> {
        let number = *self.rows.get(row)? as usize;
        self.moves.get_mut(*self.made_by.get(number)? as usize)
    }

    fn look(&mut self, logits: &[f32], mut tell: impl FnMut(&mut Move, f32)) {
        for (row, logit) in logits.iter().enumerate() {
            if let Some(made) = self.maker(row) {
                tell(made, sigmoid(f64::from(*logit)) as f32);
            }
        }
    }

    fn close(&mut self, iteration: u32, row: u32) {
        if let Some(made) = self.maker(row as usize) {
            made.ended = Some(iteration);
        }
    }

    fn end(&mut self, iteration: u32, row: u32, kind: MoveKind) {
        self.close(iteration, row);
        let number = self.rows.get(row as usize).copied().unwrap_or(GIVEN);
        self.moves.push(Move::new(iteration, kind, number));
    }

    fn reorder(&mut self, order: &[u32]) {
        let number = |row: &u32| self.rows.get(*row as usize).copied().unwrap_or(GIVEN);
        self.rows = order.iter().map(number).collect();
    }
}
