//! One step of Metropolis–Hastings density control, from statistics to edits.

use rayon::prelude::*;
use rustc_hash::FxHashSet;

use crate::base::error::Result;
use crate::base::math::logit;
use crate::base::rng::{Philox, Stream};
use crate::config::{Birth, DENSITY_STEPS, MhConfig, PAPER_ITERATIONS, ViewSubset};
use crate::density::control::{DensityControl, Estimator, Expected, NoiseLaw, StepContext};
use crate::density::draw::{Categorical, RowWeights, birth_position};
use crate::density::mh::births::Births;
use crate::density::mh::progress::{lerp, shrinking};
use crate::density::mh::proposal::{Decision, Proposal, Proposals};
use crate::density::mh::sparsity::{Lattice, VoxelCounts};
use crate::density::mh::{accept, importance, pixel, splitting};
use crate::density::outcome::{BirthKind, Outcome};
use crate::density::relocation::Relocation;
use crate::density::state::{SceneState, gather, numerics};
use crate::density::statistics::{ErrorStatistics, Statistics, StatisticsKind, unexpected};
use crate::scene::{Edit, OptionalColor};

/// k of the noise's gate (\[MCMC\] Eq. 8).
const NOISE_STEEPNESS: f64 = 100.0;

/// Largest share of the Gaussians that are not dead which a step removes: runs with few steps would lose most of them.
const MAX_RETIRED: f64 = 0.15;

/// Distinct sources of a phase over those of as many uniform draws; fitted at sixteen runs of six datasets, as are the next two, for forecasts
/// alone (docs/results/budgets.md).
const DISTINCT: f64 = 0.98;

/// Share of the births in image space that can be proposed.
const PLACED: f64 = 0.7;

/// Share of a step's births that are dead by the next one: logarithm of its odds in a run of 3000 iterations at η = 0, and what that grows by to
/// η = 1 and with the logarithm of the run's length. Too large for runs of less than 1000 iterations, whose steps have fewer of them.
/// Fitted to births that leave their sources as they are, when they were spread 1 to 10 times as far, 15,000 were tried about Gaussians, not 22,500, and Adam's memory was longer in short runs.
const FADED: [f64; 3] = [0.03, 1.12, 0.62];

/// The same where sources split, and the η and the length that it grows to: the iterations between two steps grow no further. Fitted at 14 runs of 600, 1500 and 3000 iterations of eight
/// datasets; not measured beyond 7000 (docs/results/learning-rates.md).
const SPLIT_FADED: [f64; 3] = [-2.4, 3.2, 0.9];
const SPLIT_FADED_UP_TO: [f64; 2] = [0.4, 3000.0];

/// Expected share of accepted births where the temperature is fixed; a guess.
const UNGUIDED: f64 = 0.5;

/// Density control by Metropolis–Hastings births and deaths.
#[derive(Debug, Clone)]
pub struct MetropolisHastings {
    config: MhConfig,
}

/// A phase of births around Gaussians: coarse or fine.
struct Phase {
    /// Number of draws.
    proposals: usize,
    /// Standard deviation of the offset, in scales of the source.
    spread: f64,
    /// Random streams of source, offset (or axis and side of a split) and acceptance.
    streams: [u64; 3],
}

/// The input of a phase.
struct Step<'a> {
    context: &'a StepContext<'a>,
    scene: &'a SceneState<'a>,
    relocation: &'a Relocation,
    /// Importance of each row.
    importance: &'a [f64],
    /// Distribution of sources over `relocation.alive_rows`.
    sources: Categorical<RowWeights<'a>>,
}

impl MetropolisHastings {
    /// Density control with these settings.
    #[must_use]
    pub fn new(config: &MhConfig) -> Self {
        Self { config: *config }
    }

    /// True if a step has births. The last of several has none with turnover: nothing would judge them.
    fn has_births(&self, context: &StepContext<'_>) -> bool {
        let c = &self.config;
        let judges = context.last && context.before.is_some_and(|eta| c.births_enabled(eta));
        c.births_enabled(context.progress) && !(c.turns_over() && judges)
    }

    /// Share of the Gaussians that are not dead which die at a step: those of a rate of `turnover` since the step before.
    fn retired_share(&self, context: &StepContext<'_>) -> f64 {
        let c = &self.config;
        if !(c.turns_over() && c.births_enabled(context.progress)) {
            return 0.0;
        }
        let span = context.progress - context.before.unwrap_or(0.0);
        (-(-c.turnover * span.max(0.0)).exp_m1()).min(MAX_RETIRED)
    }

    /// Number of draws that a step makes for a configured number. Deaths by turnover have a rate over η, and with them births have: with as many draws at every step the number of
    /// Gaussians would grow as that of steps does, beyond what most sets gain by (docs/results/learning-rates.md).
    fn draws(&self, count: u32, context: &StepContext<'_>) -> usize {
        let steps = match self.config.turns_over() {
            true => (1.0 / context.spacing + 1e-9).floor(),
            false => 1.0,
        };
        let share = (f64::from(DENSITY_STEPS) / steps).min(1.0);
        let each = (f64::from(count) * share).ceil() as usize;
        shrinking(each, context.progress)
    }

    /// Number of births that a step is expected to have among so many Gaussians, without a bound.
    fn expected_births(&self, context: &StepContext<'_>, n: f64) -> f64 {
        let (c, eta) = (&self.config, context.progress);
        let distinct = |count: u32| {
            let draws = self.draws(count, context) as f64;
            -DISTINCT * n * (-draws / n).exp_m1()
        };
        let pixels = PLACED * self.draws(c.pixel_proposals, context) as f64;
        let about = match c.form() {
            Birth::Split => distinct(c.coarse_proposals.saturating_add(c.fine_proposals)),
            _ => distinct(c.coarse_proposals) + distinct(c.fine_proposals),
        };
        let proposals = about + pixels;
        let target = lerp(c.target_acceptance, eta);
        let share = if target > 0.0 { target } else { UNGUIDED };
        share * proposals
    }

    /// Share of the births of the step before that are expected to have faded since.
    fn faded(&self, context: &StepContext<'_>) -> f64 {
        let span = [self.config.from_iteration, self.config.until_iteration];
        let of_papers = lerp(span.map(f64::from), context.progress);
        let length = PAPER_ITERATIONS * f64::from(context.iteration) / of_papers.max(1.0);
        let ([first, by_progress, by_length], up_to) = match self.config.form() {
            Birth::Split => (SPLIT_FADED, SPLIT_FADED_UP_TO),
            Birth::Faint | Birth::Copy => (FADED, [1.0, f64::INFINITY]),
        };
        let odds = (first + by_progress * context.progress.min(up_to[0])).exp();
        let odds = odds * (length.min(up_to[1]) / 3000.0).powf(by_length);
        odds / (1.0 + odds)
    }

    /// The coarse and the fine phase at the progress of a step.
    fn phases(&self, context: &StepContext<'_>) -> [Phase; 2] {
        let eta = context.progress;
        let c = &self.config;
        let phase = |proposals: u32, spread: [f64; 2], streams: [Stream; 3]| Phase {
            proposals: self.draws(proposals, context),
            spread: lerp(spread, eta),
            streams: streams.map(|s| s.stream(context.iteration)),
        };
        use Stream::*;
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

    /// Decides each proposal of a phase by ρ^{1/T} against the counts as they are. T is solved for the target, the share that is to be
    /// accepted, or follows its schedule if that is 0.
    fn decide<'a>(
        &self,
        proposals: &'a [Proposal],
        counts: &VoxelCounts<'_>,
        eta: f64,
        target: f64,
    ) -> Vec<Decision<'a>> {
        let c = &self.config;
        let count = |p: &Proposal| counts.get(p.edit.position.map(f64::from));
        let counts: Vec<u32> = proposals.par_iter().map(count).collect();
        let ln_rhos: Vec<f64> = proposals
            .par_iter()
            .zip(&counts)
            .map(|(p, n)| accept::ln_ratio(c.acceptance, p.ln_gain, c.lambda_voxel, *n))
            .collect();
        let temperature = if target > 0.0 {
            accept::temperature_for(&ln_rhos, target)
        } else {
            lerp(c.temperature, eta)
        };
        let rated = proposals.iter().zip(counts).zip(ln_rhos);
        rated
            .map(|((proposal, voxel_count), ln_rho)| Decision {
                proposal,
                voxel_count,
                prior: accept::voxel_prior(c.lambda_voxel, voxel_count),
                ln_ratio: ln_rho / temperature,
            })
            .collect()
    }

    /// Draws the proposals of a phase. One that cannot be made is not proposed.
    fn propose(&self, step: &Step<'_>, phase: &Phase) -> Vec<Proposal> {
        let [draw, _, accept] = phase.streams;
        let seed = step.context.seed;
        step.sources
            .draw_unique(phase.proposals, seed, draw)
            .into_par_iter()
            .filter_map(|drawn| {
                let row = *step.relocation.alive_rows.get(drawn)?;
                let (edit, source_edit) = self.birth(step, phase, row)?;
                let importance = *step.importance.get(row as usize)?;
                Some(Proposal {
                    edit,
                    source_edit,
                    importance,
                    change: None,
                    ln_gain: accept::ln_gain(self.config.acceptance, importance),
                    u: Philox::uniform(seed, accept, u64::from(row))[0],
                })
            })
            .collect()
    }

    /// The birth that a source would have, and what would become of a source that splits. `None` if a position is not finite, or the parts of a split cannot be told
    /// apart.
    fn birth(&self, step: &Step<'_>, phase: &Phase, row: u32) -> Option<(Edit, Option<Edit>)> {
        let (c, i, seed) = (&self.config, row as usize, step.context.seed);
        let [_, offset, _] = phase.streams;
        // Opacity and log-scale as relocation left them.
        let (log_scale, opacity_logit) = match step.relocation.source(row) {
            Some(edit) => (edit.log_scale, edit.opacity_logit),
            None => (
                gather(&step.scene.log_scales, i)?,
                *step.scene.opacity_logits.get(i)?,
            ),
        };
        let (max_logit, ln_scale) = match c.form() {
            Birth::Split => {
                let [which, side, ..] = Philox::uniform(seed, offset, u64::from(row));
                let shape = (log_scale, opacity_logit);
                let parts =
                    splitting::parts(step.scene, row, shape, c.split_distance, [which, side])?;
                return Some((parts.birth, Some(parts.source)));
            }
            Birth::Faint => (logit(c.birth_opacity) as f32, c.birth_scale.ln() as f32),
            Birth::Copy => (f32::INFINITY, 0.0),
        };
        let [x, y, z, _] = Philox::normal(seed, offset, u64::from(row));
        let birth = Edit {
            src: row,
            dst: row,
            position: birth_position(step.scene, i, log_scale, phase.spread, [x, y, z])?,
            log_scale: log_scale.map(|s| s + ln_scale),
            opacity_logit: opacity_logit.min(max_logit),
            color: OptionalColor::NONE,
        };
        Some((birth, None))
    }

    /// Checks settings, progress and the lengths of slices.
    fn check(
        &self,
        context: &StepContext<'_>,
        scene: &SceneState<'_>,
        errors: &ErrorStatistics<'_>,
    ) -> Result<()> {
        self.config.validate()?;
        if !context.progress.is_finite() {
            return Err(numerics(format!(
                "progress is {}; 0 to 1 expected",
                context.progress
            )));
        }
        if !(context.spacing > 0.0 && context.spacing.is_finite()) {
            return Err(numerics(format!(
                "spacing is {}; more than 0 expected",
                context.spacing
            )));
        }
        scene.check_lengths([errors.ssim.len(), errors.l1.len(), errors.views.len()])
    }

    /// Voxel counts of the state after relocation, in which proposals are made: relocated rows count at their new positions.
    fn counts<'a>(
        &self,
        context: &StepContext<'a>,
        eta: f64,
        scene: &SceneState<'_>,
        relocation: &Relocation,
    ) -> VoxelCounts<'a> {
        let lattice = Lattice::at(&self.config, eta, context.cameras);
        let mut counts =
            VoxelCounts::count_where(scene.positions, lattice, |i| relocation.alive[i]);
        for edit in relocation.moved_edits() {
            counts.add(edit.position.map(f64::from));
        }
        counts
    }

    /// Relocation of the dead, and the dead rows that are removed instead.
    fn relocate_or_remove_dead(
        &self,
        context: &StepContext<'_>,
        scene: &SceneState<'_>,
    ) -> (Relocation, Vec<u32>) {
        let c = &self.config;
        if c.relocation && !c.removes_dead(context.progress) {
            let relocation = Relocation::plan(context, scene, c.dead_opacity);
            return (relocation, Vec::new());
        }
        let mut relocation = Relocation::none(scene, c.dead_opacity);
        relocation.retire(scene, self.retired_share(context));
        let removed = relocation.dead_rows();
        (relocation, removed)
    }

    /// Removals, relocation and proposals of a step.
    fn proposals(
        &self,
        context: &StepContext<'_>,
        scene: &SceneState<'_>,
        evidence: &Statistics<'_>,
    ) -> Result<Proposals> {
        // Without errors every Gaussian counts as unseen.
        let unseen = (vec![0.0; scene.len()], vec![0; scene.len()]);
        let errors = match evidence {
            Statistics::Errors(errors) => *errors,
            Statistics::Nothing if !self.wants_errors(context.progress) => ErrorStatistics {
                ssim: &unseen.0,
                l1: &unseen.0,
                views: &unseen.1,
            },
            _ => return Err(unexpected()),
        };
        self.check(context, scene, &errors)?;
        let c = &self.config;
        let dead_and_pixels = || {
            let (relocation, removed) = self.relocate_or_remove_dead(context, scene);
            let room = self.has_births(context)
                && context
                    .max_gaussians
                    .is_none_or(|most| scene.len() - removed.len() < most);
            let source = relocation.alive_rows.first().copied().filter(|_| room);
            let pixels = match source {
                Some(row) if !context.pictures.is_empty() => {
                    let wanted = self.draws(c.pixel_proposals, context);
                    pixel::propose(c, context, row, wanted)
                }
                _ => Vec::new(),
            };
            (relocation, removed, source.is_some(), pixels)
        };
        // Sums over pixels and the selection of the dead have one order, which leaves a core to the rest.
        let (importance, (relocation, removed, bears, pixels)) =
            rayon::join(|| self.importance(scene, &errors), dead_and_pixels);
        let [mut coarse, mut fine] = [Vec::new(), Vec::new()];
        if bears {
            let weights = RowWeights {
                weights: &importance,
                rows: &relocation.alive_rows,
            };
            let step = Step {
                context,
                scene,
                relocation: &relocation,
                importance: &importance,
                sources: Categorical::new(weights),
            };
            [coarse, fine] = self.phases(context).map(|p| self.propose(&step, &p));
            if c.form() == Birth::Split {
                // A source that both phases drew: two decisions, made apart, would each replace it.
                let coarse: FxHashSet<u32> = coarse.iter().map(|p| p.edit.src).collect();
                fine.retain(|p| !coarse.contains(&p.edit.src));
            }
        }
        let phases = [
            (BirthKind::Pixel, pixels),
            (BirthKind::Coarse, coarse),
            (BirthKind::Fine, fine),
        ];
        Ok(Proposals {
            phases,
            relocation,
            removed,
            importance,
        })
    }

    /// True if a step at progress η reads error maps.
    fn wants_errors(&self, progress: f64) -> bool {
        self.config.wants_errors() && self.config.births_enabled(progress)
    }

    /// Importance I of every row (Eq. 13); ½ if it is switched off.
    fn importance(&self, scene: &SceneState<'_>, errors: &ErrorStatistics<'_>) -> Vec<f64> {
        let c = &self.config;
        if !c.importance {
            return vec![0.5; scene.len()];
        }
        let weights = [c.weight_opacity, c.weight_ssim, c.weight_l1];
        importance::importance(scene.opacity_logits, errors, weights)
    }
}

impl DensityControl for MetropolisHastings {
    /// The set after deaths by turnover, of births of the step before that have faded, and births up to the bound.
    fn expected(&self, context: &StepContext<'_>, before: Expected) -> Option<Expected> {
        let (eta, n) = (context.progress, before.gaussians.max(1.0));
        let faded = match self.config.relocation && !self.config.removes_dead(eta) {
            true => 0.0,
            false => self.faded(context) * before.born,
        };
        let kept = ((1.0 - self.retired_share(context)) * n - faded).max(1.0);
        let most = context
            .max_gaussians
            .map_or(f64::INFINITY, |most| most as f64);
        let born = match self.has_births(context) {
            true => self.expected_births(context, n).min((most - kept).max(0.0)),
            false => 0.0,
        };
        Some(Expected {
            gaussians: kept + born,
            born,
        })
    }

    /// The view subset of Eq. 10, or nothing if no cue of errors has a weight.
    fn wanted(&self, views: usize, progress: f64) -> StatisticsKind {
        if !self.wants_errors(progress) {
            return StatisticsKind::Nothing;
        }
        let views = match self.config.view_subset {
            ViewSubset::Shrinking => shrinking(views, progress),
            ViewSubset::All => views,
            ViewSubset::Fixed(k) => views.min(k as usize),
        };
        StatisticsKind::Errors { views }
    }

    fn noise(&self) -> Option<NoiseLaw> {
        (self.config.noise_rate > 0.0).then_some(NoiseLaw {
            rate: self.config.noise_rate,
            steepness: NOISE_STEEPNESS,
            opacity: self.config.dead_opacity,
        })
    }

    fn pictures(&self, progress: f64) -> usize {
        if self.config.pixel_proposals > 0 && self.config.births_enabled(progress) {
            self.config.pixel_views as usize
        } else {
            0
        }
    }

    fn estimate_views(&self) -> usize {
        self.config.estimate_views()
    }

    fn step(
        &self,
        context: &StepContext<'_>,
        scene: &SceneState<'_>,
        evidence: &Statistics<'_>,
    ) -> Result<Outcome> {
        self.step_estimated(context, scene, evidence, &mut |_| Ok(Vec::new()))
    }

    fn step_estimated(
        &self,
        context: &StepContext<'_>,
        scene: &SceneState<'_>,
        evidence: &Statistics<'_>,
        estimate: &mut Estimator<'_>,
    ) -> Result<Outcome> {
        let context = &StepContext {
            progress: context.progress.clamp(0.0, 1.0),
            ..*context
        };
        let mut proposals = self.proposals(context, scene, evidence)?;
        if self.estimate_views() > 0 {
            let births = proposals.phases.iter().flat_map(|(_, all)| all);
            let births: Vec<Edit> = births.map(|p| p.edit).collect();
            let changes = estimate(&births)?;
            proposals.weigh(&changes)?;
        }
        let (c, eta) = (&self.config, context.progress);
        let mut counts = self.counts(context, eta, scene, &proposals.relocation);
        let mut births = Births::new(scene.len(), context.max_gaussians, proposals.removed);
        // Where there is not room for all, the kinds share it as they share the proposals.
        let all: usize = proposals.phases.iter().map(|(_, p)| p.len()).sum();
        let target = lerp(c.target_acceptance, eta).min(births.room() as f64 / all.max(1) as f64);
        for (kind, proposals) in &proposals.phases {
            let decisions = self.decide(proposals, &counts, eta, target);
            births.take(*kind, &decisions, scene, &mut counts);
        }
        Ok(births.finish(proposals.relocation, proposals.importance, &counts))
    }
}
