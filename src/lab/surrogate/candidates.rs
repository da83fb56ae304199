//! Births to be judged: drawn as the sampler draws them, and evenly over the range of the importance.

use std::collections::BTreeSet;

use serde::Serialize;

use crate::base::math::{logit, sigmoid};
use crate::base::rng::Philox;
use crate::config::MhConfig;
use crate::density::draw::{Categorical, birth_position};
use crate::density::mh::accept::{ln_acceptance, voxel_prior};
use crate::density::mh::lerp;
use crate::density::mh::sparsity::{Lattice, VoxelCounts};
use crate::density::relocation::split;
use crate::density::{ErrorStatistics, SceneState};
use crate::lab::surrogate::stream::{OFFSET, SOURCE, stream};
use crate::scene::{Gaussians, Plane};

/// Draws per wanted candidate before fewer have to do: sources are distinct, and few may hold all the weight.
const PATIENCE: u64 = 50;

/// Law by which the source of a candidate was drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Draw {
    /// Proportional to its importance, like the sampler.
    Proposal,
    /// Evenly over the range of the importance.
    Stratified,
}

/// Phase of density control whose spread the offset has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Phase {
    /// Far from the source.
    Coarse,
    /// Near it.
    Fine,
}

/// Values that a birth writes to its own row, and to that of its source if they share.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shape {
    /// Log-scale of the candidate (and of the source, if that changes).
    pub log_scale: [f32; 3],
    /// Opacity logit of the candidate (and of the source, if that changes).
    pub opacity_logit: f32,
}

/// One candidate and everything known before rendering it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Candidate {
    /// Row of its source.
    pub source: u32,
    /// Law of its draw.
    pub draw: Draw,
    /// Phase of its offset.
    pub phase: Phase,
    /// Position of the birth, local units.
    pub position: [f32; 3],
    /// I of the source.
    pub importance: f64,
    /// D(v′) of the voxel of birth, all voxels being of one size.
    pub prior: f64,
    /// ρ in the run's form at T = 1.
    pub acceptance: f64,
    /// Opacity of the source.
    pub opacity: f64,
    /// 1 − SSIM under the source, mean of the views that see it.
    pub ssim: Option<f64>,
    /// L1 error there.
    pub l1: Option<f64>,
    #[serde(skip)]
    pub(super) copy: Shape,
    #[serde(skip)]
    pub(super) split: Shape,
    #[serde(skip)]
    pub(super) faint: Shape,
}

/// State that candidates are drawn from.
pub(super) struct Ground<'a> {
    pub config: &'a MhConfig,
    pub splats: &'a Gaussians,
    pub cues: ErrorStatistics<'a>,
    pub importance: &'a [f64],
    pub progress: f64,
    pub seed: u64,
}

/// The planes of a scene that density control reads.
pub(super) fn state(splats: &Gaussians) -> SceneState<'_> {
    let slice = |p: usize| splats.planes()[p].as_slice();
    SceneState {
        positions: std::array::from_fn(|k| slice(Plane::POSITION + k)),
        log_scales: std::array::from_fn(|k| slice(Plane::LOG_SCALE + k)),
        rotations: std::array::from_fn(|k| slice(Plane::ROTATION + k)),
        opacity_logits: slice(Plane::OPACITY),
    }
}

impl Ground<'_> {
    /// About `count` candidates: half of them drawn as proposals, half evenly over the importance, and of each half one half
    /// with the coarse spread. Sources are distinct within each of the four groups. Dead Gaussians are no sources.
    pub fn draw(&self, count: usize) -> Vec<Candidate> {
        let scene = state(self.splats);
        let alive: Vec<u32> = (0..self.splats.len() as u32)
            .filter(|i| {
                sigmoid(f64::from(scene.opacity_logits[*i as usize])) > self.config.dead_opacity
            })
            .collect();
        let is_alive: BTreeSet<u32> = alive.iter().copied().collect();
        let edge = lerp(self.config.voxel_edge, self.progress);
        let keep = |i: usize| is_alive.contains(&(i as u32));
        let counts = VoxelCounts::count_where(scene.positions, Lattice::uniform(edge), keep);
        let groups = [
            (Draw::Proposal, Phase::Coarse),
            (Draw::Proposal, Phase::Fine),
            (Draw::Stratified, Phase::Coarse),
            (Draw::Stratified, Phase::Fine),
        ];
        let mut all = Vec::with_capacity(count);
        for (k, (draw, phase)) in groups.into_iter().enumerate() {
            let wanted = count * (k + 1) / 4 - count * k / 4;
            let rows = match draw {
                Draw::Proposal => self.by_weight(&alive, wanted, k as u32),
                Draw::Stratified => self.evenly(&alive, wanted, k as u32),
            };
            let made = rows
                .into_iter()
                .filter_map(|row| self.candidate(&scene, &counts, row, draw, phase, k as u32));
            all.extend(made);
        }
        all
    }

    fn by_weight(&self, alive: &[u32], wanted: usize, group: u32) -> Vec<u32> {
        let weight = |r: &u32| self.importance[*r as usize];
        let weights: Vec<f64> = alive.iter().map(weight).collect();
        let sources = Categorical::new(&weights);
        let mut rows = BTreeSet::new();
        for k in 0..PATIENCE * wanted as u64 {
            if rows.len() == wanted {
                break;
            }
            let u = Philox::uniform_53(self.seed, stream(SOURCE + group), k)[0];
            rows.extend(sources.draw(u).map(|i| alive[i]));
        }
        rows.into_iter().collect()
    }

    /// One row per equal interval of the importance: the one nearest to a point drawn in it that is still free.
    fn evenly(&self, alive: &[u32], wanted: usize, group: u32) -> Vec<u32> {
        let value = |r: u32| self.importance[r as usize];
        let mut free = alive.to_vec();
        free.sort_by(|a, b| value(*a).total_cmp(&value(*b)).then(a.cmp(b)));
        let (Some(&first), Some(&last)) = (free.first(), free.last()) else {
            return Vec::new();
        };
        let (low, high) = (value(first), value(last));
        let mut rows = Vec::with_capacity(wanted);
        for k in 0..wanted.min(free.len()) {
            let stream = stream(SOURCE + group);
            let u = Philox::uniform_53(self.seed, stream, k as u64)[0];
            let target = low + (high - low) * (k as f64 + u) / wanted as f64;
            let at = free.partition_point(|r| value(*r) < target);
            let nearer = |i: &usize| (value(free[*i]) - target).abs();
            let around = [at.checked_sub(1), (at < free.len()).then_some(at)];
            let best = around
                .into_iter()
                .flatten()
                .min_by(|a, b| nearer(a).total_cmp(&nearer(b)));
            rows.extend(best.map(|i| free.remove(i)));
        }
        rows
    }

    fn candidate(
        &self,
        scene: &SceneState<'_>,
        counts: &VoxelCounts,
        source: u32,
        draw: Draw,
        phase: Phase,
        group: u32,
    ) -> Option<Candidate> {
        let (i, c) = (source as usize, self.config);
        let spread = match phase {
            Phase::Coarse => lerp(c.coarse_spread, self.progress),
            Phase::Fine => lerp(c.fine_spread, self.progress),
        };
        let own = Shape {
            log_scale: self.splats.gather(Plane::LOG_SCALE, i),
            opacity_logit: scene.opacity_logits[i],
        };
        let offsets = stream(OFFSET + group);
        let [x, y, z, _] = Philox::normal(self.seed, offsets, u64::from(source));
        let position = birth_position(scene, i, own.log_scale, spread, [x, y, z])?;
        let count = counts.get(position.map(f64::from));
        let part = split(f64::from(own.opacity_logit), 2);
        let seen = self.cues.views[i];
        let mean = |sums: &[f32]| (seen > 0).then(|| f64::from(sums[i]) / f64::from(seen));
        let importance = self.importance[i];
        Some(Candidate {
            source,
            draw,
            phase,
            position,
            importance,
            prior: voxel_prior(c.lambda_voxel, count),
            acceptance: ln_acceptance(c.acceptance, importance, c.lambda_voxel, count).exp(),
            opacity: sigmoid(f64::from(own.opacity_logit)),
            ssim: mean(self.cues.ssim),
            l1: mean(self.cues.l1),
            copy: own,
            split: Shape {
                log_scale: own
                    .log_scale
                    .map(|s| (f64::from(s) + part.log_scale_offset) as f32),
                opacity_logit: part.opacity_logit as f32,
            },
            faint: Shape {
                opacity_logit: own.opacity_logit.min(logit(c.birth_opacity) as f32),
                ..own
            },
        })
    }
}
