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
//! | start | [`model`] | points → [`Gaussians`] |
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
//! let splats = run::initial_gaussians(&dataset, &config)?;
//! let mut trainer = Trainer::new(&device, &dataset, &config, &splats)?;
//! while trainer.iteration() < config.iterations {
//!     trainer.step()?;
//!     trainer.density_step()?;
//! }
//! mhsplat::export::ply::write("scene.ply".as_ref(), &trainer.state()?.splats, &dataset.frame)?;
//! # Ok(())
//! # }
//! ```

#[doc(hidden)]
pub mod base;
pub mod capture;
#[doc(hidden)]
pub mod chart;
pub mod config;
pub mod density;
#[doc(hidden)]
pub mod device;
pub mod evaluate;
pub mod lab;
#[doc(hidden)]
pub mod pipeline;
pub mod run;
pub mod scene;
pub mod train;

pub use base::error::{Error, Result};
pub use capture::{Camera, Dataset, LoadOptions, View, load as load_dataset};
pub use config::TrainConfig;
pub use device::Device;
pub use pipeline::forward::Renderer;
pub use run::RunRecord;
pub use scene::Gaussians;
pub use train::Trainer;
pub use train::plan::Plan;
