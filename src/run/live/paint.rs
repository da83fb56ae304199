//! Colours that show a property of the Gaussians of a run in place of their own.

use crate::base::error::Result;
use crate::run::report::gallery::colormap;
use crate::train::Trainer;

/// Colour of births, RGB, and the brightness of everything else beside them.
const BORN: [f32; 3] = [1.0, 0.85, 0.1];
const DIM: f32 = 0.4;

/// Number of Gaussians of a voxel that is painted brightest.
const CROWD: f64 = 100.0;

/// Property that is painted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Property {
    /// Births of the last density step, yellow; everything else is grey.
    Births,
    /// Rank by the importance I at the last density step: the least is dark.
    Importance,
    /// Number of Gaussians in the voxel of each, on a logarithmic scale: one alone is dark, a hundred are bright.
    Voxels,
}

/// Colours of the Gaussians of a run by a property, RGB \[N\]; `None` if the run has no such thing, or not yet.
///
/// # Errors
/// The driver's.
pub fn colors(trainer: &mut Trainer, property: Property) -> Result<Option<Vec<[f32; 3]>>> {
    Ok(match property {
        Property::Births => {
            let grey = |light: f32| [DIM * light; 3];
            let mut colors: Vec<[f32; 3]> = trainer.brightness()?.into_iter().map(grey).collect();
            for &row in trainer.noted().map_or(&[][..], |noted| &noted.births) {
                if let Some(color) = colors.get_mut(row as usize) {
                    *color = BORN;
                }
            }
            Some(colors)
        }
        Property::Importance => {
            let known = trainer.noted().map_or(&[][..], |noted| &noted.importance);
            // At the end of a run Gaussians are removed that no density step has judged.
            (!known.is_empty() && known.len() == trainer.gaussians()).then(|| ranked(known))
        }
        Property::Voxels => trainer.voxel_counts()?.map(|counts| {
            let share = |n: &u32| f64::from(*n).max(1.0).ln() / CROWD.ln();
            counts.iter().map(|n| color(share(n))).collect()
        }),
    })
}

/// Colour of a share of \[0, 1\].
fn color(share: f64) -> [f32; 3] {
    colormap(share).map(|v| f32::from(v) / 255.0)
}

/// Colours by rank: equal values have one colour.
fn ranked(values: &[f64]) -> Vec<[f32; 3]> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let last = (values.len() - 1).max(1) as f64;
    let rank = |v: &f64| sorted.partition_point(|s| s.total_cmp(v).is_lt()) as f64 / last;
    values.iter().map(|v| color(rank(v))).collect()
}
