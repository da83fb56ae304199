//! MCMC density control (\[MCMC\] = Kheradmand et al., *3D Gaussian Splatting as Markov Chain Monte Carlo*, NeurIPS 2024,
//! §3): noise on the positions after every optimiser step explores; a step of density control relocates the dead (§3.2)
//! and grows the set by a fixed rate until the cap, both by splitting Gaussians that are drawn ∝ opacity (Eq. 9).

use rayon::prelude::*;
use rustc_hash::FxHashSet;

use crate::base::error::Result;
use crate::base::math::sigmoid;
use crate::base::rng::{Philox, Stream};
use crate::config::McmcConfig;
use crate::density::control::{DensityControl, Expected, NoiseLaw, StepContext};
use crate::density::draw::Categorical;
use crate::density::outcome::{DensityStats, Outcome};
use crate::density::relocation::{Relocation, split};
use crate::density::state::{SceneState, gather};
use crate::density::statistics::{Statistics, StatisticsKind, unexpected};
use crate::scene::{Edit, OptionalColor};

/// Density control by noise, relocation and growth.
#[derive(Debug, Clone)]
pub struct Mcmc {
    config: McmcConfig,
}

impl Mcmc {
    /// Density control with these settings.
    #[must_use]
    pub fn new(config: &McmcConfig) -> Self {
        Self { config: *config }
    }

    /// Number of Gaussians that a step adds to `n`: min(cap, ⌊growth·n⌋) − n, at least 0.
    fn births(&self, n: usize, max_gaussians: Option<usize>) -> usize {
        // Rows are named by 32 bits.
        let cap = max_gaussians.unwrap_or(self.config.cap);
        let cap = cap.min(u32::MAX as usize);
        let target = (self.config.growth * n as f64) as usize;
        target.min(cap).saturating_sub(n)
    }
}

impl DensityControl for Mcmc {
    fn wanted(&self, _views: usize, _progress: f64) -> StatisticsKind {
        StatisticsKind::Nothing
    }

    fn noise(&self) -> Option<NoiseLaw> {
        let c = &self.config;
        Some(NoiseLaw {
            rate: c.noise_rate * c.world_extent * c.world_extent,
            steepness: c.noise_steepness,
            opacity: c.noise_opacity,
        })
    }

    fn expected(&self, context: &StepContext<'_>, before: Expected) -> Option<Expected> {
        let n = before.gaussians;
        let born = self.births(n as usize, context.max_gaussians) as f64;
        Some(Expected {
            gaussians: n + born,
            born,
        })
    }

    fn step(
        &self,
        context: &StepContext<'_>,
        scene: &SceneState<'_>,
        evidence: &Statistics<'_>,
    ) -> Result<Outcome> {
        let Statistics::Nothing = evidence else {
            return Err(unexpected());
        };
        scene.check_lengths([])?;
        let relocation = Relocation::plan(context, scene, self.config.dead_opacity);
        if relocation.alive_rows.is_empty() {
            // Nothing to draw from.
            return Ok(Outcome::unchanged(scene.len()));
        }
        let births = self.births(scene.len(), context.max_gaussians);
        let relocated = relocation.moved as u64;
        let edits = grow(context, scene, relocation, births);
        Ok(Outcome {
            edits,
            rows: scene.len() + births,
            stats: DensityStats {
                proposed: births as u64,
                accepted: births as u64,
                relocated,
                ..DensityStats::default()
            },
            ..Outcome::default()
        })
    }
}

/// The edits of a relocation, and those of `births` more Gaussians: sources are drawn with replacement ∝ the opacity that
/// relocation left, and one that was drawn m times is split into 1 + m, itself being one.
fn grow(
    context: &StepContext<'_>,
    scene: &SceneState<'_>,
    relocation: Relocation,
    births: usize,
) -> Vec<Edit> {
    let drawn = draw_sources(context, scene, &relocation, births);
    let groups: Vec<&[u32]> = drawn.chunk_by(|a, b| a == b).collect();
    let parts: Vec<Edit> = groups
        .par_iter()
        .filter_map(|group| {
            let one = row_after(scene, &relocation, *group.first()?)?;
            let copies = u32::try_from(group.len()).ok()?.saturating_add(1);
            let part = split(f64::from(one.opacity_logit), copies);
            let scaled = |s: f32| (f64::from(s) + part.log_scale_offset) as f32;
            Some(Edit {
                log_scale: one.log_scale.map(scaled),
                opacity_logit: part.opacity_logit as f32,
                ..one
            })
        })
        .collect();
    // Growth starts from the result of relocation, and its edit of a row replaces that of relocation. A relocated row is a
    // copy of its source, so births name that source and copy nothing from a row that is itself being written.
    let split_rows: FxHashSet<u32> = parts.iter().map(|e| e.dst).collect();
    let mut edits = relocation.edits;
    edits.retain(|e| !split_rows.contains(&e.dst));
    let copies = parts
        .iter()
        .zip(&groups)
        .flat_map(|(part, group)| std::iter::repeat_n(*part, group.len()));
    let rows = scene.len() as u32..;
    let born: Vec<Edit> = rows.zip(copies).map(|(dst, e)| Edit { dst, ..e }).collect();
    edits.extend(parts);
    edits.extend(born);
    edits
}

/// Source rows of `births` draws, rising, with repetitions.
fn draw_sources(
    context: &StepContext<'_>,
    scene: &SceneState<'_>,
    relocation: &Relocation,
    births: usize,
) -> Vec<u32> {
    if births == 0 {
        return Vec::new();
    }
    let mut logits = scene.opacity_logits.to_vec();
    for edit in &relocation.edits {
        logits[edit.dst as usize] = edit.opacity_logit;
    }
    // An invalid row that was not relocated has nothing to copy.
    let weight = |(row, logit): (usize, &f32)| {
        let whole = scene.is_finite(row) || relocation.edit(row as u32).is_some();
        if whole {
            sigmoid(f64::from(*logit))
        } else {
            0.0
        }
    };
    let weights: Vec<f64> = logits.par_iter().enumerate().map(weight).collect();
    let categorical = Categorical::new(weights);
    let stream = Stream::Growth.stream(context.iteration);
    let mut rows: Vec<u32> = (0..births as u64)
        .into_par_iter()
        .filter_map(|k| {
            let u = Philox::uniform_53(context.seed, stream, k)[0];
            categorical.draw(u).map(|row| row as u32)
        })
        .collect();
    rows.par_sort_unstable();
    rows
}

/// The edit that writes a row in the state after relocation; `None` if there is no such row.
fn row_after(scene: &SceneState<'_>, relocation: &Relocation, row: u32) -> Option<Edit> {
    if let Some(edit) = relocation.edit(row) {
        return Some(*edit);
    }
    let i = row as usize;
    Some(Edit {
        src: row,
        dst: row,
        position: gather(&scene.positions, i)?,
        log_scale: gather(&scene.log_scales, i)?,
        opacity_logit: *scene.opacity_logits.get(i)?,
        color: OptionalColor::NONE,
    })
}
