//! Trains with a strategy of density control of one's own: `cargo run --release --example own_density_control -- data/room-tiny 1000 scene.ply`

use std::sync::Arc;

use mhsplat::density::{
    DensityControl, DensityStats, Edit, Outcome, SceneState, Statistics, StatisticsKind,
    StepContext,
};
use mhsplat::scene::{OptionalColor, ply};
use mhsplat::train::Event;
use mhsplat::{Device, Error, LoadOptions, Plan, Result, TrainConfig, Trainer, load_dataset, run};

/// Renders whose errors a step looks at.
const RENDERS: usize = 30;
/// Share of the Gaussians that a step copies, those under the largest errors.
const COPIED: f64 = 0.05;
/// Opacity logit below which a Gaussian is removed (opacity 0.005).
const FAINT: f32 = -5.3;

/// Copies the Gaussians under the largest errors, and removes those that are nearly transparent.
struct WorstFirst;

impl DensityControl for WorstFirst {
    fn wanted(&self, _views: usize, _progress: f64) -> StatisticsKind {
        StatisticsKind::Errors { views: RENDERS }
    }

    fn step(
        &self,
        context: &StepContext<'_>,
        scene: &SceneState<'_>,
        evidence: &Statistics<'_>,
    ) -> Result<Outcome> {
        let Statistics::Errors(errors) = evidence else {
            return Err(Error::numerics("WorstFirst", "error statistics expected"));
        };
        let n = scene.len();
        let opaque = |row: &usize| scene.opacity_logits[*row] > FAINT;
        let error = |row: usize| errors.l1[row] / errors.views[row].max(1) as f32;
        let mut sources: Vec<usize> = (0..n).filter(opaque).collect();
        sources.sort_by(|a, b| error(*b).total_cmp(&error(*a)).then(a.cmp(b)));
        let room = context
            .max_gaussians
            .unwrap_or(usize::MAX)
            .saturating_sub(n);
        sources.truncate(((COPIED * n as f64) as usize).min(room));
        let copies = sources.iter().enumerate();
        let edits: Vec<Edit> = copies.map(|(k, row)| copy(scene, *row, n + k)).collect();
        let removed: Vec<u32> = (0..n)
            .filter(|row| !opaque(row))
            .map(|row| row as u32)
            .collect();
        if removed.len() == n {
            return Ok(Outcome::unchanged(n));
        }
        let (births, deaths) = (edits.len() as u64, removed.len() as u64);
        Ok(Outcome {
            rows: n + edits.len(),
            edits,
            removed,
            stats: DensityStats {
                proposed: births,
                accepted: births,
                pruned: deaths,
                ..DensityStats::default()
            },
            ..Outcome::default()
        })
    }
}

/// A fainter Gaussian of 0.6 times the size, aside by the size of its source.
fn copy(scene: &SceneState<'_>, row: usize, dst: usize) -> Edit {
    let log_scale = scene.log_scales.map(|plane| plane[row]);
    let aside = log_scale.iter().fold(f32::MIN, |a, b| a.max(*b)).exp();
    let mut position = scene.positions.map(|plane| plane[row]);
    position[dst % 3] += aside;
    Edit {
        src: row as u32,
        dst: dst as u32,
        position,
        log_scale: log_scale.map(|s| s + 0.6f32.ln()),
        opacity_logit: scene.opacity_logits[row].min(-1.0),
        color: OptionalColor::NONE,
    }
}

/// Trains on `photos` for some iterations and writes the scene; returns the numbers of Gaussians before and after.
pub fn train(photos: &str, iterations: u32, scene: &str) -> Result<[usize; 2]> {
    let dataset = load_dataset(photos.as_ref(), &LoadOptions::default())?;
    let config = TrainConfig {
        iterations,
        ..TrainConfig::default()
    };
    let plan = Plan::new(&dataset, &config)?;
    let start = run::initial_gaussians(&dataset, &plan)?;
    let device = Device::open(None)?;
    let strategy = Arc::new(WorstFirst);
    let mut trainer = Trainer::with_strategy(&device, &dataset, &plan, &start, strategy)?;
    while trainer.advance()? != Event::Finished {}
    let trained = trainer.scene()?;
    ply::write_scene(scene.as_ref(), &trained, &dataset.frame)?;
    Ok([start.len(), trained.splats.len()])
}

fn main() -> std::result::Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().collect();
    match &args[1..] {
        [photos, iterations, scene] => Ok(train(photos, iterations.parse()?, scene).map(drop)?),
        _ => Err("give DATASET ITERATIONS SCENE.ply".into()),
    }
}
