//! Births to be judged: drawn as the sampler draws them, and evenly over the range of the importance.

use std::collections::BTreeSet;

use serde::Serialize;

use crate::base::math::{logit, sigmoid};
use crate::base::rng::{Philox, Stream};
use crate::config::MhConfig;
use crate::density::draw::{Categorical, RowWeights, birth_position};
use crate::density::mh::accept::{ln_acceptance, voxel_prior};
use crate::density::mh::lerp;
use crate::density::mh::sparsity::{Lattice, VoxelCounts};
use crate::density::{ErrorStatistics, SceneState};
use crate::scene::{Gaussians, Plane};

/// Draws per wanted candidate before fewer have to do: sources are distinct, and few may hold all the weight.
const PATIENCE: u64 = 50;
/// Random streams of sources and of offsets, one per group of candidates.
const STREAMS: [u32; 2] = [10, 20];

/// The forms of a birth that leave its source as it is, by their names in the configuration.
pub const FORMS: [&str; 2] = ["copy", "faint"];

/// Log-scale and opacity of a birth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shape {
    /// Log-scale of the candidate.
    pub log_scale: [f32; 3],
    /// Opacity logit of the candidate.
    pub opacity_logit: f32,
}

impl Shape {
    /// The shape of a row.
    #[must_use]
    pub fn of(splats: &Gaussians, row: u32) -> Self {
        Self {
            log_scale: splats.gather(Plane::LOG_SCALE, row as usize),
            opacity_logit: splats.planes()[Plane::OPACITY][row as usize],
        }
    }
}

/// A birth as it is to be measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Birth {
    /// Row that is copied.
    pub source: u32,
    /// Position of the birth.
    pub position: [f32; 3],
    /// Shape of the birth.
    pub shape: Shape,
}

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
    /// Spread by `coarse-spread`.
    Coarse,
    /// Spread by `fine-spread`.
    Fine,
}

/// One candidate with its true and estimated gain in each of [`FORMS`].
#[derive(Debug, Clone, PartialEq, Serialize)]
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
    /// Number of views in which it has any pixel.
    pub views: usize,
    /// True gain −ΔL; 0 before it is measured.
    pub gain: [f64; FORMS.len()],
    /// First-order estimate of −ΔL.
    #[serde(rename = "probe")]
    pub estimate: [f64; FORMS.len()],
    #[serde(skip)]
    pub(super) births: [Birth; FORMS.len()],
}

/// State that candidates are drawn from.
pub(super) struct Ground<'a> {
    pub config: &'a MhConfig,
    pub splats: &'a Gaussians,
    pub errors: ErrorStatistics<'a>,
    pub importance: &'a [f64],
    pub progress: f64,
    pub seed: u64,
}

impl Ground<'_> {
    /// About `count` candidates: half of them drawn as proposals, half evenly over the importance, and of each half one half
    /// with the coarse spread. Sources are distinct within each of the four groups. Dead Gaussians are no sources.
    pub fn draw(&self, count: usize) -> Vec<Candidate> {
        let slice = |p: usize| self.splats.planes()[p].as_slice();
        let scene = SceneState {
            positions: std::array::from_fn(|k| slice(Plane::POSITION + k)),
            log_scales: std::array::from_fn(|k| slice(Plane::LOG_SCALE + k)),
            rotations: std::array::from_fn(|k| slice(Plane::ROTATION + k)),
            opacity_logits: slice(Plane::OPACITY),
        };
        let is_alive =
            |i: usize| sigmoid(f64::from(scene.opacity_logits[i])) > self.config.dead_opacity;
        let rows = 0..self.splats.len() as u32;
        let alive: Vec<u32> = rows.filter(|i| is_alive(*i as usize)).collect();
        let edge = lerp(self.config.voxel_edge, self.progress);
        let counts = VoxelCounts::count_where(scene.positions, Lattice::uniform(edge), is_alive);
        let groups = [
            (Draw::Proposal, Phase::Coarse),
            (Draw::Proposal, Phase::Fine),
            (Draw::Stratified, Phase::Coarse),
            (Draw::Stratified, Phase::Fine),
        ];
        let mut all = Vec::with_capacity(count);
        for (k, (draw, phase)) in groups.into_iter().enumerate() {
            let wanted = count * (k + 1) / 4 - count * k / 4;
            let [sources, offsets] =
                STREAMS.map(|first| Stream::Surrogate.stream(first + k as u32));
            let uniform = |k: u64| Philox::uniform_53(self.seed, sources, k)[0];
            let rows = match draw {
                Draw::Proposal => self.by_weight(&alive, wanted, uniform),
                Draw::Stratified => self.evenly(alive.clone(), wanted, uniform),
            };
            let (coarse, fine) = (self.config.coarse_spread, self.config.fine_spread);
            let spread = lerp(
                if phase == Phase::Coarse { coarse } else { fine },
                self.progress,
            );
            all.extend(rows.into_iter().filter_map(|row| {
                let [x, y, z, _] = Philox::normal(self.seed, offsets, u64::from(row));
                let own = Shape::of(self.splats, row).log_scale;
                let position = birth_position(&scene, row as usize, own, spread, [x, y, z])?;
                let count = counts.get(position.map(f64::from));
                Some(self.candidate(row, draw, phase, position, count))
            }));
        }
        all
    }

    fn by_weight(&self, alive: &[u32], wanted: usize, uniform: impl Fn(u64) -> f64) -> Vec<u32> {
        let sources = Categorical::new(RowWeights {
            weights: self.importance,
            rows: alive,
        });
        let mut rows = BTreeSet::new();
        for k in 0..PATIENCE * wanted as u64 {
            if rows.len() == wanted {
                break;
            }
            rows.extend(sources.draw(uniform(k)).map(|i| alive[i]));
        }
        rows.into_iter().collect()
    }

    /// One row per equal interval of the importance: the one nearest to a point drawn in it that is still free.
    fn evenly(&self, mut free: Vec<u32>, wanted: usize, uniform: impl Fn(u64) -> f64) -> Vec<u32> {
        let value = |r: u32| self.importance[r as usize];
        free.sort_by(|a, b| value(*a).total_cmp(&value(*b)).then(a.cmp(b)));
        let (Some(&first), Some(&last)) = (free.first(), free.last()) else {
            return Vec::new();
        };
        let (low, high) = (value(first), value(last));
        let mut rows = Vec::with_capacity(wanted);
        for k in 0..wanted.min(free.len()) {
            let target = low + (high - low) * (k as f64 + uniform(k as u64)) / wanted as f64;
            let at = free.partition_point(|r| value(*r) < target);
            let nearer = |i: &usize| (value(free[*i]) - target).abs();
            let around = at.saturating_sub(1)..(at + 1).min(free.len());
            let best = around.min_by(|a, b| nearer(a).total_cmp(&nearer(b)));
            rows.extend(best.map(|i| free.remove(i)));
        }
        rows
    }

    fn candidate(
        &self,
        source: u32,
        draw: Draw,
        phase: Phase,
        position: [f32; 3],
        count: u32,
    ) -> Candidate {
        let (i, c) = (source as usize, self.config);
        let own = Shape::of(self.splats, source);
        let faint = Shape {
            log_scale: own.log_scale.map(|s| s + c.birth_scale.ln() as f32),
            opacity_logit: own.opacity_logit.min(logit(c.birth_opacity) as f32),
        };
        let seen = self.errors.views[i];
        let mean = |sums: &[f32]| (seen > 0).then(|| f64::from(sums[i]) / f64::from(seen));
        let importance = self.importance[i];
        Candidate {
            source,
            draw,
            phase,
            position,
            importance,
            prior: voxel_prior(c.lambda_voxel, count),
            acceptance: ln_acceptance(c.acceptance, importance, c.lambda_voxel, count).exp(),
            opacity: sigmoid(f64::from(own.opacity_logit)),
            ssim: mean(self.errors.ssim),
            l1: mean(self.errors.l1),
            views: 0,
            gain: [0.0; FORMS.len()],
            estimate: [0.0; FORMS.len()],
            births: [own, faint].map(|shape| Birth {
                source,
                position,
                shape,
            }),
        }
    }
}
