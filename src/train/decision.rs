//! Density steps between their begin and their end: what a strategy decides from, and its decision, taken at once or while training goes
//! on.

use std::borrow::Cow;
use std::sync::Arc;
use std::thread::{Builder, JoinHandle};
use std::time::Instant;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::base::error::{Error, Result};
use crate::density::{
    Clearance, DensityControl, DensityStats, Edit, ErrorStatistics, Estimator, Outcome, Picture,
    SceneState, ScreenGradient, Statistics, StatisticsKind, StepContext,
};
use crate::scene::Plane;
use crate::train::crew::Words;
use crate::train::gaussians::{PendingSnapshot, Snapshot};
use crate::train::picture::{ArrivedPicture, PendingPicture};

/// Everything that a density step decides from, on its way to the host.
#[derive(Debug)]
pub(super) struct Evidence {
    /// Iteration, progress and the like; without cameras and pictures.
    pub(super) context: StepContext<'static>,
    /// Centres of the training cameras.
    pub(super) cameras: Vec<[f32; 3]>,
    /// Radii of the free space about them ([`Plan::clearance`](crate::train::Plan::clearance)).
    pub(super) clearance: Vec<f32>,
    /// Parameters and statistics.
    pub(super) snapshot: PendingSnapshot,
    /// Kind of the statistics.
    pub(super) wanted: StatisticsKind,
    /// Renders of views.
    pub(super) pictures: Vec<PendingPicture>,
}

/// A decision, and the parameters that it was taken from.
#[derive(Debug)]
pub struct Decision {
    /// Edits and counters.
    pub outcome: Outcome,
    /// Parameters before; `None` after a resumption.
    pub before: Option<Snapshot>,
    /// Seconds that it took the host, from the end of the transfers on.
    pub seconds: f64,
}

/// A density step that is decided and not applied; the parts of [`Outcome`] that change the Gaussians.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PendingStep {
    /// Iterations done when it began.
    pub begun: u32,
    /// Progress η then.
    pub progress: f64,
    /// Iterations done when it ends.
    pub ends: u32,
    /// Rows to be written.
    #[serde(skip)]
    pub edits: Vec<Edit>,
    /// Rows afterwards, with those to be removed.
    pub rows: usize,
    /// Largest opacity logit afterwards.
    pub logit_limit: Option<f32>,
    /// Rows to be removed, rising.
    #[serde(skip)]
    pub removed: Vec<u32>,
    /// Counters.
    pub stats: DensityStats,
}

/// A density step that has begun and not ended.
#[derive(Debug)]
pub struct Deciding {
    /// Iterations done when it began.
    pub begun: u32,
    /// Progress η then.
    pub progress: f64,
    /// Iterations done when it ends.
    pub ends: u32,
    state: State,
}

#[derive(Debug)]
enum State {
    Running(JoinHandle<Result<Decision>>),
    Decided(Box<Decision>),
    /// Handed out.
    Gone,
}

impl Evidence {
    /// Waits for the evidence and decides.
    ///
    /// # Errors
    /// The strategy's, or the driver's.
    pub(super) fn decide(
        self,
        strategy: &dyn DensityControl,
        estimate: &mut Estimator<'_>,
    ) -> Result<Decision> {
        let before = self.snapshot.wait()?;
        let arrived = self.pictures.into_iter().map(PendingPicture::arrived);
        let arrived: Vec<ArrivedPicture> = arrived.collect::<Result<_>>()?;
        let began = Instant::now();
        let pictures = arrived.iter().map(ArrivedPicture::picture);
        let pictures: Vec<Picture<'_>> = pictures.collect();
        let context = StepContext {
            cameras: &self.cameras,
            pictures: &pictures,
            ..self.context
        };
        let clearance = Clearance::new(&self.cameras, &self.clearance);
        let logits = logits(&before, &clearance);
        let scene = SceneState {
            positions: std::array::from_fn(|k| before.plane(Plane::POSITION + k)),
            log_scales: std::array::from_fn(|k| before.plane(Plane::LOG_SCALE + k)),
            rotations: std::array::from_fn(|k| before.plane(Plane::ROTATION + k)),
            opacity_logits: &logits,
        };
        let views: Vec<u32> = match self.wanted {
            StatisticsKind::Nothing => Vec::new(),
            // The last row counts.
            wanted => {
                let counts = before.statistics(wanted.rows() - 1).par_iter();
                counts.map(|v| *v as u32).collect()
            }
        };
        let evidence = match self.wanted {
            StatisticsKind::Nothing => Statistics::Nothing,
            StatisticsKind::Errors { .. } => Statistics::Errors(ErrorStatistics {
                ssim: before.statistics(0),
                l1: before.statistics(1),
                views: &views,
            }),
            StatisticsKind::ScreenGradient => Statistics::ScreenGradient(ScreenGradient {
                norms: before.statistics(0),
                views: &views,
            }),
        };
        let outcome = strategy.step_estimated(&context, &scene, &evidence, estimate)?;
        Ok(Decision {
            outcome,
            before: Some(before),
            seconds: began.elapsed().as_secs_f64(),
        })
    }
}

/// Opacity logits for the strategy: what stands in the free space about a camera counts as transparent, and goes by its rules. Whatever is
/// larger than the scene's extent does not stand there alone, and stays.
fn logits<'a>(before: &'a Snapshot, clearance: &Clearance) -> Cow<'a, [f32]> {
    let logits = before.plane(Plane::OPACITY);
    if clearance.is_empty() {
        return Cow::Borrowed(logits);
    }
    let planes = |first| std::array::from_fn(|k| before.plane(first + k));
    let (position, log_scale): ([&[f32]; 3], [&[f32]; 3]) =
        (planes(Plane::POSITION), planes(Plane::LOG_SCALE));
    let rows = logits.par_iter().enumerate();
    let seen = rows.map(|(i, logit)| {
        let small = log_scale.iter().all(|plane| plane[i] < 0.0);
        match small && clearance.holds(position.map(|plane| plane[i])) {
            true => f32::NEG_INFINITY,
            false => *logit,
        }
    });
    Cow::Owned(seen.collect())
}

impl PendingStep {
    /// True if the edits fit a set of `count` Gaussians.
    #[must_use]
    pub fn fits(&self, count: usize) -> bool {
        let rows = u32::try_from(self.rows).unwrap_or(0);
        let edit = |e: &Edit| (e.src as usize) < count && e.dst < rows;
        let rising = self.removed.is_sorted_by(|a, b| a < b);
        let inside = self.removed.last().is_none_or(|row| *row < rows);
        self.rows >= count && self.edits.iter().all(edit) && rising && inside
    }
}

impl From<&PendingStep> for Deciding {
    fn from(step: &PendingStep) -> Self {
        let decision = Decision {
            outcome: Outcome {
                edits: step.edits.clone(),
                rows: step.rows,
                logit_limit: step.logit_limit,
                removed: step.removed.clone(),
                stats: step.stats,
                ..Outcome::default()
            },
            before: None,
            seconds: 0.0,
        };
        Self::decided([step.begun, step.ends], step.progress, decision)
    }
}

impl Deciding {
    /// Has a thread decide, to be asked for after `ends` iterations.
    ///
    /// # Errors
    /// No thread can be made.
    pub(super) fn begin(
        evidence: Evidence,
        strategy: Arc<dyn DensityControl>,
        ends: u32,
    ) -> Result<Self> {
        let (begun, progress) = (evidence.context.iteration, evidence.context.progress);
        let decide = move || evidence.decide(strategy.as_ref(), &mut |_| Ok(Vec::new()));
        let thread = Builder::new().name("density".to_owned()).spawn(decide);
        let thread = thread.map_err(|e| {
            let what = format!("no thread can be made: {e}");
            Error::device("density control", what, "allow more threads (ulimit -u)")
        })?;
        Ok(Self {
            begun,
            progress,
            ends,
            state: State::Running(thread),
        })
    }

    /// A step whose decision is known.
    #[must_use]
    pub(super) fn decided([begun, ends]: [u32; 2], progress: f64, decision: Decision) -> Self {
        Self {
            begun,
            progress,
            ends,
            state: State::Decided(Box::new(decision)),
        }
    }

    /// Waits for the decision, which stays.
    ///
    /// # Errors
    /// The strategy's, or the driver's.
    pub(super) fn settled(&mut self) -> Result<&Decision> {
        let decision = Box::new(self.taken()?);
        self.state = State::Decided(decision);
        match &self.state {
            State::Decided(decision) => Ok(decision),
            _ => Err(gone()),
        }
    }

    /// Waits for the decision, and tells it.
    ///
    /// # Errors
    /// See [`Deciding::settled`].
    pub(super) fn pending(&mut self) -> Result<PendingStep> {
        let (begun, progress, ends) = (self.begun, self.progress, self.ends);
        let outcome = &self.settled()?.outcome;
        Ok(PendingStep {
            begun,
            progress,
            ends,
            edits: outcome.edits.clone(),
            rows: outcome.rows,
            logit_limit: outcome.logit_limit,
            removed: outcome.removed.clone(),
            stats: outcome.stats,
        })
    }

    /// Waits for the decision.
    ///
    /// # Errors
    /// See [`Deciding::settled`].
    pub(super) fn wait(mut self) -> Result<Decision> {
        self.taken()
    }

    fn taken(&mut self) -> Result<Decision> {
        match std::mem::replace(&mut self.state, State::Gone) {
            State::Decided(decision) => Ok(*decision),
            State::Running(thread) => thread.join().unwrap_or_else(|_| {
                let what = "the thread that decides has panicked";
                Err(Error::numerics("density control", what))
            }),
            State::Gone => Err(gone()),
        }
    }
}

/// The error of a step that has ended.
fn gone() -> Error {
    Error::numerics("density control", "its decision has been taken already")
}

/// The parts of an outcome that change Gaussians, as words.
#[must_use]
pub(super) fn words_of(outcome: &Outcome) -> Vec<u32> {
    let limit = outcome.logit_limit;
    let mut words = vec![outcome.rows as u32, u32::from(limit.is_some())];
    words.push(limit.unwrap_or(0.0).to_bits());
    words.push(outcome.edits.len() as u32);
    let edits = outcome.edits.iter().flat_map(Edit::to_bits);
    words.extend(edits.map(f32::to_bits));
    words.extend(&outcome.removed);
    words
}

/// The outcome of [`words_of`].
///
/// # Errors
/// Words that are too few.
pub(super) fn outcome_of(words: &[u32]) -> Result<Outcome> {
    let mut words = Words(words);
    let [rows, limited, limit, edits] = words.take()?;
    let mut outcome = Outcome::unchanged(rows as usize);
    outcome.logit_limit = (limited != 0).then_some(f32::from_bits(limit));
    for _ in 0..edits {
        let numbers = words.take()?.map(f32::from_bits);
        outcome.edits.push(Edit::of_bits(&numbers));
    }
    outcome.removed = words.0.to_vec();
    Ok(outcome)
}

impl Drop for Deciding {
    fn drop(&mut self) {
        // No thread goes on with the device after its step is of no use.
        if let State::Running(thread) = std::mem::replace(&mut self.state, State::Gone) {
            let _ = thread.join();
        }
    }
}
