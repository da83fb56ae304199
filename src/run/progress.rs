//! The progress of a run.

use serde::Serialize;

/// State of a run for those who wait for it.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Progress {
    /// Iterations done.
    pub iteration: u32,
    /// Iterations of the run.
    pub iterations: u32,
    /// Number of Gaussians.
    pub gaussians: usize,
    /// PSNR of the last evaluation.
    pub psnr: Option<f64>,
    /// Mean training loss of the iterations before that.
    pub loss: Option<f64>,
    /// Seconds of training so far.
    pub train_seconds: f64,
    /// Iterations per second since the start or the resumption; `None` before the first.
    pub rate: Option<f64>,
    /// Seconds to the end, evaluations and all; `None` before the first iterations have told.
    pub left: Option<f64>,
    /// Decision that training has just taken, spelt out.
    pub decided: Option<String>,
}
