//! Density control on the host: which Gaussians are born, moved or removed.
//!
//! No OpenCL here: statistics that the device gathered arrive as slices, and edits go back ([`DensityControl`]).
//!
//! | file | content |
//! |---|---|
//! | `control.rs` | the trait, the context of a step, births to be estimated |
//! | `state.rs`, `statistics.rs`, `picture.rs` | input: parameters, statistics per Gaussian, renders of views |
//! | `outcome.rs` | output: edits, removals, counters |
//! | `clearance.rs` | space about the cameras in which no Gaussian lives |
//! | `draw.rs`, `relocation.rs` | draws by weight, dead Gaussians that take over alive ones |
//! | `mh/`, `mcmc.rs`, `adc.rs`, `none.rs` | the strategies |

mod adc;
pub mod clearance;
mod control;
pub mod draw;
mod mcmc;
pub mod mh;
mod none;
mod outcome;
mod picture;
pub mod relocation;
mod state;
mod statistics;

pub use crate::scene::Edit;
pub use adc::Adaptive;
pub use clearance::Clearance;
pub use control::{DensityControl, Estimator, Expected, NoiseLaw, StepContext};
pub use mcmc::Mcmc;
pub use none::Fixed;
pub use outcome::{BirthKind, BirthRecord, DensityStats, Outcome};
pub use picture::{Colors, Picture};
pub use state::SceneState;
pub use statistics::{ErrorStatistics, ScreenGradient, Statistics, StatisticsKind};

use std::sync::Arc;

use crate::config::{Sampler, TrainConfig};

/// The strategy that a configuration names: the only place that tells them apart.
#[must_use]
pub fn make(config: &TrainConfig) -> Arc<dyn DensityControl> {
    match config.sampler {
        Sampler::Mh => Arc::new(mh::MetropolisHastings::new(&config.mh)),
        Sampler::Mcmc => Arc::new(Mcmc::new(&config.mcmc)),
        Sampler::Adc => Arc::new(Adaptive::new(&config.adc)),
        Sampler::None => Arc::new(Fixed),
    }
}
