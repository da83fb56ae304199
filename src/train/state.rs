//! What a checkpoint holds of the trainer.

use crate::base::error::{Error, Result};
use crate::density::DensityStats;
use crate::device::Array;
use crate::device::tuning::status;
use crate::scene::Splats;
use crate::train::Trainer;
use crate::train::brightness::Decision;
use crate::train::finish::Findings;

/// Everything that a checkpoint must hold to continue bit for bit.
#[derive(Debug, Clone)]
pub struct TrainerState {
    /// Iterations done.
    pub iteration: u32,
    /// Whether the density step that falls on this iteration, if one does, is still to be done.
    pub density_due: bool,
    /// Parameters.
    pub splats: Splats,
    /// First moments, planes as in [`Splats`].
    pub moment1: Vec<Vec<f32>>,
    /// Second moments.
    pub moment2: Vec<Vec<f32>>,
    /// What the sampler has had gathered for its next step \[rows\]\[N\].
    pub cues: Vec<Vec<f32>>,
    /// Standard deviations of the 3D filter \[N\], local units; empty without anti-aliasing.
    pub filter: Vec<f32>,
    /// Statistics of density control so far.
    pub stats: DensityStats,
    /// Non-finite gradient values so far.
    pub non_finite: u64,
    /// What training has found out.
    pub findings: Findings,
    /// Ring of the last losses on the device: L1 and SSIM of each iteration.
    pub losses: Vec<f32>,
    /// What was decided on per-image exposure.
    pub exposure_decision: Option<Decision>,
    /// Transforms of the training views and their moments \[3\]\[views · 12\]; empty where exposure is not compensated.
    pub exposures: Vec<Vec<f32>>,
}

impl Trainer {
    /// Reads everything a checkpoint needs.
    ///
    /// # Errors
    /// The driver's, or non-finite parameters.
    pub fn state(&mut self) -> Result<TrainerState> {
        self.settle()?;
        let read = |array: &Array<f32>| -> Result<Vec<Vec<f32>>> {
            (0..self.scene.planes())
                .map(|p| array.read(p * self.scene.stride, self.scene.count))
                .collect()
        };
        Ok(TrainerState {
            iteration: self.iteration,
            density_due: self.last_density != Some(self.iteration)
                && self.schedule.density_due(self.iteration).is_some(),
            splats: self.scene.download()?,
            moment1: read(&self.moment1)?,
            moment2: read(&self.moment2)?,
            cues: self.read_cues()?,
            filter: self.read_filter()?,
            stats: self.tally.stats,
            non_finite: self.tally.non_finite,
            findings: self.findings,
            losses: self.losses.to_vec()?,
            exposure_decision: self.exposure_decision,
            exposures: self.exposures()?,
        })
    }

    /// Continues from a state; the trainer must have been made with its splats.
    ///
    /// # Errors
    /// A state of another shape, or the driver's.
    pub fn restore(&mut self, state: &TrainerState) -> Result<()> {
        if (state.splats.sh_degree(), state.splats.len())
            != (self.scene.sh_degree, self.scene.count)
        {
            return Err(Error::Numerics {
                stage: "checkpoint".into(),
                what: "it holds other Gaussians than training begins with".into(),
            });
        }
        for (array, planes) in [
            (&self.moment1, &state.moment1),
            (&self.moment2, &state.moment2),
        ] {
            for (p, plane) in planes.iter().enumerate() {
                array.write(p * self.scene.stride, plane)?;
            }
        }
        if state.cues.len() != self.sampler.cue_rows {
            return Err(Error::Numerics {
                stage: "checkpoint".into(),
                what: format!(
                    "{} rows of cues; {} expected",
                    state.cues.len(),
                    self.sampler.cue_rows
                ),
            });
        }
        for (k, row) in state.cues.iter().enumerate() {
            self.cues.write(k * self.scene.stride, row)?;
        }
        self.restore_filter(&state.filter)?;
        self.restore_exposure(state.exposure_decision, &state.exposures)?;
        self.tally.stats = state.stats;
        self.findings = state.findings;
        self.iteration = state.iteration;
        // A step that falls on this iteration is done or still to be done; where none does, none was.
        let falls = self.schedule.density_due(state.iteration).is_some();
        self.last_density = (falls && !state.density_due).then_some(state.iteration);
        if state.losses.len() != self.losses.len() {
            return Err(Error::Numerics {
                stage: "checkpoint".into(),
                what: format!(
                    "{} losses; {} expected",
                    state.losses.len(),
                    self.losses.len()
                ),
            });
        }
        self.losses.write(0, &state.losses)?;
        self.tally.non_finite = state.non_finite;
        let slot = status::NON_FINITE as usize;
        self.renderer
            .frame
            .status
            .write(slot, &[state.non_finite.min(u64::from(u32::MAX)) as u32])
    }
}
