//! 3D Gaussian Splatting training on any OpenCL device, with Metropolis–Hastings density control.
//!
//! Posed photos become a scene of N Gaussians. Raw parameters per Gaussian and their activations: position (none),
//! log-scale (exp), quaternion w, x, y, z (normalised), opacity logit (sigmoid), SH coefficients of three channels (real
//! SH basis in 3DGS's sign convention, + ½, clamped at 0). Lengths are in a local frame in which the scene extent
//! (1.1 × the largest distance of a camera centre from their mean) is 1.
//!
//! # The way of the data
//!
//! | step | where | content |
//! |---|---|---|
//! | read | [`capture`] | files → posed photos in the local frame |
//! | start | [`scene`] | points → [`Gaussians`]; scene files |
//! | plan | [`train::plan`] | every decision about a run, with its reason |
//! | smoothing filter | `kernels/filter.cl` | Mip-Splatting's 3D filter of each Gaussian |
//! | project | `kernels/project.cl` | Gaussians → 2D Gaussians of one camera |
//! | scan, bin, sort | `kernels/{scan,bin,sort}.cl` | 2D Gaussians → tile intersections, front to back |
//! | splat | `kernels/splat.cl` | tiles → image |
//! | route | `kernels/route.cl`, [`ranks`] | where several devices train one scene: 2D Gaussians → the bands that they touch, sums of their pairs back |
//! | shrink, loss | `kernels/{shrink,loss}.cl` | photo at a fraction of its size early in a run; L1 + SSIM and its gradient |
//! | exposure | `kernels/exposure.cl` | affine colour transform per photo, between render and loss |
//! | splat_grad, project_grad | `kernels/{splat_grad,project_grad}.cl` | gradient of the image → of the raw parameters, and a step of the optimiser with it |
//! | noise | `kernels/noise.cl` | random step of every position (mcmc, mh) |
//! | active_tiles | `kernels/active_tiles.cl` | active tiles of photos with masks or transparency |
//! | seen | `kernels/seen.cl` | Gaussians that the training views show; the others are removed at the end |
//! | importance, screen_grad | `kernels/{importance,screen_grad}.cl` | error statistics (mh) or screen-space gradients (adc) of each Gaussian |
//! | photo_error | `kernels/photo_error.cl` | error of each pixel of a render, from which births in image space are drawn (mh) |
//! | density control | [`density`] | births, moves and removals, decided on the host |
//! | edit, morton | `kernels/{edit,morton}.cl` | rows written by density control, and the order of all |
//! | metrics, flip | `kernels/{metrics,flip}.cl`, [`evaluate`] | PSNR, SSIM, ꟻLIP |
//! | run | [`run`] | run folder, checkpoints, report |
//! | measure | [`lab`], `kernels/{peak,adam}.cl` | verify, bench, compare, experiment, surrogate: only the command line uses it |
//!
//! `pipeline` alone (`forward.rs`, `backward.rs`, `pass.rs`) knows the order of the stages, and [`train::step`] the order of an iteration. Every stage file
//! in `src/pipeline/stage` has the kernel's launcher and its definition in f64, which [`lab::verify`] compares on a device (but for the sizes of photos, marks of tiles and routes between devices, which tests compare).
//!
//! ```no_run
//! use mhsplat::train::Event;
//! use mhsplat::{Device, LoadOptions, Plan, TrainConfig, Trainer, load_dataset, run};
//! # fn main() -> mhsplat::Result<()> {
//! let config = TrainConfig { iterations: 3000, ..TrainConfig::default() };
//! let dataset = run::with_points(load_dataset("photos".as_ref(), &LoadOptions::default())?, &config)?;
//! let plan = Plan::new(&dataset, &config)?;
//! let device = Device::open(None)?;
//! let splats = run::initial_gaussians(&dataset, &plan)?;
//! let mut trainer = Trainer::new(&device, &dataset, &plan, &splats)?;
//! while trainer.advance()? != Event::Finished {}
//! mhsplat::scene::ply::write_scene("scene.ply".as_ref(), &trainer.scene()?, &dataset.frame)?;
//! # Ok(())
//! # }
//! ```
//!
//! Everything that talks to a device fails with [`Error::Device`] if the driver does, if kernels cannot be built or if memory does not
//! suffice; "Errors" sections name only what else can go wrong.
//!
//! Examples, which are tested: `train_and_render` (a view as a PNG), `own_density_control` (a strategy of one's own), `render_path` (a scene
//! file along a path).

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
#[doc(hidden)]
pub mod ranks;
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
