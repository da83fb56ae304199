//! Metropolis–Hastings density control (\[MH\] = Kim, Jung, Park, NeurIPS 2025, §4 and Alg. 1).
//!
//! `step.rs` reads as the algorithm: the dead and the faintest Gaussians are removed, and births come (or
//! the dead are relocated, Eq. 17), except at the last step; births are proposed about Gaussians or as parts of them (`splitting.rs`) in two phases, coarse and fine (Eq. 14–16), and in image space (`pixel.rs`), voxels are counted
//! (`sparsity.rs`), and the births are decided on (Eq. 20, `accept.rs`). Within a phase every proposal sees the same counts, which keeps it parallel; births of the coarse phase
//! are counted before the fine phase is decided. Proposals do not depend on what is accepted (where sources split, the fine phase leaves out those that the coarse one has drawn), so that the births of all phases
//! can be estimated together before.

pub mod accept;
mod births;
pub mod importance;
mod pixel;
mod progress;
mod proposal;
pub mod sparsity;
mod splitting;
mod step;

pub(crate) use crate::density::mh::progress::lerp;
pub use crate::density::mh::step::MetropolisHastings;
