//! [`ErrorModel`]: the error that a run ends with, of its iterations and the size of its photos.

use crate::config::TrainingSize;

/// Power by which the error that training has not yet taken away falls with the iterations.
const POWER: f64 = 1.5;

/// Mean squared error of held-out photos at the size asked for, beyond that of an endless run at that size, in units of what 3/4 of it cannot
/// show: (R/n)^[`POWER`] of the n iterations, and what the size cannot show. Fitted at eight datasets, three sizes and four or five lengths
/// from 120 to 1920 iterations each; from 240 on it is within 0.23 dB (root mean square; docs/results/budgets.md):
///
/// | dataset | R | 9/16, units of 3/4 |
/// |---|---|---|
/// | plush | 1820 | 2.1 |
/// | fox-colmap | 1040 | 3.4 |
/// | south-half | 1520 | 2.2 |
/// | synth-outdoor | 1930 | 4.2 |
/// | herz-jesus | no loss by 3/4 | – |
/// | tankard, transparent | 1670 | 5.0 |
/// | lego, transparent | 520 | 4.2 |
/// | synth-toys, transparent | 560 | 4.5 |
#[derive(Debug, Clone, Copy)]
pub(super) struct ErrorModel {
    /// R: iterations after which as much is left to be learnt as 3/4 of the size loses; 0 if no smaller size is to be chosen.
    pub even: u32,
}

impl ErrorModel {
    /// The error after so many iterations at a size.
    pub fn error(self, iterations: u32, size: TrainingSize) -> f64 {
        let left = f64::from(self.even) / f64::from(iterations.max(1));
        left.powf(POWER) + lost(size)
    }
}

/// Squared error of what a size cannot show.
fn lost(size: TrainingSize) -> f64 {
    match size {
        TrainingSize::Full => 0.0,
        TrainingSize::ThreeQuarters => 1.0,
        TrainingSize::NineSixteenths => 3.4,
    }
}
