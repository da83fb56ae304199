//! [`ExposureModel`]: an affine colour transform per training photo, between the render and the loss.

use crate::base::error::{Error, Result};
use crate::device::tuning::status::{OVERFLOW, SLOTS};
use crate::device::{Array, Device, Kernels, PendingRead, Real};
use crate::pipeline::buffers::ViewBuffers;
use crate::pipeline::stage::adam::Step;
use crate::pipeline::stage::exposure::{ENTRIES, Exposures};

/// Transforms of the training views on the device.
#[derive(Debug)]
pub struct ExposureModel<R: Real = f32> {
    /// Kernels and arrays.
    pub stage: Exposures<R>,
    /// Iterations done when it was switched on.
    since: u32,
}

impl<R: Real> ExposureModel<R> {
    /// The identity for every view; `plane` is the padded size of the largest view, pixels.
    pub fn new(kernels: &Kernels, views: usize, plane: usize, since: u32) -> Result<Self> {
        Ok(Self {
            stage: Exposures::new(kernels, views, plane)?,
            since,
        })
    }

    /// Optimiser's step of a view's transform, `step.t` being the iteration of the run; changes nothing after an overflow.
    pub fn step(&self, view: usize, step: Step, status: &Array<u32>) -> Result<()> {
        let t = step.t.saturating_sub(self.since) + 1;
        self.stage.step(view, &Step { t, ..step }, status)
    }

    /// Gradient with respect to the transform stepped last, row-major \[A | b\].
    pub fn gradient(&self) -> Result<Vec<R>> {
        self.stage.grads.to_vec()
    }

    /// Runs every kernel once and changes no transform, so that no iteration waits for a compiler.
    pub fn warm_up(
        &self,
        device: &Device,
        view: &ViewBuffers<R>,
        dimage: &Array<R>,
        step: Step,
    ) -> Result<()> {
        self.stage.apply(view, 0)?;
        self.stage.backward(view, 0, dimage)?;
        // After an overflow the step changes nothing.
        let status = Array::zeros(device, "status", SLOTS)?;
        status.write(OVERFLOW as usize, &[1])?;
        self.step(0, step, &status)
    }

    fn arrays(&self) -> [&Array<R>; 3] {
        [
            &self.stage.transforms,
            &self.stage.moments[0],
            &self.stage.moments[1],
        ]
    }

    /// Transforms, first and second moments \[3\]\[views · 12\].
    pub fn rows(&self) -> Result<Vec<Vec<R>>> {
        self.arrays().into_iter().map(Array::to_vec).collect()
    }

    /// Continues with the rows that [`ExposureModel::rows`] gave.
    ///
    /// # Errors
    /// Rows of another shape, or the driver's.
    pub fn restore(&self, rows: &[Vec<R>]) -> Result<()> {
        let arrays = self.arrays();
        let fits = arrays.len() == rows.len();
        if !fits || arrays.iter().zip(rows).any(|(a, row)| a.len() != row.len()) {
            let what = format!("exposures of another shape: {} rows", rows.len());
            return Err(Error::numerics("checkpoint", what));
        }
        for (array, row) in arrays.iter().zip(rows) {
            array.write(0, row)?;
        }
        Ok(())
    }
}

impl ExposureModel {
    /// Enqueues the transfer of a view's transform.
    ///
    /// # Errors
    /// The driver's.
    pub fn read_transform(&self, view: usize) -> Result<PendingRead<f32>> {
        self.stage.transforms.read_later(ENTRIES * view, ENTRIES)
    }
}
