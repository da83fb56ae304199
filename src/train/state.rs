//! [`TrainerState`]: the trainer's part of a checkpoint.

use crate::base::error::Result;
use crate::density::DensityStats;
use crate::device::tuning::status;
use crate::scene::Gaussians;
use crate::train::decision::PendingStep;
use crate::train::gaussians::{GaussianRows, mismatch};
use crate::train::noted::Noted;
use crate::train::plan::{Exposure, Learned};
use crate::train::step::{Next, Trainer};

/// Everything that a checkpoint must hold to continue bit for bit.
#[derive(Debug, Clone)]
pub struct TrainerState {
    /// Iterations done.
    pub iteration: u32,
    /// The next thing to do.
    pub next: Next,
    /// [`Plan::detail`](crate::train::Plan::detail).
    pub detail: Vec<f32>,
    /// [`Plan::clearance`](crate::train::Plan::clearance).
    pub clearance: Vec<f32>,
    /// [`Plan::background`](crate::train::Plan::background).
    pub background: [f32; 3],
    /// [`Dataset::swept`](crate::capture::Dataset::swept).
    pub swept: Option<usize>,
    /// Parameters.
    pub splats: Gaussians,
    /// Moments, statistics, smoothing filter and gradients of a batch that has begun.
    pub rows: GaussianRows,
    /// Density step that has begun and not ended.
    pub deciding: Option<PendingStep>,
    /// Statistics of density control so far.
    pub stats: DensityStats,
    /// Non-finite gradient values so far.
    pub non_finite: u64,
    /// Findings of training so far.
    pub learned: Learned,
    /// Ring of the last losses on the device: L1 and SSIM of each iteration.
    pub losses: Vec<f32>,
    /// Transforms of the training views and their moments \[3\]\[views · 12\]; empty unless exposure is compensated.
    pub exposures: Vec<Vec<f32>>,
}

impl Trainer {
    /// Reads everything that a checkpoint needs.
    ///
    /// # Errors
    /// The driver's, or non-finite parameters.
    pub fn state(&mut self) -> Result<TrainerState> {
        self.settle()?;
        let (splats, rows) = self.held(self.amidst_batch(self.iteration))?;
        let deciding = self.control.settle()?;
        Ok(TrainerState {
            deciding,
            iteration: self.iteration,
            // Kernels are announced and compiled again, so that the clock stands meanwhile.
            next: match self.next {
                Next::Compile => Next::Exposure,
                next => next,
            },
            detail: self.plan.detail.value.clone(),
            clearance: self.plan.clearance.value.clone(),
            background: self.plan.background.value,
            swept: self.plan.swept,
            splats,
            rows,
            stats: self.control.stats,
            non_finite: self.counters.non_finite,
            learned: self.learned,
            losses: self.losses.to_vec()?,
            exposures: self.exposures()?,
        })
    }

    /// Continues from a state; a trainer that is alone must have been made with its Gaussians.
    ///
    /// # Errors
    /// A state of another shape, another rank's failure, or the driver's.
    pub fn restore(&mut self, state: &TrainerState) -> Result<()> {
        self.settle()?;
        let (scene, alone) = (&self.gaussians.scene, self.crew.is_none());
        let shape = (state.splats.sh_degree(), state.splats.len());
        if alone && shape != (scene.sh_degree, scene.count) {
            return Err(mismatch(
                "it holds other Gaussians than training begins with".into(),
            ));
        }
        if state.losses.len() != self.losses.len() {
            let (found, wanted) = (state.losses.len(), self.losses.len());
            return Err(mismatch(format!("{found} losses; {wanted} expected")));
        }
        if state.rows.gradients.is_empty() == self.amidst_batch(state.iteration) {
            let what = "gradients of a batch where none has begun, or none where one has";
            return Err(mismatch(what.into()));
        }
        match alone {
            true => self.gaussians.restore(&state.rows)?,
            false => (self.gaussians).check_rows(&state.rows, state.splats.len())?,
        }
        self.losses.write(0, &state.losses)?;
        self.iteration = state.iteration;
        self.next = state.next;
        self.learned = state.learned;
        self.plan.learn(&state.learned);
        self.restore_exposures(&state.exposures)?;
        self.spread_from_host(&state.splats, &state.rows)?;
        self.control.restore(state.deciding.as_ref());
        self.control.stats = state.stats;
        self.control.trace.take_if(|_| state.iteration > 0);
        self.control.noted = self.control.noted.take().map(|_| Noted::default());
        self.counters.non_finite = state.non_finite;
        let slot = status::NON_FINITE as usize;
        let non_finite = state.non_finite.min(u64::from(u32::MAX)) as u32;
        let frame = &self.pipeline.forward.frame;
        frame.status.write(slot, &[non_finite])
    }

    /// True if a batch of views has begun before an iteration and not ended.
    pub(super) fn amidst_batch(&self, iteration: u32) -> bool {
        self.schedule.views_before(iteration) > 0
    }

    fn restore_exposures(&mut self, rows: &[Vec<f32>]) -> Result<()> {
        let wanted = self.plan.exposure.value == Exposure::On;
        if wanted && !rows.is_empty() && self.learned.exposed_from.is_none() {
            // Written before this was: the comparison's iteration, or the schedule's.
            let scheduled = self.schedule.exposure_from(self.iteration);
            let from = self.learned.gains.map_or(scheduled, |g| g.iteration);
            self.learned.exposed_from = Some(from);
        }
        let on = wanted && self.learned.exposed_from.is_some();
        if on == rows.is_empty() {
            let rows = rows.len();
            return Err(mismatch(format!("exposures of another shape: {rows} rows")));
        }
        if !on {
            return Ok(());
        }
        self.build_exposure()?;
        match &self.pipeline.exposure {
            Some(model) => model.restore(rows),
            None => Ok(()),
        }
    }
}
