//! Every number of a run, with the papers' defaults: one struct for the flags of `mhsplat train` and for its configuration files.
//!
//! \[MH\] = Kim, Jung, Park, NeurIPS 2025 (arXiv 2506.12945); \[3DGS\] = Kerbl et al. 2023; \[MCMC\] = Kheradmand et al. 2024.

mod choices;
mod mh;
mod optimizer;
mod samplers;
mod train;
mod values;
mod work;

pub use choices::{Acceptance, Birth, Surrogate, ViewSubset};
pub use choices::{AntiAliasing, ExposureChoice, Preset, SceneFormat, TrainingSize};
pub use mh::MhConfig;
pub use optimizer::{LossConfig, OptimizerConfig};
pub use samplers::{AdcConfig, DensityTimes, McmcConfig, Sampler};
pub(crate) use train::{DENSITY_STEPS, PAPER_ITERATIONS};
pub use train::{Length, RUN_CONTROL, TrainConfig};
pub use values::{Background, Init, deserialize, from_json, parse_bytes, parse_duration};
pub use work::WorkConfig;
