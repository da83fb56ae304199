//! The training loop. [`step`] has one iteration in order; [`plan`] has every decision.

pub mod brightness;
pub mod control;
pub mod crew;
pub mod decision;
mod density_steps;
pub mod estimates;
mod exposure_steps;
mod finish;
pub mod gaussians;
pub mod growth;
mod looks;
mod moves;
mod noted;
mod observe;
mod optimizer;
mod picture;
pub mod plan;
pub mod reasons;
pub mod sampling_rates;
pub mod schedule;
mod sharing;
pub mod sizes;
pub mod smoothing;
mod state;
pub mod step;
mod timing;
pub mod trace;
pub mod views;
pub mod working;

pub use control::DensityEvent;
pub use decision::PendingStep;
pub use noted::Noted;
pub use plan::{Begun, Learned, Plan};
pub use state::TrainerState;
pub use step::{Event, Next, Trainer};
pub use timing::TIMING_INTERVAL;
