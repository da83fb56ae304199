//! Adaptive density control (\[3DGS\] = Kerbl et al., *3D Gaussian Splatting for Real-Time Radiance Field Rendering*, 2023,
//! §5.2): Gaussians with a large gradient of the projected centre are cloned if small and split if large; those that are
//! nearly transparent or too large are removed; and from time to time every opacity is lowered, so that only Gaussians that
//! the photos need become opaque again.

use rayon::prelude::*;

use crate::base::error::Result;
use crate::base::math::{logit, sigmoid};
use crate::base::rng::{Philox, Stream};
use crate::config::AdcConfig;
use crate::density::control::{DensityControl, StepContext};
use crate::density::draw::birth_position;
use crate::density::outcome::{DensityStats, Outcome};
use crate::density::state::{SceneState, gather};
use crate::density::statistics::{ScreenGradient, Statistics, StatisticsKind, unexpected};
use crate::scene::{Edit, OptionalColor};

/// Density control by thresholds on gradient, size and opacity.
#[derive(Debug, Clone)]
pub struct Adaptive {
    config: AdcConfig,
}

/// Fate of a Gaussian in one step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fate {
    Stays,
    Clones,
    Splits,
    Goes,
}

impl Adaptive {
    /// Density control with these settings.
    #[must_use]
    pub fn new(config: &AdcConfig) -> Self {
        Self { config: *config }
    }

    /// Largest scale of a row; a NaN counts as the smallest.
    fn size(scene: &SceneState<'_>, row: usize) -> f64 {
        let scales = scene.log_scales.map(|plane| plane[row]);
        f64::from(scales.into_iter().fold(f32::MIN, f32::max)).exp()
    }

    /// Fate of a row with a mean gradient of `pull`. Pruning comes after cloning and splitting and sees their results: so a row
    /// that is too transparent is not copied, and one that is too large may stay as two smaller ones.
    fn fate(&self, scene: &SceneState<'_>, row: usize, pull: f64, bounded_size: bool) -> Fate {
        let c = &self.config;
        // Says what is good, so that NaN fails it.
        let opacity = sigmoid(f64::from(scene.opacity_logits[row]));
        if !(opacity >= c.prune_opacity && scene.is_finite(row)) {
            return Fate::Goes;
        }
        let size = Self::size(scene, row);
        let fate = match (pull > c.grad_threshold, size <= c.clone_scale) {
            (false, _) => Fate::Stays,
            (true, true) => Fate::Clones,
            (true, false) => Fate::Splits,
        };
        let left = match fate {
            Fate::Splits => size / c.split_shrink,
            _ => size,
        };
        if bounded_size && left > c.prune_scale {
            return Fate::Goes;
        }
        fate
    }

    /// Rows to clone or split, and rows to remove, each rising.
    fn judge(
        &self,
        scene: &SceneState<'_>,
        gradient: &ScreenGradient<'_>,
        bounded_size: bool,
    ) -> (Vec<Birth>, Vec<u32>) {
        let fates: Vec<(Fate, f64)> = (0..scene.len())
            .into_par_iter()
            .map(|row| {
                let pull = pull(gradient, row);
                (self.fate(scene, row, pull, bounded_size), pull)
            })
            .collect();
        let (mut births, mut removed) = (Vec::new(), Vec::new());
        for (row, (fate, pull)) in (0u32..).zip(fates) {
            match fate {
                Fate::Stays => (),
                Fate::Goes => removed.push(row),
                Fate::Clones | Fate::Splits => births.push(Birth { row, fate, pull }),
            }
        }
        (births, removed)
    }

    /// Writes a clone, or the two parts of a split Gaussian; the new row is `dst`. Returns false, and writes nothing, if the new
    /// positions would not be finite.
    fn bear(
        &self,
        edits: &mut Vec<Edit>,
        context: &StepContext<'_>,
        scene: &SceneState<'_>,
        birth: &Birth,
        dst: u32,
    ) -> bool {
        let row = birth.row as usize;
        let own = || {
            Some(Edit {
                src: birth.row,
                dst,
                position: gather(&scene.positions, row)?,
                log_scale: gather(&scene.log_scales, row)?,
                opacity_logit: *scene.opacity_logits.get(row)?,
                color: OptionalColor::NONE,
            })
        };
        let Some(copy) = own() else {
            return false;
        };
        if birth.fate == Fate::Clones {
            edits.push(copy);
            return true;
        }
        let stream = Stream::Split.stream(context.iteration);
        let sample = |k: u64| {
            let index = 2 * u64::from(birth.row) + k;
            let [x, y, z, _] = Philox::normal(context.seed, stream, index);
            birth_position(scene, row, copy.log_scale, 1.0, [x, y, z])
        };
        let (Some(first), Some(second)) = (sample(0), sample(1)) else {
            return false;
        };
        let shrink = self.config.split_shrink.ln();
        let log_scale = copy.log_scale.map(|s| (f64::from(s) - shrink) as f32);
        for (dst, position) in [(birth.row, first), (dst, second)] {
            edits.push(Edit {
                dst,
                position,
                log_scale,
                ..copy
            });
        }
        true
    }
}

/// A row to clone or split.
struct Birth {
    row: u32,
    fate: Fate,
    pull: f64,
}

/// Mean norm of the gradient of the projected centre over the iterations that saw a row; 0 if none did.
fn pull(gradient: &ScreenGradient<'_>, row: usize) -> f64 {
    match gradient.views[row] {
        0 => 0.0,
        views => f64::from(gradient.norms[row]) / f64::from(views),
    }
}

/// Keeps the `room` births with the largest gradients (ties by row), rising, and returns the rest.
fn bounded(births: &mut Vec<Birth>, room: usize) -> Vec<Birth> {
    if births.len() <= room {
        return Vec::new();
    }
    births.sort_by(|a, b| b.pull.total_cmp(&a.pull).then(a.row.cmp(&b.row)));
    let rest = births.split_off(room);
    births.sort_by_key(|b| b.row);
    rest
}

impl DensityControl for Adaptive {
    fn wanted(&self, _views: usize, _progress: f64) -> StatisticsKind {
        StatisticsKind::ScreenGradient
    }

    fn step(
        &self,
        context: &StepContext<'_>,
        scene: &SceneState<'_>,
        evidence: &Statistics<'_>,
    ) -> Result<Outcome> {
        let Statistics::ScreenGradient(gradient) = evidence else {
            return Err(unexpected());
        };
        scene.check_lengths([gradient.norms.len(), gradient.views.len()])?;
        let n = scene.len();
        let bounded_size = context.opacity_resets > 0;
        let (mut births, mut removed) = self.judge(scene, gradient, bounded_size);
        // Rows are named by 32 bits.
        let max = context.max_gaussians.unwrap_or(usize::MAX);
        let room = max.saturating_sub(n - removed.len());
        let proposed = births.len() as u64;
        let rest = bounded(&mut births, room.min(u32::MAX as usize - n));
        if bounded_size {
            // Unsplit, they are too large to stay.
            let too_large =
                |b: &&Birth| Self::size(scene, b.row as usize) > self.config.prune_scale;
            removed.extend(rest.iter().filter(too_large).map(|b| b.row));
            removed.sort_unstable();
        }
        if removed.len() == n {
            // An empty scene cannot be trained.
            removed.clear();
        }
        let mut stats = DensityStats {
            proposed,
            pruned: removed.len() as u64,
            opacity_resets: u64::from(context.resets_opacity),
            ..DensityStats::default()
        };
        let (mut edits, mut dst) = (Vec::new(), n as u32);
        for birth in &births {
            if self.bear(&mut edits, context, scene, birth, dst) {
                dst += 1;
                stats.cloned += u64::from(birth.fate == Fate::Clones);
                stats.split += u64::from(birth.fate == Fate::Splits);
            }
        }
        stats.accepted = stats.cloned + stats.split;
        let limit = self.config.reset_opacity;
        Ok(Outcome {
            edits,
            rows: dst as usize,
            logit_limit: context.resets_opacity.then(|| logit(limit) as f32),
            removed,
            stats,
            ..Outcome::default()
        })
    }
}
