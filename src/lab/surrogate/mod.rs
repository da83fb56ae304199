//! Rank correlation between the importance of a birth and the true change of the loss.
//!
//! On the state of a run's checkpoint, candidates are drawn as the sampler proposes them, and as many evenly over the range of the
//! importance. Each is inserted and the views are rendered again: the true gain −ΔL, L = (1 − λ)·L1 + λ·(1 − SSIM) averaged over
//! the views. It is set beside the importance I of the source (\[MH\] Eq. 13), the acceptance ρ, each cue alone, and the first-order
//! estimate of the birth (`probe` in tables and JSON): the derivative of the loss with respect to the opacity of a birth that is
//! not there yet, which one more render and backward pass per view gives for all candidates together.
//!
//! Tests: surrogate.

mod births;
mod check;
mod instrument;
pub mod rank;
mod report;

pub use crate::lab::surrogate::births::{Birth, Candidate, Draw, FORMS, Phase, Shape};
pub use crate::lab::surrogate::check::{Assessment, Options, check};
pub use crate::lab::surrogate::instrument::{Base, Estimate, Instrument, Setting};
pub use crate::lab::surrogate::rank::{Calibration, Correlation, FormOutcome};
pub use crate::lab::surrogate::report::report;
