//! 3D Gaussian Splatting training on any OpenCL device, with Metropolis–Hastings density control.
//!
//! Posed photos become a scene of N Gaussians. Raw parameters per Gaussian and their activations: position (none),
//! log-scale (exp), quaternion w, x, y, z (normalised), opacity logit (sigmoid), SH coefficients of three channels (real
//! SH basis in 3DGS's sign convention, + ½, clamped at 0). Lengths are in a local frame in which the scene extent
//! (1.1 × the largest distance of a camera centre from their mean) is 1.
//!
//! # The way of the data
//!
//! | step | where | what |
//! |---|---|---|
//! | read | [`dataset`] | files → posed photos in the local frame |
//! | start | [`model`] | points → [`Splats`] |
//! | anti-alias | [`antialias`], `kernels/filter.cl` | whether the views' sampling rates ask for Mip-Splatting's filters; each Gaussian's 3D filter |
//! | project | `kernels/project.cl` | Gaussians → 2D records of one camera |
//! | scan, bin, sort | `kernels/{scan,bin,sort}.cl` | records → Gaussians of each tile, front to back |
//! | splat | `kernels/splat.cl` | tiles → image |
//! | shrink, loss | `kernels/{shrink,loss}.cl` | early in a run the photo at a fraction of its size; L1 + SSIM and its gradient |
//! | exposure | `kernels/exposure.cl`, [`exposure`](mod@exposure) | between render and loss an affine colour transform per photo, where photos differ in brightness |
//! | splat_grad, project_grad | `kernels/{splat_grad,project_grad}.cl` | gradient of the image → of the raw parameters |
//! | adam | `kernels/adam.cl` | one step of all parameters |
//! | noise | `kernels/noise.cl` | a random step of every position (samplers mcmc, mh) |
//! | live | `kernels/live.cl` | tiles of a masked photo in which any pixel counts, of a transparent one in which any is not clear |
//! | seen | `kernels/seen.cl` | which Gaussians the views show, for what is removed at the end |
//! | importance, screen_grad | `kernels/{importance,screen_grad}.cl` | error cues (sampler mh) or gradients on the screen (adc) of each Gaussian |
//! | density control | [`density`] | which Gaussians are born, moved or removed, on the host |
//! | probes | `probe.rs`, `train/probe.rs` | what proposed births would do to the loss, if density control asks |
//! | edit | `kernels/edit.cl` | rows written by density control |
//! | metrics | `kernels/metrics.cl`, [`evaluate`] | PSNR, SSIM, ꟻLIP |
//! | report | [`report`], [`export`] | run folder, page, scene files, checkpoints |
//! | compare | [`mod@compare`] | several runs: error against run time, time to equal error |
//! | surrogate | [`surrogate`] | how well the importance, and probes, order what births truly do to the loss |
//! | experiment | [`experiment`] | a matrix of runs within a time budget, and its comparison |
//! | measure | [`bench`](mod@bench), `kernels/peak.cl` | time and error of every stage, against the device's best |
//!
//! [`train`] and [`render`] alone know the order of the stages. Every stage has a twin in plain f64 Rust in
//! [`reference`](mod@reference), which defines what is correct; [`verify`] compares the two on a device,
//! [`bench`](mod@bench) sets their error beside their time, and [`tune`] chooses how kernels are cut for a device.
//!
//! ```no_run
//! use mhsplat::{Device, LoadOptions, TrainConfig, Trainer, load_dataset, run};
//! # fn main() -> mhsplat::Result<()> {
//! let dataset = load_dataset("photos".as_ref(), &LoadOptions::default())?;
//! let device = Device::open(None)?;
//! let config = TrainConfig { iterations: 3000, ..TrainConfig::default() };
//! let splats = run::initial_splats(&dataset, &config)?;
//! let mut trainer = Trainer::new(&device, &dataset, &config, &splats)?;
//! while trainer.iteration() < config.iterations {
//!     trainer.step()?;
//!     trainer.density_step()?;
//! }
//! mhsplat::export::ply::write("scene.ply".as_ref(), &trainer.state()?.splats, &dataset.frame)?;
//! # Ok(())
//! # }
//! ```

pub mod antialias;
#[doc(hidden)]
pub mod atomic;
pub mod bench;
#[doc(hidden)]
pub mod buffers;
#[doc(hidden)]
pub mod cache;
pub mod compare;
pub mod config;
#[doc(hidden)]
pub mod constants;
pub mod dataset;
pub mod density;
pub mod error;
pub mod evaluate;
pub mod experiment;
pub mod export;
pub mod exposure;
#[doc(hidden)]
pub mod gpu;
pub mod model;
#[doc(hidden)]
pub mod photos;
pub mod plan;
mod probe;
pub mod reference;
pub mod render;
pub mod report;
#[doc(hidden)]
pub mod rng;
pub mod run;
pub mod schedule;
#[doc(hidden)]
pub mod stage;
pub mod surrogate;
pub mod train;
pub mod tune;
pub mod verify;

pub use config::TrainConfig;
pub use dataset::{Camera, Dataset, LoadOptions, View, load as load_dataset, synthetic};
pub use error::{Error, Result};
pub use gpu::Device;
pub use model::Splats;
pub use plan::Plan;
pub use render::Renderer;
pub use report::RunRecord;
pub use train::Trainer;
