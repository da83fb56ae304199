//! Rank correlation between the importance of a birth and the true change of the loss.
//!
//! On the state of a run's checkpoint, candidates are drawn as the sampler proposes them, and as many evenly over the range of the
//! importance. Each is inserted and the views are rendered again: the true gain −ΔL, L = (1 − λ)·L1 + λ·(1 − SSIM) averaged over
//! the views. It is set beside the importance I of the source (\[MH\] Eq. 13), the acceptance ρ, each cue alone, and a probe: the
//! derivative of the loss by the opacity of a birth that is not there yet, which one more render and backward pass per view
//! gives for all candidates together.
//!
//! | file | content |
//! |---|---|
//! | `check.rs` | the check from checkpoint to result |
//! | `candidates.rs` | the births to be judged |
//! | `instrument.rs` | losses, cues and gradients of the scene on the device |
//! | `births.rs` | true loss changes and probes of births |
//! | `rank.rs` | rank correlations, bootstrap intervals |
//! | `outcome.rs` | correlations and calibration of a form of birth |
//! | `stream.rs` | streams of random numbers |
//! | `report.rs` | tables and charts |
//!
//! Tests: surrogate.

mod births;
mod candidates;
mod check;
mod instrument;
mod outcome;
pub mod rank;
mod report;
mod stream;

pub use crate::lab::surrogate::births::{Birth, Probed};
pub use crate::lab::surrogate::candidates::{Candidate, Draw, Phase, Shape};
pub use crate::lab::surrogate::check::{Assessment, Options, check};
pub use crate::lab::surrogate::instrument::{Base, CueRows, Instrument, Setting};
pub use crate::lab::surrogate::outcome::{Calibration, Correlation, FORMS, FormOutcome, Judged};
pub use crate::lab::surrogate::report::report;
